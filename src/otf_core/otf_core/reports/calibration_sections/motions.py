# SPDX-License-Identifier: Apache-2.0
"""All 18 error motions: pictures with bands, and one line of numbers each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.calibration.result import GAUGE, CalibrationResult
from otf_core.files.csv_points import tidy
from otf_core.model.expanded import figure, micro_with_expanded, significant
from otf_core.model.frames import XYZ
from otf_core.model.motions import DIRECTIONS, MOTIONS, ErrorMotion
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.calibration_pictures import STATE_KINDS
from otf_core.reports.drawing.panel import Panel, words
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.quantities import dof_words, micro_unit
from otf_core.reports.section import Picture, Section, Table

Array = NDArray[np.float64]

HIGHEST = 4.0
"""Height of a limit, in that of what is drawn, up to which it is drawn."""
ROLES = {True: 'positioning', False: 'straightness'}


def role(motion: ErrorMotion) -> str:
    """What a motion is called."""
    if motion.is_translation:
        return ROLES[motion.is_positioning]
    return 'roll' if motion.along == motion.place else f'rotation about {XYZ[motion.along]}'


def section(facts: Facts) -> Section:
    """Return the section."""
    rows = tuple(_row(facts, name) for name in MOTIONS)
    head = ('Motion', 'Is', 'Unit', 'Nodes', 'Smallest', 'Largest', 'Span', 'Mean u, k = 1',
            'Largest U, 95 %', 'k', 'dof')  # fmt: skip
    table = Table(head, rows, numbers=tuple(range(3, 11)))
    words_ = (
        *_largest(facts),
        'One picture for each error motion, over the position of its axis. Scales differ.',
    )
    text = ('motion  unit  nodes       min       max  largest U  holds',
            *(_text(facts, name) for name in MOTIONS),
            '', f'Gauge: {GAUGE}.', spacing_words(facts.result), '')  # fmt: skip
    return Section('motions', 'Error motions', words_, _data(facts), (table,), text,
                   draw=lambda: _pictures(facts))  # fmt: skip


def _largest(facts: Facts) -> list[str]:
    """The motions that reach farthest from their zero, and where."""
    found = []
    for unit, kind in (('m', 'displacement'), ('rad', 'rotation')):
        known = [n for n in facts.by_name if n in MOTIONS and facts.by_name[n].unit == unit]
        if not known:
            continue
        name = max(known, key=lambda n: float(np.abs(facts.tables.motions[n].value).max()))
        motion, table = ErrorMotion.of(name), facts.tables.motions[name]
        k = int(np.abs(table.value).argmax())
        wide = float(facts.result.expanded[name][k])
        at = tidy(1e3 * float(table.position[k]))
        value = micro_with_expanded(float(table.value[k]), wide, unit)
        found.append(
            f'Largest {kind}: {name}, {role(motion)}, {value} at {motion.axis} '
            f'{at:g} mm (U, 95 %).'
        )
    return found


def _data(facts: Facts) -> dict[str, object]:
    return {
        name: {'min': float(t.value.min()), 'max': float(t.value.max()), 'unit': name.unit,
               'mean_u': float(t.u.mean()), 'identifiable': t.identifiable}
        for name in MOTIONS
        for t in [facts.tables.motions[name]]
    }  # fmt: skip


def _row(facts: Facts, name: ErrorMotion) -> tuple[str, ...]:
    table, line = facts.tables.motions[name], facts.by_name.get(name)
    start = (str(name), role(name), micro_unit(name.unit), str(len(table.position)))
    if not table.identifiable:
        return (*start, 'not known', *[''] * 6)
    low, high = float(table.value.min()), float(table.value.max())
    k = line.k if line else 0.0
    dof = '' if line is None else dof_words(line.dof)
    whole = facts.result.expanded[name]
    wide = 1e6 * float(whole.max())
    sizes = (figure(1e6 * size, wide) for size in (low, high, high - low))
    mean = figure(1e6 * float(whole.mean()) / max(k, 1.0), wide)
    return (*start, *sizes, mean, significant(wide), f'{k:.2f}', dof)


def _text(facts: Facts, name: ErrorMotion) -> str:
    table = facts.tables.motions[name]
    row = f'{name:<8}{micro_unit(name.unit):<6}{len(table.position):>5}'
    if not table.identifiable:
        return row + '   not identifiable in these data'
    wide = 1e6 * float(facts.result.expanded[name].max())
    low, high = (figure(1e6 * float(v), wide) for v in (table.value.min(), table.value.max()))
    row += f'{low:>10}{high:>10}{significant(wide):>11}'
    return f'{row}  {facts.result.offset_bound.words(name)}'.rstrip()


def spacing_words(result: CalibrationResult) -> str:
    """What straight lines between the nodes cost."""
    wish, taken = result.table_costs[1], result.table_costs[result.fraction]
    worst = max(wish.motions, key=lambda name: wish.motions[name])
    unit = micro_unit(ErrorMotion.of(worst).unit)
    costs = (
        f'straight lines between nodes cost {1e6 * wish.grid:.2f} um on the grid '
        f'(most in {worst}: {1e6 * wish.motions[worst]:.2f} {unit})'
    )
    if result.fraction == 1:
        return f'Nodes stand table_pitch apart; {costs}.'
    return (
        f'Nodes stand at 1/{result.fraction} of table_pitch, where straight lines cost '
        f'{1e6 * taken.grid:.2f} um on the grid; at table_pitch {costs}.'
    )


def _pictures(facts: Facts) -> Sequence[Picture]:
    panels = tuple(
        _panel(facts, ErrorMotion(direction, axis))
        for direction in DIRECTIONS
        for axis in facts.machine.axis_names
    )
    both = (
        'Forward (dashed) and backward (dotted) travel where they differ. '
        if facts.both_ways
        else ''
    )
    limits = (
        'Dashed level lines: a band as high as the limit of the span. '
        if facts.machine.limits
        else ''
    )
    caption = (
        f'The last letter is the axis that moves; a wide page has its motions one below the '
        f'other. Line with nodes: mean of both senses of travel; band: U (95 %), pointwise. '
        f'{both}{limits}'
        f'Rings: nodes that the data do not determine, continued smoothly.'
    )
    return [Picture(panels, caption, columns=3)]


def _panel(facts: Facts, name: ErrorMotion) -> str:
    table = facts.tables.motions[name]
    unit = 'µm' if name.is_translation else 'µrad'
    heading = f'{name} {role(name)}'
    along = Scale(*_ends(1e3 * table.position), f'{name.axis} (mm)')
    if not table.identifiable:
        panel = Panel(along, Scale(-1.0, 1.0, f'{name} ({unit})', marks=1))
        marks = [words(190.0, 100.0, 'not identifiable in these data', 'middle soft')]
        return panel.draw(marks, f'{name}: not identifiable', heading)
    x, y = 1e3 * table.position, 1e6 * table.value
    u = 1e6 * facts.result.expanded[name]
    reversal = facts.result.reversal.motions.get(name)
    half = 0.5e6 * reversal.value if reversal is not None and reversal.identifiable else None
    sides = [y] if half is None else [y, y + half, y - half]
    reach = np.concatenate([*sides, y - u, y + u])
    limit, edges = _limit(facts, name, np.concatenate(sides), reach)
    scale = around(np.concatenate([reach, edges]), f'{name} ({unit})')
    heading += limit
    panel = Panel(along, scale)
    marks = [panel.band(x, y - u, y + u, 'after band')]
    if scale.low < 0 < scale.high:
        marks.append(panel.level(0.0, 'soft'))
    marks += [panel.level(float(edge), f'{_state_kind(facts, name)} dash') for edge in edges]
    if half is not None:
        marks.append(panel.line(x, y + half, 'before dash'))
        marks.append(panel.line(x, y - half, 'before dot'))
    marks += [panel.line(x, y, 'after'), panel.dots(x, y, 'after node')]
    known = table.node_identifiable
    if known is not None and not known.all():
        marks.append(panel.rings(x[~known], y[~known]))
    return panel.draw(marks, f'{name} over {name.axis}, with uncertainty', heading)


def _limit(facts: Facts, name: ErrorMotion, values: Array, reach: Array) -> tuple[str, Array]:
    """Words on the limit of a motion, and the edges (0 or 2,) of a band as high as it.

    The limit is on the span, so the band lies about the middle of the values (n,); where it is
    much higher than what is drawn, ``reach`` (n,), it is in words alone.
    """
    limits = facts.machine.limits
    limit = limits.values.get(name) if limits else None
    if limit is None:
        return '', np.zeros(0)
    wide, middle = 1e6 * limit, 0.5 * (values.max() + values.min())
    words_ = f', limit {wide:g} {micro_unit(name.unit)}'
    if wide > HIGHEST * np.ptp(reach):
        return f'{words_}, beyond the scale', np.zeros(0)
    return words_, middle + 0.5 * wide * np.array([-1.0, 1.0])


def _state_kind(facts: Facts, name: ErrorMotion) -> str:
    """Class of the limit of a motion by its state."""
    verdict = facts.result.machine_verdict
    found = [one.state for one in verdict.judged if one.name == name] if verdict else []
    return STATE_KINDS.get(found[0], '') if found else ''


def _ends(position: Array) -> tuple[float, float]:
    low, high = float(position[0]), float(position[-1])
    return (low, high) if high > low else (low - 0.5, high + 0.5)
