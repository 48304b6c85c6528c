# SPDX-License-Identifier: Apache-2.0
"""Why a track does not fit the curves that machine.yaml and the bag say: which change would do.

Tried are: an axis that turns the other way, rotary axes in the other order, names of two targets
exchanged, a tracker on the other link, and a tracker that was moved between the parts. What fits
much better is named.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np

from otf_core.errors import InputError, OtfError
from otf_core.model.axis_path import BREAK, AxisPath
from otf_core.model.machine import BED, TABLE, Chain, Machine
from otf_core.model.observation import Samples
from otf_core.tracking.alignment import Alignment
from otf_core.tracking.curve_matching import match
from otf_core.tracking.matching import MIN_SHARE_AS_PLANNED

SUSPECT = 2.5e-4
"""m; median distance of a part from its curve, after the rough fit, above which others are tried:
errors of machine tools are smaller."""
BETTER = 0.4
"""Share of the distance below which another explanation counts."""
OFF = 2.0 * SUSPECT
"""m; a mistake that explains an odd order of driving brings the track so near."""
REFUSED = 1e-3
"""m; a part that is further off is not solved for."""
FAR = 10.0
"""Standard uncertainties by which a place may be off without a word."""
UNSOLVABLE = 2e-2
"""m or rad; a line that lies further away is beyond errors of first order."""
CENTRE = 1e-3
"""m; a line of an axis that lies further away is a mistake in machine.yaml, not an error."""
TILT = 3e-3
"""rad; the same of its direction."""


def check_matched(
    samples: Samples, matched: Alignment, paths: Sequence[AxisPath]
) -> tuple[str, ...]:
    """Refuse what does not fit and say why; return what is to be noted.

    Raises
    ------
    InputError
        Names the contradiction and what to change.
    """
    _check_names(matched)
    if not matched.as_planned:
        explained = _explained(samples, matched, paths, OFF)
        if explained:
            raise InputError(f'samples do not follow the path as planned; {explained}')
    off = [part.distance for part in matched.parts]
    worst, given = int(np.argmax(off)), max(off)
    if given > SUSPECT:
        explained = _explained(samples, matched, paths, BETTER * given) or _moved_tracker(
            samples, matched, given
        )
        if explained:
            raise InputError(
                f'the track is {1e3 * given:.2f} mm off the curve that the axes drive; {explained}'
            )
        if given > REFUSED:
            raise InputError(
                f"part {worst + 1} ('{matched.parts[worst].path.target}'): the track is "
                f'{1e3 * given:.2f} mm off the curve that the axes drive; '
                f'{_parts_words(samples, paths)}check chain, direction and centre of the rotary '
                f'axes, and link and place of the targets and of the tracker'
            )
    far = {n: (v, True) for n, v in matched.location.items() if abs(v) > UNSOLVABLE}
    if far:
        raise InputError('; '.join(wrong_lines(far, _machine(matched))))
    return _notes(matched)


def _machine(matched: Alignment) -> Machine:
    return matched.shape.sights[0].machine


def _parts_words(samples: Samples, paths: Sequence[AxisPath]) -> str:
    """Words where the beam was broken more often than the path has changes of parts."""
    breaks = int(np.count_nonzero(np.diff(samples.stamp_ns) >= BREAK * 1e9))
    if breaks < len(paths):
        return ''
    return (
        f'the beam was broken {breaks} times for 2 s or more, but the path has {len(paths)} '
        f'part{"s" * (len(paths) > 1)}: if the path of a part is missing, record or give all '
        f'parts; otherwise '
    )


def _explained(
    samples: Samples, matched: Alignment, paths: Sequence[AxisPath], best: float
) -> str:
    """Words on the change under which the track fits as planned, nearer than ``best``, m."""
    words = ''
    for machine, driven, said in _alternatives(_machine(matched), paths):
        with suppress(OtfError):
            other = match(samples, machine, driven, quick=True, in_any_order=False)
            off = max(part.distance for part in other.parts)
            if off < best and other.followed > MIN_SHARE_AS_PLANNED:
                best, words = off, said
                if best < 0.5 * SUSPECT:
                    break
    return words


def _alternatives(
    machine: Machine, paths: Sequence[AxisPath]
) -> Iterator[tuple[Machine, list[AxisPath], str]]:
    """Machines and paths that differ by one mistake from those given, and words on it."""
    turning = machine.rotary_names
    for some in [(a,) for a in turning] + ([turning] if len(turning) > 1 else []):
        axes = dict(machine.axes)
        for name in some:
            direction = axes[name].direction
            assert direction is not None
            axes[name] = replace(
                axes[name], direction=(-direction[0], -direction[1], -direction[2])
            )
        signs = ' and '.join(
            f'{a}: direction: {[round(v, 6) + 0.0 for v in axes[a].direction or ()]}' for a in some
        )
        yield (
            replace(machine, axes=axes),
            list(paths),
            (
                f'it fits where {" and ".join(some)} turn{"s"[: len(some) == 1]} the other way; '
                f'write {signs} in machine.yaml'
            ),
        )
    yield from _other_orders(machine, paths)
    seen = sorted({p.target for p in paths})
    for one, other in combinations(seen, 2):
        if machine.targets[one].link != machine.targets[other].link:
            continue
        names = {one: other, other: one}
        driven = [replace(p, target=names.get(p.target, p.target)) for p in paths]
        yield machine, driven, f"it fits where the names '{one}' and '{other}' are exchanged"
    link = BED if machine.tracker.link == TABLE else TABLE
    yield (
        replace(machine, tracker=replace(machine.tracker, link=link)),
        list(paths),
        f'it fits where the tracker stands on the {"bed" if link == BED else "table"}; write '
        f'tracker: link: {link} in machine.yaml',
    )


def _other_orders(
    machine: Machine, paths: Sequence[AxisPath]
) -> Iterator[tuple[Machine, list[AxisPath], str]]:
    turning = machine.rotary_names
    if len(turning) == 2:
        swap = dict(zip(turning, turning[::-1], strict=True))
        chain = Chain(
            tuple(swap.get(a, a) for a in machine.chain.table_side),
            tuple(swap.get(a, a) for a in machine.chain.target_side),
        )
        yield (
            replace(machine, chain=chain),
            list(paths),
            (f'it fits the chain {chain}: the order of its rotary axes is reversed'),
        )


def _moved_tracker(samples: Samples, matched: Alignment, given: float) -> str:
    """Words where parts fit one by one, but not with one pose of the tracker."""
    poses = []
    for part in matched.parts:
        own = samples.part(part.first, part.last)
        try:
            alone = match(own, _machine(matched), [part.path], quick=True, in_any_order=False)
        except OtfError:
            return ''
        if alone.parts[0].distance > BETTER * given:
            return ''
        poses.append(alone.T_machine_tracker)
    points = samples.xyz[:: max(1, len(samples) // 200)]
    apart = [float(np.abs(p.apply(points) - poses[0].apply(points)).max()) for p in poses]
    moved = next((k for k, d in enumerate(apart) if d > SUSPECT), None)
    if moved is None:
        return ''
    return (
        f'every part fits by itself, but from part {moved + 1} on with another pose: the tracker '
        f'was moved. Record the parts of each place as a bag of its own; location errors need '
        f'parts from one place'
    )


def _check_names(matched: Alignment) -> None:
    """Refuse names of targets that lie where others are stated."""
    machine = _machine(matched)
    seen = {p.path.target for p in matched.parts if machine.targets[p.path.target].link == TABLE}
    for one, other in combinations(sorted(seen), 2):
        stated = {n: np.array(machine.targets[n].place) for n in (one, other)}
        reach = 5.0 * max(machine.targets[one].u, machine.targets[other].u, 1e-3)
        off = (
            np.linalg.norm(matched.places[one] - stated[other]),
            np.linalg.norm(matched.places[other] - stated[one]),
        )
        apart = np.linalg.norm(stated[one] - stated[other])
        if max(off) < reach < 0.5 * apart:
            raise InputError(
                f"targets '{one}' and '{other}': each lies where machine.yaml states the other; "
                f'exchange their names in the bag or their places in machine.yaml'
            )


def _notes(matched: Alignment) -> tuple[str, ...]:
    notes = []
    if not matched.as_planned:
        notes.append(
            f'the path was not driven as planned; legs count in the order in which they were '
            f'driven, {100 * matched.coverage:.0f} % of the path'
        )
    elif matched.missing:
        last = len(matched.parts)
        names = ', '.join(p.target for p in matched.missing)
        notes.append(
            f'only the first {last} of {last + len(matched.missing)} parts were recorded; not '
            f'recorded: {names}'
        )
    for name in sorted({p.path.target for p in matched.parts}):
        target = _machine(matched).targets[name]
        off = float(np.linalg.norm(matched.places[name] - np.array(target.place)))
        if target.u > 0.0 and target.link == TABLE and off > max(FAR * target.u, CENTRE):
            notes.append(
                f"target '{name}' lies {1e3 * off:.1f} mm from the place in machine.yaml, which "
                f'states u = {1e3 * target.u:g} mm'
            )
    return tuple(notes)


def wrong_lines(location: dict[str, tuple[float, bool]], machine: Machine) -> list[str]:
    """Words on lines of axes that lie far from where machine.yaml puts them.

    Parameters
    ----------
    location : mapping of name to (value, identifiable), m and rad
    """
    lines = []
    for axis in machine.rotary_names:
        own = {n: v for n, (v, seen) in location.items() if n[2] == axis and seen}
        centre = np.array(machine.axes[axis].centre)
        far = False
        for name, value in own.items():
            if name[0] in 'XYZ':
                centre['XYZ'.index(name[0])] += value
                far = far or abs(value) > CENTRE
        if far:
            text = ', '.join(f'{v:.5f}' for v in centre)
            lines.append(
                f'axes: {axis}: centre: its line lies more than {1e3 * CENTRE:g} mm from the '
                f'place in machine.yaml; it fits [{text}] m'
            )
        tilted = [n for n, v in own.items() if n[0] in 'ABC' and abs(v) > TILT]
        if tilted:
            values = ', '.join(f'{n} = {1e3 * own[n]:.2f} mrad' for n in tilted)
            lines.append(f'axes: {axis}: direction: does not fit its line ({values})')
    return lines
