# SPDX-License-Identifier: Apache-2.0
"""From an explanation to the answer: causes with their sizes, gap, sentence, what was measured.

What was measured, for those who plan what to measure next: path, feeds, place of the tracker.

Corners are taken half-way between the last piece of a leg and the first of the next: near corners
nothing is used.

Moves of tracker or target that are none: a cycle in time looks like steps.

The examination takes what changes quickly for a move and cuts the run there; a diagnosis looks at
the whole run. Where a cycle leaves hardly any of the gap, no move is left either. Other functions
of time follow a true move as well.

From an explanation to the answer: causes with their sizes, gap, sentence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from otf_core.diagnosis.cause_parameters import (
    CauseSize,
    FittedCause,
    chosen_sizes,
    curves_of,
    departs_words,
    sizes_of,
    sizes_words,
)
from otf_core.diagnosis.engine.gap_sizes import (
    NoiseFinding,
    gap_um,
    shrink_interval,
    shrink_percent,
)
from otf_core.diagnosis.engine.search import MOST_ALIKE
from otf_core.diagnosis.place.groups import RunView, part_targets
from otf_core.diagnosis.result import FORMULA, FREE, Gap, NamedCause
from otf_core.diagnosis.weighing import EXPLAINED_SHARE, Explanation, Unnamed
from otf_core.effects import State
from otf_core.effects.inputs import CYCLE, MOMENT, head_of
from otf_core.model.frames import XYZ
from otf_core.model.machine import Machine
from otf_core.pieces.finding import WARNING, Finding


def measured_run(view: RunView) -> dict[str, Any]:
    """Axis positions at the corners, feeds of the legs, m/s, and place of the tracker, m."""
    first = np.flatnonzero(np.diff(view.leg, prepend=view.leg[0] - 1))
    last = np.append(first[1:], len(view.leg)) - 1
    between = 0.5 * (view.q[last[:-1]] + view.q[first[1:]])
    point = view.q if view.point is None else view.point
    path = np.vstack([view.q[first[:1]], between, view.q[last[-1:]]])
    feed = [float(np.max(view.speed[a : b + 1])) for a, b in zip(first, last, strict=True)]
    return {
        'tracker_place': np.median(point - view.beam, axis=0).tolist(),
        'path': np.round(path, 6).tolist(),
        'feed': feed,
    }


WORDS = '; the cycle that this diagnosis finds explains the run as well, without a move'


def qualify_moves(findings: Sequence[Finding], unnamed: Unnamed | None) -> tuple[Finding, ...]:
    """Say so beside findings of moves.

    Parameters
    ----------
    unnamed : Unnamed, optional
        What explains the gap, if it has no name.
    """
    if unnamed is None or unnamed.after_um > EXPLAINED_SHARE * unnamed.before_um:
        return tuple(findings)
    heads = {head_of(curve.input) for curve in unnamed.curves}
    if CYCLE not in heads or MOMENT in heads:
        return tuple(findings)
    return tuple(
        replace(f, words=f.words + WORDS) if (f.check, f.severity) == ('moved', WARNING) else f
        for f in findings
    )


ALONG = 0.2
"""Share of the largest mean square displacement from which a direction is named as well."""


def named_causes(
    explained: Explanation,
    fitted: Sequence[FittedCause],
    noise: NoiseFinding | None,
    gap: Gap,
    states: Sequence[State],
) -> tuple[NamedCause, ...]:
    """Causes as they are reported, first the one that shrinks the gap most.

    Parameters
    ----------
    fitted : sequence of FittedCause
        Of its causes.
    noise : NoiseFinding, optional
        Noise other than specified, a cause as well; it comes last.
    gap : Gap
        Its end is where the noise leads to.
    states : sequence of State
        Of the pieces of every run.
    """
    gaps = [gap_um(s.rms_um, explained.simulated_um) for s in explained.steps]
    units = {s.name: s.unit for s in states[0].machine.signals}
    named: list[NamedCause] = []
    for part, before, after in zip(fitted, gaps[:-1], gaps[1:], strict=True):
        cause = _named_cause(part, before, after, units)
        targets = part_targets(states[0])
        sizes = tuple(_with_target(s, targets) for s in sizes_of(part, states, cause.curves))
        _add(named, replace(cause, direction=_direction(part, states), sizes=sizes))
    named.sort(key=lambda cause: cause.after_um - cause.before_um)
    if noise is not None:
        named.append(_noise_cause(noise, gaps[-1], gap.after_um, states[0].machine))
    return tuple(named)


def _named_cause(
    part: FittedCause, before_um: float, after_um: float, signal_units: Mapping[str, str]
) -> NamedCause:
    option = part.cause.option
    units = dict(zip(option.terms.names, option.terms.units, strict=True))
    units |= dict(zip(option.effect.shape_names, option.effect.shape_units, strict=True))
    parameters = {**option.shape, **dict(zip(part.names, part.value.tolist(), strict=True))}
    return NamedCause(
        effect=option.effect.name,
        axes=part.axes,
        parameters=parameters,
        u=dict(zip(part.names, part.u.tolist(), strict=True)),
        units={n: units[n] for n in parameters},
        before_um=before_um,
        after_um=after_um,
        shrink_percent=shrink_percent(before_um, after_um),
        confidence=part.cause.confidence,
        indistinguishable_from=part.cause.indistinguishable,
        form=FREE if option.terms.orders else FORMULA,
        departs=departs_words(part, signal_units),
        curves=curves_of(part, signal_units),
    )


def _with_target(size: CauseSize, targets: Sequence[str]) -> CauseSize:
    """A size with the target of the part that its remark names: 'nest-1 along X'."""
    for number, target in enumerate(targets, start=1):
        if size.remark == f'in part {number}':
            return replace(size, of=f'{target} {size.of}'.rstrip())
    return size


def _direction(part: FittedCause, states: Sequence[State]) -> str:
    """Machine axes along which a cause displaces, the strongest first."""
    square = np.zeros(3)
    for run, state in enumerate(states):
        one = part.applied(run)
        square += np.sum(one.effect.displacement(state, one.parameters) ** 2, axis=0)
    strong = [k for k in np.argsort(-square) if square[k] > ALONG * square.max()]
    return ' and '.join(XYZ[k] for k in strong) if square.max() > 0.0 else ''


def _add(named: list[NamedCause], cause: NamedCause) -> None:
    """Add a cause, or join it with one of the same effect on other axes."""
    for k, other in enumerate(named):
        if other.effect == cause.effect:
            suffix = '_' + '_'.join(cause.axes)
            alike = dict.fromkeys((*other.indistinguishable_from, *cause.indistinguishable_from))
            renamed = {n: n if n not in other.parameters else n + suffix for n in cause.parameters}
            named[k] = replace(
                other,
                axes=(*other.axes, *cause.axes),
                parameters={
                    **other.parameters,
                    **{renamed[n]: v for n, v in cause.parameters.items()},
                },
                u={**other.u, **{renamed[n]: v for n, v in cause.u.items()}},
                units={**other.units, **{renamed[n]: v for n, v in cause.units.items()}},
                after_um=cause.after_um,
                shrink_percent=shrink_percent(other.before_um, cause.after_um),
                indistinguishable_from=tuple(alike)[:MOST_ALIKE],
                sizes=(*other.sizes, *cause.sizes),
            )
            return
    named.append(cause)


def _noise_cause(
    noise: NoiseFinding, before_um: float, after_um: float, machine: Machine
) -> NamedCause:
    effect = noise.effect
    units = dict(zip(effect.shape_names, effect.shape_units, strict=True))
    return NamedCause(
        effect=effect.name,
        axes=(),
        parameters=noise.parameters,
        u={},
        units={n: units[n] for n in noise.parameters},
        before_um=before_um,
        after_um=after_um,
        shrink_percent=shrink_percent(before_um, after_um),
        confidence=noise.confidence,
        indistinguishable_from=(),
        sizes=chosen_sizes(effect.name, noise.parameters, machine),
    )


_SENTENCES = {
    'none': 'No gap: the run looks like its simulation within the noise.',
    'explained': 'The gap of {before:.2f} um is explained by {causes}; {after:.2f} um remain.',
    'partly_explained': 'The gap of {before:.2f} um is partly explained by {causes}; '
    '{after:.2f} um remain unexplained.',
    'unknown': 'There is a gap of {before:.2f} um that no effect of the catalogue explains.',
}

NOTHING_UM = 0.005
"""um; a gap below it is stated as zero."""
_BESIDE = 'The gap of {before:.2f} um is partly explained by {causes}.'
"""Where what the causes leave is described as well."""


def name_and_sizes(cause: NamedCause) -> str:
    """Name of a cause with the sizes estimated: 'backlash of X, 5.02 +/- 0.19 um'."""
    estimated = [size for size in cause.sizes if size.u is not None]
    return cause.effect.replace('_', ' ') + sizes_words(estimated, cause.direction)


def _spoken(causes: Sequence[NamedCause]) -> str:
    parts = []
    for cause in causes:
        text = name_and_sizes(cause)
        if cause.indistinguishable_from:
            others = ' or '.join(n.replace('_', ' ') for n in cause.indistinguishable_from)
            text += f', indistinguishable from {others}'
        parts.append(text)
    return ', and by '.join(parts)


def known_words(causes: Sequence[NamedCause], unnamed: Unnamed | None) -> str:
    """What explains the gap, in words; empty if nothing does."""
    parts = [f'like that of {_spoken(causes)}'] if causes else []
    if unnamed is not None:
        parts.append(f'{"the rest" if causes else "it"} {unnamed.words}')
    return '; '.join(parts)


def gap_of(explained: Explanation, noise: NoiseFinding | None) -> Gap:
    """Size of the gap without and with the causes; noise as found belongs to what is simulated."""
    level, u_um = 1.0 if noise is None else noise.level, explained.simulated_u_um
    simulated_after = level * explained.simulated_um
    before, after = explained.steps[0], explained.last
    after_um = gap_um(after.rms_um, simulated_after)
    return Gap(
        measured_um=before.rms_um,
        simulated_um=explained.simulated_um,
        before_um=explained.before_um,
        after_um=after_um,
        shrink_percent=shrink_percent(explained.before_um, after_um),
        shrink_interval_percent=shrink_interval(before, after, simulated_after, level * u_um),
        simulated_u_um=u_um,
    )


def sentence_of(
    verdict: str,
    gap: Gap,
    causes: Sequence[NamedCause],
    noise: NoiseFinding | None,
    unnamed: Unnamed | None = None,
) -> str:
    """The verdict in words."""
    beside = unnamed is not None and bool(causes)
    if causes and not beside and noise is None and gap.before_um < NOTHING_UM:
        shown = _spoken(causes)
        return f'The residual is no larger than simulated, but its pattern shows {shown}.'
    sentence = (_BESIDE if beside else _SENTENCES[verdict]).format(
        before=gap.before_um, after=gap.after_um, causes=_spoken(causes)
    )
    if unnamed is not None:
        rest = 'The rest' if causes else 'It'
        sentence += (
            f' {rest} {unnamed.words}. An empirical effect of these inputs leaves '
            f'{unnamed.after_um:.2f} um.'
        )
    return sentence if noise is None else f'{sentence} Tracker noise: {noise.words}.'
