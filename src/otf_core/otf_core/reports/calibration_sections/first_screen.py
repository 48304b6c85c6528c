# SPDX-License-Identifier: Apache-2.0
"""First screen of a page, summary on a terminal, verdict: is it good, how large is the error.

The first pictures of a calibration: the volume before and after, all errors with limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.calibration.machine_verdict import size_and_u
from otf_core.model.expanded import (
    figure,
    micro_figure,
    micro_significant,
    micro_with_expanded,
    significant,
)
from otf_core.model.machine import TABLE
from otf_core.model.motions import unit_of
from otf_core.model.sections import VOLUMETRIC
from otf_core.prediction.calibration_document import (
    FAIL,
    LIMIT_MEANING,
    OPEN,
    PASS,
    UNKNOWN,
    LimitVerdict,
    Verdicts,
)
from otf_core.reports.calibration_facts import (
    CalibrationFacts,
    measurement_dates,
    position_words,
)
from otf_core.reports.drawing.panel import LEVELS, Bar, bars, heat_classes, heat_key, heat_step
from otf_core.reports.drawing.scene import (
    SCRIPT,
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
from otf_core.reports.page import (
    Cell,
    Heading,
    Picture,
    Section,
    State,
    Table,
    join_names,
    micro,
    micro_unit,
)

DRAWN_POINTS = 64
"""Points of the volume that are drawn, about."""
ARROW_REACH = 0.9
"""Length of the longest arrow, in distances between arrows along the shortest edge of a cube."""
BOUND = '*'
"""Stands behind the name of an error that holds at one target offset only."""
DOT_RADII = 8
"""Different radii that are drawn."""
STATE_KINDS = {PASS: 'good', FAIL: 'bad', OPEN: 'open'}
"""Class of a bar by the state of its limit."""


@dataclass(frozen=True)
class ErrorSize:
    """How large one of the errors is.

    Attributes
    ----------
    unit : str
        m or rad.
    value, U : float
        Span of a motion, size of a scalar; expanded uncertainty (95 %).
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


def error_sizes(facts: CalibrationFacts) -> list[ErrorSize]:
    """All errors in the order of the tables: motions, then scalars."""
    result = facts.result
    limits = facts.machine.limits.values if facts.machine.limits else {}
    states = {one.name: one.state for one in result.verdicts.machine.limits}
    sizes = []
    for name in (*map(str, facts.machine.motions), *facts.machine.scalars):
        known = name not in result.not_identifiable
        value, u, k = size_and_u(name, facts.tables, result.budget) if known else (0.0, 0.0, 0.0)
        wide = k * u
        sizes.append(ErrorSize(name, unit_of(name), value, wide, limits.get(name),
                               states.get(name, ''), known,
                               known and name in result.offset_bound.contains))  # fmt: skip
    return sizes


def error_bars(facts: CalibrationFacts) -> Picture:
    """All errors as bars with U and limits: displacements left, angles right."""
    sizes = error_sizes(facts)
    parts = []
    for unit in ('m', 'rad'):
        rows = [_bar(one) for one in sizes if one.unit == unit]
        parts.append(bars(rows, f'size of all errors in {micro_unit(unit)}', names=44.0,
                          width=480.0))  # fmt: skip
    limited = [one for one in sizes if one.limit is not None]
    keys = [('after', 'no limit stated')] if len(limited) < len(sizes) else []
    states = {one.state for one in limited if one.known}
    keys += [(STATE_KINDS[s], s) for s in (PASS, OPEN, FAIL) if s in states]
    key = ''.join(
        f'<span class="{kind}-key"><span class="key"></span>{text(said)}</span> '
        for kind, said in keys
    )
    stroke = ' Vertical mark: the limit.' if limited else ''
    caption = (
        f'Span (largest minus smallest value) of an error motion, size of any other error; '
        f'line at the end of a bar: U (95 %).{stroke}{bound_words(facts)}'
    )
    legend = f'<p class="soft keys">{key}</p>' if limited else ''
    return Picture(tuple(parts), caption, columns=2, title=f'All {len(sizes)} errors', key=legend)


def bound_words(facts: CalibrationFacts) -> str:
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
    label = f'{micro_with_expanded(one.value, one.U, one.unit)}{stated}'
    kind = STATE_KINDS.get(one.state, 'after')
    ends = (max(value - wide, 0.0), value + wide)
    return Bar(name, ((value, kind),), label, limit, ends)


