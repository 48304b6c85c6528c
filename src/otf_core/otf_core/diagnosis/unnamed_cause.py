# SPDX-License-Identifier: Apache-2.0
"""What is said of a gap without a name: what it depends on, how it acts, what behaves so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.diagnosis.cause_parameters import fitted_causes
from otf_core.diagnosis.engine.empirical_structure import (
    Structure,
    Structures,
    find_another,
    find_structure,
)
from otf_core.diagnosis.engine.gap_sizes import (
    gap_um,
    residuals_with,
    shrink_interval,
    shrink_percent,
)
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.rival import Rival
from otf_core.diagnosis.explanation import Explanation, noise_level
from otf_core.diagnosis.free_curves import Curve, curves_of, range_words
from otf_core.diagnosis.verdict import matters
from otf_core.effects import AppliedEffect
from otf_core.effects.action import (
    RIGID_TABLE,
    RIGID_TRACKER,
    VECTOR,
    Along,
    acting_name,
)
from otf_core.effects.inputs import SIGNAL
from otf_core.effects.located_inputs import (
    CYCLE,
    MOMENT,
    PLACE,
    TURNS,
    found_kind,
    head_of,
    numbers_of,
    plain_names,
)
from otf_core.model.frames import XYZ

FAR_BETTER = 0.5
"""Share of the gap that the named causes leave, below which a cause without a name beats them."""
LEAST_SHRINK = 20.0
"""Percent; a structure that takes less of the gap is not worth stating."""
MOST, LEAST_BESIDES = 3, 0.15
"""Structures at most, and the share of the squared gap that each but the first must take."""
WORDS = {
    'time': 'time', 'x': 'the position of X', 'y': 'the position of Y', 'z': 'the position of Z',
    'feed': 'the feed', 'acceleration': 'the acceleration along the path',
    'since_stop': 'the time since the last stop', 'lap': 'the lap', 'leg': 'the leg',
    'range': 'the length of the beam', 'azimuth': 'the azimuth of the beam',
    'elevation': 'the elevation of the beam',
}  # fmt: skip
ACTS = {
    VECTOR: 'a shift of the target',
    RIGID_TRACKER: 'a shift and turn of all that the tracker sees',
    RIGID_TABLE: 'a shift and turn of the table',
}
ALMOST = 0.95
"""Component of a unit vector from which it counts as along an axis."""
MECHANISMS = (
    ({'range', 'azimuth', 'elevation'}, 'air along the beam, the tracker or its stand'),
    ({'sense_x', 'sense_y', 'sense_z'}, 'friction, play or clamps of the drives that reverse'),
    (
        {'since_reversal_x', 'since_reversal_y', 'since_reversal_z'},
        'wind-up and friction that are taken up after a reversal',
    ),
    ({'since_stop', 'acceleration'}, 'inertia and settling after changes of speed'),
    ({'feed'}, 'forces or films that grow with speed: oil film, air drag, control'),
    ({'lap'}, 'something that changed between the laps'),
    ({PLACE}, 'a fault of a guideway or of the structure at one place'),
    ({MOMENT}, 'a jolt: something slipped, gave way or was knocked'),
    ({*TURNS}, 'a screw, a gear, a rack or the balls of a guide: what repeats with travel'),
    ({CYCLE}, 'what switches in turn: cooling, coolant, air conditioning, a pump'),
    ({'time'}, 'warming, settling or something that switches while the run lasts'),
    ({'x', 'y', 'z'}, 'a structure that bends with the place of its slides'),
)
"""Kinds of mechanism that depend on any of some inputs."""
WITH_WORDS = {CYCLE, MOMENT, PLACE, *TURNS}
"""Inputs with numbers that have kinds of mechanism of their own."""


@dataclass(frozen=True)
class Unnamed:
    """Cause without a name (docs/conventions.md, gap.json).

    Attributes
    ----------
    acts_as : str
        'vector', 'direction', 'rigid_tracker' or 'rigid_table'.
    before_um, after_um : float
        Gap without and with it, on legs it was not fitted on.
    shrink_interval_percent : tuple of two floats
        95 % interval over legs.
    """

    depends_on: tuple[str, ...]
    acts_as: str
    words: str
    before_um: float
    after_um: float
    shrink_percent: float
    shrink_interval_percent: tuple[float, float]
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Nameless:
    """A cause without a name, and the empirical effects that reproduce it in every run."""

    said: Unnamed
    applied: tuple[tuple[AppliedEffect, ...], ...]
    simulated_um: float
    """Residual of the simulation, its noise corrected by what the structures leave."""


def find_unnamed(
    rows: Rows, explained: Explanation, verdict: str, tried: Structures, rival: Rival
) -> Nameless | None:
    """Look for a cause without a name where the named ones leave a gap.

    Parameters
    ----------
    verdict : str
        By the effects of the catalogue.
    tried : Structures
        What may explain the gap.
    rival : Rival
        Of the named causes.

    Returns
    -------
    Nameless or None
        None if nothing is left to explain, if no structure explains it, or if the named causes
        are about as good.
    """
    if verdict not in ('unknown', 'partly_explained') and not rival.wins:
        return None
    first = find_structure(tried)
    if first is None:
        return None
    found = _with_more(rows, explained, tried, first)
    if found.said.shrink_percent < LEAST_SHRINK:
        return None
    enough = (1.0 if rival.wins else FAR_BETTER) * explained.after_um
    left = found.said.after_um
    worse = left > enough and (not rival.wins or matters(left, explained.twin_um))
    return None if verdict != 'unknown' and worse else found


def _with_more(
    rows: Rows, explained: Explanation, tried: Structures, first: Structure
) -> Nameless:
    """Add to a structure those that take enough of the gap besides."""
    structures = [first]
    found = _said(rows, explained, structures)
    least = LEAST_BESIDES * found.said.before_um**2
    while len(structures) < MOST and found.said.after_um**2 > least:
        other = find_another(tried, structures)
        if other is None:
            break
        more = _said(rows, explained, [*structures, other])
        if found.said.after_um**2 - more.said.after_um**2 < least:
            break
        structures, found = [*structures, other], more
    return found


def _said(rows: Rows, explained: Explanation, structures: Sequence[Structure]) -> Nameless:
    causes = [s.cause for s in structures]
    before, after = explained.steps[0], residuals_with(rows, causes)
    simulated = explained.twin_um * noise_level(rows, causes)
    sizes = [gap_um(r.rms_um, simulated) for r in (before, after)]
    parts = fitted_causes(causes, rows)
    curves = [curves_of(part) for part in parts]
    words = [_words(s, own) for s, own in zip(structures, curves, strict=True)]
    said = Unnamed(
        depends_on=tuple(dict.fromkeys(n for s in structures for n in s.inputs)),
        acts_as=acting_name(structures[0].effect.form.acts),
        words='; and besides it '.join(words),
        before_um=sizes[0],
        after_um=sizes[1],
        shrink_percent=shrink_percent(*sizes),
        shrink_interval_percent=shrink_interval(before, after, simulated),
        curves=tuple(c for own in curves for c in own),
    )
    runs = range(len(rows.runs))
    applied = tuple(tuple(part.applied(k) for part in parts) for k in runs)
    return Nameless(said, applied, simulated)


def input_words(name: str) -> str:
    """Name of an input in words."""
    if name.startswith(SIGNAL):
        return f'the signal {name.removeprefix(SIGNAL)}'
    if kind := found_kind(name):
        return kind.words(numbers_of(name))
    head, _, axis = name.rpartition('_')
    of_axis = {
        'sense': 'the sense of travel of',
        'since_reversal': 'the travel since a reversal of',
    }
    return WORDS.get(name) or f'{of_axis[head]} {axis.upper()}'


def _words(structure: Structure, curves: Sequence[Curve]) -> str:
    inputs = structure.effect.form.inputs
    depends = ' and '.join(input_words(n) for n in inputs)
    acts = structure.effect.form.acts
    moved = f'a shift along {_direction_words(acts)}' if isinstance(acts, Along) else ''
    moved = moved or ACTS[acting_name(acts)]
    sizes = f', {range_words(curves[0])}' if curves else ''
    signals = any(n.startswith(SIGNAL) for n in inputs)
    kinds_of = {head_of(n) or n for n in inputs}
    kinds_of |= set(plain_names([n for n in inputs if head_of(n) not in WITH_WORDS]))
    kinds = [words for names, words in MECHANISMS if names & kinds_of][:2]
    kinds = ['what that signal measures'] if signals else kinds
    return f'depends on {depends}: {moved}{sizes}; what behaves so: {", or ".join(kinds)}'


def _direction_words(acts: Along) -> str:
    main = int(np.argmax(np.abs(acts.direction)))
    if abs(acts.direction[main]) > ALMOST:
        return XYZ[main]
    return f'X, Y, Z = ({", ".join(f"{v:.2f}" for v in acts.direction)})'
