# SPDX-License-Identifier: Apache-2.0
"""First pictures of a calibration: the volume before and after, all 21 errors with limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.calibration.verdict import FAIL, OPEN, PASS, size_and_expanded
from otf_core.model.expanded import micro_with_expanded
from otf_core.model.limits import VOLUMETRIC
from otf_core.model.motions import MOTIONS, SQUARENESS, unit_of
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.drawing.bars import Bar, bars
from otf_core.reports.drawing.scale import LEVELS, heat_classes, heat_key, heat_step
from otf_core.reports.drawing.scene import (
    TURNED,
    Dots,
    Item,
    Magnification,
    Strokes,
    box,
    magnification,
    scene,
    tracker_items,
)
from otf_core.reports.drawing.style import text
from otf_core.reports.section import Picture
from otf_core.reports.wording import micro_unit

GRID_POINTS_PER_AXIS = 4
"""Points of the grid per axis that are drawn: every other of seven."""
ARROW_REACH = 0.9
"""Length of the longest arrow, in distances between arrows along the shortest edge."""
BOUND = '*'
"""Stands behind the name of an error that holds at one target offset only."""
DOT_RADII = 8
"""Different radii that are drawn."""
STATE_KINDS = {PASS: 'good', FAIL: 'bad', OPEN: 'open'}
"""Class of a bar by the state of its limit."""


@dataclass(frozen=True)
class ErrorSize:
    """How large one of the 21 errors is.

    Attributes
    ----------
    name : str
    unit : str
        m or rad.
    value, U : float
        Span of a motion, size of a squareness error; expanded uncertainty (95 %).
    limit : float, optional
    state : str
        Of the limit; empty without one.
    known : bool
        False if the data do not show it; value and U are zero then.
    bound : bool
        True if it holds at the target offset of the measurement only.
    """

    name: str
    unit: str
    value: float
    U: float
    limit: float | None
    state: str
    known: bool
    bound: bool = False


def error_sizes(facts: Facts) -> list[ErrorSize]:
    """All 21 errors in the order of the tables: motions, then squareness."""
    result, verdict = facts.result, facts.result.machine_verdict
    limits = facts.machine.limits.values if facts.machine.limits else {}
    states = {one.name: one.state for one in verdict.judged} if verdict else {}
    found = []
    for name in (*MOTIONS, *SQUARENESS):
        known = name not in result.not_identifiable
        value, wide = (
            size_and_expanded(name, facts.tables, result.budget_with_typical, result.prior)
            if known
            else (0.0, 0.0)
        )
        found.append(ErrorSize(name, unit_of(name), value, wide, limits.get(name),
                               states.get(name, ''), known,
                               known and name in result.offset_bound.contains))  # fmt: skip
    return found


def error_bars(facts: Facts) -> Picture:
    """All 21 errors as bars with U and limits: displacements left, angles right."""
    found = error_sizes(facts)
    parts = []
    for unit in ('m', 'rad'):
        rows = [_bar(one) for one in found if one.unit == unit]
        parts.append(bars(rows, f'size of all errors in {micro_unit(unit)}', names=44.0,
                          width=480.0))  # fmt: skip
    limited = [one for one in found if one.limit is not None]
    keys = [('after', 'no limit stated')] if len(limited) < len(found) else []
    states = {one.state for one in limited if one.known}
    keys += [(STATE_KINDS[s], s) for s in (PASS, OPEN, FAIL) if s in states]
    key = ''.join(
        f'<span class="{kind}-key"><span class="key"></span>{text(said)}</span> '
        for kind, said in keys
    )
    stroke = ' Upright stroke: the limit.' if limited else ''
    caption = (
        f'Span (largest less smallest value) of an error motion, size of a squareness error; '
        f'line at the end of a bar: U (95 %).{stroke}{bound_words(facts)}'
    )
    legend = f'<p class="soft keys">{key}</p>' if limited else ''
    return Picture(tuple(parts), caption, columns=2, title='All 21 errors', key=legend)


def bound_words(facts: Facts) -> str:
    """Which of the errors hold at one target offset only, as a sentence after another one."""
    bound = facts.result.offset_bound
    return f' {BOUND} {bound.sentence}.' if bound.sentence else ''


def _bar(one: ErrorSize) -> Bar:
    limit = None if one.limit is None else 1e6 * one.limit
    stated = '' if limit is None else f', limit {limit:g}'
    name = f'{one.name}{BOUND}' if one.bound else one.name
    if not one.known:
        return Bar(name, (), f'not known{stated}', limit)
    value, wide = 1e6 * one.value, 1e6 * one.U
    said = f'{micro_with_expanded(one.value, one.U, one.unit)}{stated}'
    kind = STATE_KINDS.get(one.state, 'after')
    ends = (max(value - wide, 0.0), value + wide)
    return Bar(name, ((value, kind),), said, limit, ends)


def volume_pictures(facts: Facts) -> Picture:
    """The volume before and after at one scale of colours and of arrows."""
    length, u = facts.volume.length, facts.k_volume * facts.volume.u_size
    longest = float(length.max())
    step = heat_step(1e6 * length)
    span = float((facts.machine.upper - facts.machine.lower).min())
    shown = magnification(
        max(longest, float(u.max())), ARROW_REACH * span / (GRID_POINTS_PER_AXIS - 1)
    )
    limit = facts.machine.limits.values.get(VOLUMETRIC) if facts.machine.limits else None
    stated = '' if limit is None else f', limit {1e6 * limit:g} um'
    return Picture(
        (_arrows(facts, step, shown), _spheres(facts, shown)),
        f'Left, before: error vectors as the machine stands{stated}. Right, after: what is to be '
        f'expected with these tables loaded, U (95 %) of the vector as radius; predicted, not '
        f'measured. Both at one scale.',
        columns=2,
        hint=TURNED,
        key=heat_key(step, 1e6 * longest, 'µm'),
    )


def _drawn(facts: Facts) -> NDArray[np.int64]:
    """Which points of the grid are drawn."""
    count = round(len(facts.volume.grid) ** (1 / 3))
    use = np.unique(np.linspace(0, count - 1, GRID_POINTS_PER_AXIS).round().astype(int))
    every = np.arange(count**3).reshape(count, count, count)
    return np.asarray(every[np.ix_(use, use, use)].ravel())


def trackers(facts: Facts) -> list[Item]:
    """Marks of the places of the tracker, runs from one place once."""
    low, high = facts.machine.lower, facts.machine.upper
    places: list[Array] = []
    for run in facts.result.runs:
        own = run.T_machine_tracker.translation
        if all(np.linalg.norm(own - other) > 1e-2 for other in places):
            places.append(own)
    return [item for place in places for item in tracker_items(place, low, high)]


def _arrows(facts: Facts, step: float, shown: Magnification) -> str:
    low, high = facts.machine.lower, facts.machine.upper
    at = _drawn(facts)
    grid = facts.volume.grid[at]
    tips = grid + shown.factor * facts.volume.error[at]
    classes = heat_classes(1e6 * facts.volume.length[at], step)
    items: list[Item] = [*box(low, high), *trackers(facts)]
    for level in range(LEVELS):
        own = classes == level
        if own.any():
            ends = np.stack([grid[own], tips[own]], axis=1)
            items.append(Strokes(f'heat arrow h{level}', ends, arrows=True))
    return scene(items, low, high, 'error vectors in the volume', shown=shown)


def _spheres(facts: Facts, shown: Magnification) -> str:
    low, high = facts.machine.lower, facts.machine.upper
    u = facts.k_volume * facts.volume.u_size[_drawn(facts)]
    grid = facts.volume.grid[_drawn(facts)]
    items: list[Item] = [*box(low, high), *trackers(facts)]
    order = np.array_split(np.argsort(u), DOT_RADII)
    items += [Dots('after disc', grid[own], shown.factor * float(u[own].mean())) for own in order]
    return scene(items, low, high, 'uncertainty after compensation in the volume', shown=shown)