def volume_pictures(facts: CalibrationFacts) -> Picture:
    """The volume before and after at one scale of colours and of arrows."""
    volume, k = facts.volume, facts.result.headline.k
    longest = float(volume.length.max())
    step = heat_step(1e6 * volume.length)
    low, high = facts.box
    spacing = float((high - low).min()) / (DRAWN_POINTS ** (1 / 3) - 1.0)
    shown = magnification(max(longest, k * float(volume.u_size.max())), ARROW_REACH * spacing)
    limit = facts.machine.limits.values.get(VOLUMETRIC) if facts.machine.limits else None
    stated = '' if limit is None else f', limit {1e6 * limit:g} um'
    return Picture(
        (_arrows(facts, step, shown), _spheres(facts, shown)),
        f'Left, before: error vectors as found{stated}. Right, after: expected with these '
        f'tables loaded, U (95 %) of the vector as radius; predicted, not '
        f'measured. Both at the same scale.',
        columns=2,
        hint=TURNED,
        key=heat_key(step, 1e6 * longest, 'µm'),
    )


def _drawn(facts: CalibrationFacts) -> NDArray[np.int64]:
    """Which points of the volume are drawn: every other of a lattice, the first of others."""
    size, axes = len(facts.volume.grid), len(facts.machine.axis_names)
    count = round(size ** (1 / axes))
    if count**axes != size or axes > 3:
        return np.arange(min(size, DRAWN_POINTS))
    use = np.arange(0, count, 2)
    every = np.arange(size).reshape((count,) * axes)
    return np.asarray(every[np.ix_(*[use] * axes)].ravel())


def trackers(facts: CalibrationFacts) -> list[Item]:
    """Marks of the places of the tracker, runs from one place once; of one on the table."""
    places: list[Array] = []
    for run in facts.result.runs if facts.machine.tracker.link == TABLE else ():
        own = run.T_machine_tracker.translation
        if all(np.linalg.norm(own - other) > 1e-2 for other in places):
            places.append(own)
    return [item for place in places for item in tracker_items(place, *facts.box)]


def _arrows(facts: CalibrationFacts, step: float, shown: Magnification) -> str:
    at, (low, high) = _drawn(facts), facts.box
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


def _spheres(facts: CalibrationFacts, shown: Magnification) -> str:
    at, (low, high) = _drawn(facts), facts.box
    u, grid = facts.result.headline.k * facts.volume.u_size[at], facts.volume.grid[at]
    items: list[Item] = [*box(low, high), *trackers(facts)]
    order = np.array_split(np.argsort(u), min(DOT_RADII, len(u)))
    items += [Dots('after disc', grid[own], shown.factor * float(u[own].mean())) for own in order]
    return scene(items, low, high, 'uncertainty after compensation in the volume', shown=shown)


NAMED_CONTRIBUTORS = 3
"""Motions that are named as the largest contributors."""
MOODS = {PASS: 'good', FAIL: 'bad', OPEN: 'open', UNKNOWN: 'open'}
SUMMARY_CONTRIBUTORS = 4
"""Errors that are named as the largest contributors."""
SUMMARY_WARNINGS, SUMMARY_WIDTH = 3, 110
"""Warnings that are shown, and letters of each; report.html has all of them."""


def overview_section(facts: CalibrationFacts) -> Section:
    """First screen: is it good, how large is the error, where is it worst, what is not known."""
    result, volume = facts.result, facts.volume
    now = result.headline.error
    at = volume.positions[int(np.argmax(volume.length))]
    worst = list(result.headline.contributions.items())[:NAMED_CONTRIBUTORS]
    mean = result.headline.expanded['mean']
    words = [
        f'Worst: the longest error vector of {facts.points}, '
        f'{micro_figure(now["max"], result.headline.of_largest)}, lies at '
        f'{position_words(facts.machine, at)}. It is mainly due to '
        + join_names(f'{name} ({micro_figure(size, mean)})' for name, size in worst)
        + ', each alone, root mean square over the volume.',
        *_unknown_words(facts),
    ]
    warnings = [
        f'Warning: {w}' for w in result.warnings if not facts.typical or w != facts.typical.warning
    ]
    return Section(
        'overview',
        '',
        tuple(words + warnings),
        {
            'headline': result.headline.to_dict(),
            'verdicts': result.verdicts.to_dict(),
            'worst_at': at.tolist(),
            'contributions': dict(result.headline.contributions),
            'warnings': list(result.warnings),
        },
        draw=lambda: (volume_pictures(facts), error_bars(facts)),
        script=SCRIPT,
    )


def heading(facts: CalibrationFacts) -> Heading:
    """Top of the page."""
    result, machine = facts.result, facts.machine
    error, expected, _ = result.headline.sentences
    sentence = f'{error[:1].upper()}{error[1:]}; {expected}.'
    return Heading(
        f'Calibration of {machine.name}, chain {machine.chain}',
        sentence,
        badges(result.verdicts),
        _tiles(facts),
        running_words(facts),
    )


def badges(verdicts: Verdicts) -> tuple[State, State]:
    """One for the measurement, one for the machine."""
    measurement = (
        State('measurement: good', 'good')
        if verdicts.measurement.good
        else State('measurement: not good', 'bad')
    )
    machine = verdicts.machine
    if not machine.limits:
        return measurement, State('machine: no limits stated')
    mood = {PASS: 'good', FAIL: 'bad'}.get(machine.state, 'open')
    return measurement, State(machine.sentence, mood)


def running_words(facts: CalibrationFacts) -> str:
    """Head of printed pages: machine, run, date."""
    date = measurement_dates(facts.result.origin) or f'written {facts.provenance["written"]}'
    return f'{facts.machine.name}, run {facts.result.run_id}, {date}'


def _unknown_words(facts: CalibrationFacts) -> list[str]:
    result, lines = facts.result, []
    if result.not_identifiable:
        lines.append(
            f'Not known: {join_names(result.not_identifiable)} cannot be determined from these '
            f'data; they are zero in the tables.'
        )
        lines += [f'{line}.' for line in result.needs]
    if facts.typical:
        lines.append(
            f'Not declared in machine.yaml: {join_names(facts.typical.missing)}; U includes '
            f'typical values for them.'
        )
    return lines or ['Not known: all motions were determined and all contributions declared.']


def _tiles(facts: CalibrationFacts) -> tuple[tuple[str, str, str], ...]:
    first, fit = facts.result.headline, facts.result.fit
    return (
        (
            'Volumetric error, as found',
            micro_with_expanded(first.error['max'], first.of_largest),
            f'largest; mean {micro_figure(first.error["mean"], first.expanded["mean"])}',
        ),
        (
            'Expected after compensation',
            micro_significant(first.expanded['max']),
            f'largest U (k = {first.k:.3g}), mean {micro_significant(first.expanded["mean"])}; '
            f'{first.label}; {first.sentences[2]}',
        ),
        (
            'Distance from the path, measured',
            f'{micro(fit.path_mae_before)} → {micro(fit.path_mae_after)} um',
            'mean, before and after compensation, on the run from which the tables were '
            'determined',
        ),
    )


def limits_section(facts: CalibrationFacts) -> Section:
    """Verdict by the limits of machine.yaml, limit by limit."""
    verdict, typical = facts.result.verdicts.machine, facts.typical
    rule = (
        'Decision rule (ISO 14253-1): a limit is met if value + U is at most the limit, '
        'exceeded if value - U is above it; in between, neither is proven and the check is not '
        'passed.'
    )
    if not verdict.limits:
        lead = 'No verdict: machine.yaml states no limits (section limits).'
        return Section('limits', 'Verdict', (lead, rule))
    words = [f'{verdict.sentence[:1].upper()}{verdict.sentence[1:]}.', rule]
    if typical:
        words.append(
            f'U includes typical values for what machine.yaml does not declare: '
            f'{join_names(typical.missing)}.'
        )
    rows = tuple(_limit_row(one) for one in verdict.limits)
    head = ('Quantity', 'Value', 'U (95 %)', 'Limit', 'Unit', 'State')
    table = Table(head, rows, numbers=(1, 2, 3), stacked=True)
    return Section('limits', 'Verdict', tuple(words), facts.result.verdicts.to_dict(), (table,))


def _limit_row(one: LimitVerdict) -> tuple[Cell, ...]:
    what = LIMIT_MEANING.get(one.name, f'{one.name}')
    unit = micro_unit(one.unit)
    value = '' if one.state == UNKNOWN else figure(1e6 * one.value, 1e6 * (one.U or one.value))
    wide = significant(1e6 * one.U) if one.U else ''
    return what, value, wide, f'{1e6 * one.limit:g}', unit, State(one.state, MOODS[one.state])
