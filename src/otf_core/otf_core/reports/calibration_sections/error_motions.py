# SPDX-License-Identifier: Apache-2.0
"""Errors of the axes: motions, squareness, location, forward and backward travel, all nodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.files.writing import tidy
from otf_core.model.expanded import (
    COVERAGE_FACTOR,
    figure,
    micro_with_expanded,
    significant,
    with_expanded,
)
from otf_core.model.frames import XYZ
from otf_core.model.machine import SPINDLE
from otf_core.model.motions import DIRECTIONS, ErrorMotion, unit_of
from otf_core.model.tables import ErrorTables
from otf_core.reports.calibration_facts import CalibrationFacts
from otf_core.reports.calibration_sections.first_screen import STATE_KINDS
from otf_core.reports.drawing.panel import Panel, Scale, polyline, scale_around, svg
from otf_core.reports.drawing.panel import words as svg_words
from otf_core.reports.page import (
    Cell,
    Picture,
    Section,
    Table,
    dof_words,
    join_names,
    micro,
    micro_unit,
)
from otf_core.solving.reversal import MODELS, Reversal

# Reversal of a calibration as plain data and in words.
#
# Sign: reversal value = error in forward travel (towards larger positions) less error in backward
# travel, as ISO 230-2 takes the difference of the means of the two directions of approach; forward
# and backward are the mean of the error table plus and minus half of it.


def _directions(
    reversal: Reversal, tables: ErrorTables
) -> Iterator[tuple[str, Array, Array, bool]]:
    for name, table in reversal.motions.items():
        mean = tables.motions[name].value
        forward, backward = mean + 0.5 * table.value, mean - 0.5 * table.value
        yield name, forward, backward, table.identifiable


def why_reversal(reversal: Reversal) -> list[str]:
    """Why this model of reversal was chosen: sentences."""
    evidence = reversal.evidence
    if 'lines' not in evidence or 'needed' not in evidence:
        decided = evidence.get('decided_by')
        return [f'Decided by {decided}.'] if decided else []
    lines = []
    for model in MODELS:
        if f'gain_{model}' in evidence:
            gain, scatter = evidence[f'gain_{model}'], evidence[f'scatter_{model}']
            lines.append(
                f'Model {model}: gain over the best simpler model on {evidence["lines"]} held-out '
                f'lines {gain:.1f} +/- {scatter:.1f}; {evidence["needed"]:g} times the scatter is '
                f'needed.'
            )
    if 'rival' in evidence:
        lines.append(
            f'But {evidence["rival"]} explains these legs better: an error that changes sign '
            f'with the direction of travel and grows with the feed; see otf diagnose.'
        )
    return lines


def backlash_words(reversal: Reversal) -> str:
    """Reversal value of every axis at the target, with its expanded uncertainty."""
    if not reversal.backlash:
        return ''
    sizes = [f'{axis} {size.words}' for axis, size in reversal.backlash.items()]
    return (
        f'backlash at the target (forward minus backward, k = 2): {", ".join(sizes)}; on the '
        f'middle line of the axis, including the reversal of rotations'
    )


CIRCLE, MAGNIFIED, CENTRE = 70.0, 35.0, 120.0
"""px; radius of the circle of a radial motion, of the largest motion on it, and its centre."""
LIMIT_HEIGHT_RATIO = 4.0
"""Height of a limit, in that of what is drawn, up to which it is drawn."""
ROLES = {True: 'positioning', False: 'straightness'}
ANGLES = {'C0Y': ('+X', '+Y', 1.0), 'B0Z': ('+X', '+Z', -1.0), 'A0Z': ('+Y', '+Z', 1.0)}
"""Directions between which a squareness error changes the angle, and the sign of the change."""
TILTS = {'C0Y': '+Y to -X', 'B0Z': '+Z to +X', 'A0Z': '+Z to -Y'}
"""What a positive value does."""
ARCSEC = np.pi / 648000
DERIVED = (
    'Derived from continuous travel, not an ISO 230-2 test: there are no targets approached at '
    'standstill and no five repetitions, so A and R, which need the repeatability, are not given.'
)
FEW_DATA_BELOW = 100
"""Samples around a node below which they are called few."""


def role(motion: ErrorMotion) -> str:
    """What a motion is called."""
    if motion.axis in XYZ:
        if motion.is_translation:
            return ROLES[motion.is_positioning]
        return 'roll' if motion.along == motion.place else f'rotation about {XYZ[motion.along]}'
    if motion.is_positioning:
        return 'angular positioning'
    if not motion.is_translation:
        return f'tilt about {XYZ[motion.along]}'
    axial = motion.along == 'ABC'.index(motion.axis)
    return 'axial motion' if axial else f'radial motion in {motion.direction}'


def motions_section(facts: CalibrationFacts) -> Section:
    """All error motions: pictures with bands, and one line of numbers each."""
    motions = facts.machine.motions
    rows = tuple(_motion_row(facts, name) for name in motions)
    head = ('Motion', 'Is', 'Unit', 'Nodes', 'Smallest', 'Largest', 'Span', 'Mean u, k = 1',
            'Largest U, 95 %', 'k', 'dof')  # fmt: skip
    table = Table(head, rows, numbers=tuple(range(3, 11)))
    words = (
        *_largest_motions(facts),
        'One picture for each error motion, over the position of its axis. Scales differ.',
    )
    data: dict[str, object] = {
        name: {'min': float(t.value.min()), 'max': float(t.value.max()), 'unit': name.unit,
               'mean_u': float(t.u.mean()), 'identifiable': t.identifiable}
        for name in motions
        for t in [facts.tables.motions[name]]
    }  # fmt: skip
    return Section('motions', 'Error motions', words, data, (table,),
                   draw=lambda: _motion_pictures(facts))  # fmt: skip


def _largest_motions(facts: CalibrationFacts) -> list[str]:
    """The motions that reach farthest from their zero, and where."""
    largest = []
    for unit, kind in (('m', 'displacement'), ('rad', 'rotation')):
        known = [m for m in facts.machine.motions if m in facts.by_name and m.unit == unit]
        if not known:
            continue
        motion = max(known, key=lambda m: float(np.abs(facts.tables.motions[m].value).max()))
        table = facts.tables.motions[motion]
        k = int(np.abs(table.value).argmax())
        wide = float(facts.result.expanded[motion][k])
        factor, along = facts.machine.axes[motion.axis].shown
        at = tidy(factor * float(table.position[k]))
        value = micro_with_expanded(float(table.value[k]), wide, unit)
        largest.append(
            f'Largest {kind}: {motion}, {role(motion)}, {value} at {motion.axis} '
            f'{at:.6g} {along} (U, 95 %).'
        )
    return largest


def _motion_row(facts: CalibrationFacts, name: ErrorMotion) -> tuple[str, ...]:
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


def _motion_pictures(facts: CalibrationFacts) -> Sequence[Picture]:
    both = (
        'Forward (dashed) and backward (dotted) travel where they differ. '
        if facts.both_ways
        else ''
    )
    limits = (
        'Dashed horizontal lines: a band of the height of the span limit. '
        if facts.machine.limits
        else ''
    )
    pictures = []
    for axis, spec in facts.machine.axes.items():
        panels = tuple(_motion_panel(facts, ErrorMotion(d, axis)) for d in DIRECTIONS)
        pictures.append(Picture(panels, '', columns=3, title=f'Axis {axis}'))
        if spec.rotary and len(facts.tables.motions[f'E{axis}{axis}'].position) > 1:
            caption = (
                f'Radial motion of {axis} about its average line; the circle is zero, the scale '
                f'is magnified.'
            )
            pictures.append(Picture((_radial_motion(facts, axis),), caption))
    caption = (
        f'The last letter is the axis that moves. Line with nodes: mean of both directions of '
        f'travel; band: U (95 %), pointwise. '
        f'{both}{limits}Rings: nodes that the data do not determine, continued smoothly.'
    )
    return [replace(pictures[0], caption=caption), *pictures[1:]]


def _radial_motion(facts: CalibrationFacts, axis: str) -> str:
    """Radial motion of a rotary axis in the direction to the angle itself, about a circle."""
    along = int(np.argmax(np.abs(np.array(facts.machine.axes[axis].direction))))
    first, second = (facts.tables.motions[f'E{XYZ[(along + k) % 3]}{axis}'] for k in (1, 2))
    angle = np.linspace(first.position[0], first.position[-1], 361)
    radial = 1e6 * (np.cos(angle) * first.at(angle) + np.sin(angle) * second.at(angle))
    reach = max(float(np.abs(radial).max()), 1e-3)

    def circle(values: Array) -> str:
        size = CIRCLE + MAGNIFIED * values / reach
        return polyline(CENTRE + np.column_stack([size * np.cos(angle), -size * np.sin(angle)]))

    marks = [
        f'<path class="line soft" d="{circle(np.zeros_like(radial))}"/>',
        f'<path class="line after" d="{circle(radial)}"/>',
        svg_words(CENTRE, CENTRE, f'{MAGNIFIED:g} px = {reach:.2f} µm', 'middle soft'),
        svg_words(CENTRE + CIRCLE + 42.0, CENTRE, '0 deg', 'soft'),
    ]
    return svg(2.0 * CENTRE + 50.0, 2.0 * CENTRE, marks, f'radial motion of {axis}')


def _motion_panel(facts: CalibrationFacts, name: ErrorMotion) -> str:
    table = facts.tables.motions[name]
    factor, along_unit = facts.machine.axes[name.axis].shown
    unit = 'µm' if name.is_translation else 'µrad'
    heading = f'{name} {role(name)}'
    along = Scale(*_ends(factor * table.position), f'{name.axis} ({along_unit})')
    if not table.identifiable:
        panel = Panel(along, Scale(-1.0, 1.0, f'{name} ({unit})', marks=1))
        marks = [svg_words(190.0, 100.0, 'not identifiable in these data', 'middle soft')]
        return panel.draw(marks, f'{name}: not identifiable', heading)
    x, y = factor * table.position, 1e6 * table.value
    u = 1e6 * facts.result.expanded[name]
    reversal = facts.result.reversal.motions.get(name)
    half = 0.5e6 * reversal.value if reversal is not None and reversal.identifiable else None
    sides = [y] if half is None else [y, y + half, y - half]
    reach = np.concatenate([*sides, y - u, y + u])
    limit, edges = _limit_band(facts, name, np.concatenate(sides), reach)
    scale = scale_around(np.concatenate([reach, edges]), f'{name} ({unit})')
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
    if not table.nodes_seen.all():
        marks.append(panel.rings(x[~table.nodes_seen], y[~table.nodes_seen]))
    return panel.draw(marks, f'{name} over {name.axis}, with uncertainty', heading)


def _limit_band(
    facts: CalibrationFacts, name: ErrorMotion, values: Array, reach: Array
) -> tuple[str, Array]:
    """Words on the limit of a motion, and the edges (0 or 2,) of a band as high as it.

    The limit is on the span, so the band lies about the middle of the values (n,); where it is
    much higher than what is drawn, ``reach`` (n,), it is in words alone.
    """
    limits = facts.machine.limits
    limit = limits.values.get(name) if limits else None
    if limit is None:
        return '', np.zeros(0)
    wide, middle = 1e6 * limit, 0.5 * (values.max() + values.min())
    words = f', limit {wide:g} {micro_unit(name.unit)}'
    if wide > LIMIT_HEIGHT_RATIO * np.ptp(reach):
        return f'{words}, beyond the scale', np.zeros(0)
    return words, middle + 0.5 * wide * np.array([-1.0, 1.0])


def _state_kind(facts: CalibrationFacts, name: ErrorMotion) -> str:
    """Class of the limit of a motion by its state."""
    limits = facts.result.verdicts.machine.limits
    states = [one.state for one in limits if one.name == name]
    return STATE_KINDS.get(states[0], '') if states else ''


def _ends(position: Array) -> tuple[float, float]:
    low, high = float(position[0]), float(position[-1])
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def squareness_words(name: str, value: float, wide: float) -> str:
    """State a squareness error as an angle, to the last stated digit of its U.

    C0Y > 0 tilts +Y to -X, B0Z > 0 tilts +Z to +X, A0Z > 0 tilts +Z to -Y.

    Parameters
    ----------
    name : str
        C0Y, B0Z or A0Z.
    value, wide : float, rad
        The error and its expanded uncertainty.
    """
    one, other, sign = ANGLES[name]
    change = sign * value
    mark = '-' if change < 0 else '+'
    return (
        f'angle between {one} and {other} is 90 deg {mark} '
        f'{figure(1e6 * abs(change), 1e6 * wide)} urad '
        f'({figure(abs(change) / ARCSEC, wide / ARCSEC)} arcsec)'
    )


def squareness_section(facts: CalibrationFacts) -> Section | None:
    """Squareness errors as angles in words, in both habits of sign."""
    if not facts.machine.squareness:
        return None
    result, bound = facts.result, facts.result.offset_bound
    rows: list[tuple[Cell, ...]] = []
    data, angles = {}, []
    for name in facts.machine.squareness:
        entry = facts.tables.squareness[name]
        if name in result.not_identifiable:
            rows.append((name, 'not known', '', '', '', ''))
            angles.append(f'{name}: not identifiable in these data{needs_words(facts, name)}.')
            continue
        wide = float(result.expanded[name][0])
        larger = ANGLES[name][2] * entry.value
        statement, holds = squareness_words(name, entry.value, wide), bound.words(name)
        data[name] = {'value': entry.value, 'u': entry.u, 'U': wide, 'larger_than_90': larger,
                      'words': statement, 'holds': holds}  # fmt: skip
        figures = [figure(1e6 * v, 1e6 * wide) for v in (entry.value, larger)]
        rows.append((name, *figures, significant(1e6 * wide), significant(1e6 * entry.u),
                     holds or 'at any target offset'))  # fmt: skip
        angles.append(f'{name}: {statement}{f", {holds}" if holds else ""}.')
    words = (
        *angles,
        'Two sign conventions are in use. Here and in all files the value is a right-handed '
        f'rotation: a positive value tilts {"; ".join(f"{n}: {t}" for n, t in TILTS.items())}. '
        f'In the other convention a positive value means'
        ' an angle larger than 90 degrees; the two differ only for B0Z.',
    )
    head = ('', 'Value (urad)', 'Larger than 90 deg positive (urad)', 'U (urad)',
            'u in the files, k = 1 (urad)', 'Holds')  # fmt: skip
    table = Table(head, tuple(rows), numbers=(1, 2, 3, 4))
    return Section('squareness', 'Squareness', words, data, (table,))


def needs_words(facts: CalibrationFacts, name: str) -> str:
    """What would show an error that the data do not show, where that is known."""
    need = facts.result.advice.get(name)
    return f'; needs {need}' if need else ''


def location_section(facts: CalibrationFacts) -> Section | None:
    """Lines of the rotary axes in words, in both habits of sign."""
    location, result = facts.tables.location, facts.result
    if not location:
        return None
    words = [f'{location_words(facts, name)}.' for name in location]
    places = facts.machine.targets
    exact = [n for n in result.targets if places[n].link == SPINDLE and places[n].u == 0.0]
    if exact:
        words.append(
            f'The place of {join_names(exact)} in the spindle counts as exact (targets: u is 0, '
            f'that of tool also where it is not stated): U of location errors contains nothing '
            f'for it. With two lengths a spindle that leans makes a rotation of the axis that '
            f'carries it look wrong near its zero position; state u of all reflectors in the '
            f'spindle.'
        )
    data = {n: {'value': v.value, 'u': v.u, 'U': float(result.expanded[n][0]),
                'identifiable': v.identifiable} for n, v in location.items()}  # fmt: skip
    return Section('location', 'Location of rotary axes', tuple(words), data)


def location_words(facts: CalibrationFacts, name: str) -> str:
    """State which way the line of an axis lies, in both habits of sign."""
    own, axis, unit = facts.tables.location[name], name[2], unit_of(name)
    if not own.identifiable:
        return f'{name}: not identifiable in these data{needs_words(facts, name)}'
    value, wide = own.value, float(facts.result.expanded[name][0])
    found, size = (micro_with_expanded(v, wide, unit) for v in (value, abs(value)))
    if unit == 'm':
        side = f'{"+" if value >= 0 else "-"}{name[0]}'
        return (
            f'{name} = {found}: the average line of {axis} lies {size} towards {side} of its '
            f'nominal place. A control that stores the centre of {axis} is to add '
            f'{with_expanded(1e3 * value, 1e3 * wide)} mm to its {name[0]}; a table of '
            f'corrections holds the opposite sign'
        )
    turn = np.eye(3)['ABC'.index(name[0])] * np.sign(value or 1.0)
    direction = np.array(facts.machine.axes[axis].direction)
    lean = np.cross(turn, direction)
    end, side = (
        f'{"+" if vector[k] >= 0 else "-"}{XYZ[k]}'
        for vector in (direction, lean)
        for k in [int(np.argmax(np.abs(vector)))]
    )
    return (
        f'{name} = {found} ({abs(value) / ARCSEC:.2f} arcsec): the average line of {axis} leans '
        f'{size} from {end} towards {side}; the correction has the opposite sign'
    )


def targets_section(facts: CalibrationFacts) -> Section | None:
    """Places of the reflectors as they were found."""
    places = facts.result.targets
    if not places:
        return None
    rows = []
    for name, own in places.items():
        cells = [with_expanded(1e3 * p, COVERAGE_FACTOR * 1e3 * v)
                 for p, v in zip(own.place, own.u, strict=True)]  # fmt: skip
        moved = 1e3 * float(np.linalg.norm(own.place - facts.machine.targets[name].place))
        rows.append((name, own.link, *cells, f'{moved:.3f}'))
    head = ('target', 'link', 'x (mm)', 'y (mm)', 'z (mm)', 'away from nominal (mm)')
    return Section(
        'targets',
        'Places of the reflectors',
        ('As found, with U (k = 2); exact where machine.yaml states u = 0.',),
        {n: {'place': own.place.tolist(), 'u': own.u.tolist()} for n, own in places.items()},
        (Table(head, tuple(rows), (2, 3, 4, 5)),),
    )


def reversal_section(facts: CalibrationFacts) -> Section:
    """Forward and backward travel, and figures in the manner of ISO 230-2 derived from them."""
    reversal, lags = facts.result.reversal, facts.result.lags
    late = [
        f'{r.axis} is {"late" if r.value > 0.0 else "early"} against the axes that it is driven '
        f'with: ({1e6 * abs(r.value):.0f} +/- {1e6 * COVERAGE_FACTOR * r.u:.0f}) us.'
        for r in lags
    ]
    data: dict[str, object] = {'model': reversal.model}
    data |= {'lags': {r.axis: {'value': r.value, 'u': r.u} for r in lags}} if lags else {}
    if not facts.both_ways:
        statement = (
            f'Reversal model: {reversal.model}. The data do not distinguish forward from '
            f'backward travel, so no figures after ISO 230-2 can be derived.',
            *why_reversal(reversal),
            *late,
        )
        return Section('reversal', 'Forward and backward', statement, data)
    rows: list[tuple[str, ...]] = []
    derived = {}
    for axis, spec in facts.machine.axes.items():
        name = f'E{axis}{axis}'
        table, own = reversal.motions.get(name), facts.tables.motions[name]
        if table is None or not (table.identifiable and own.identifiable):
            rows.append((axis, micro_unit(spec.unit), 'not known', '', '', '', ''))
            continue
        both = np.concatenate([own.value + 0.5 * table.value, own.value - 0.5 * table.value])
        at = int(np.argmax(np.abs(table.value)))
        figures = {'E': float(np.ptp(both)), 'M': float(np.ptp(own.value)),
                 'B': float(abs(table.value[at])), 'B_mean': float(table.value.mean()),
                 'u_B': float(table.u[at])}  # fmt: skip
        derived[axis] = figures
        rows.append((axis, micro_unit(spec.unit), *(micro(v) for v in figures.values())))
    stay = 'stay on the side of their last travel' if reversal.held else 'lie between both sides'
    at_target = backlash_words(reversal)
    words = (
        f'Reversal model: {reversal.model}; axes at rest {stay}. A reversal value is the error '
        f'in forward travel (towards larger positions) less that in backward travel.',
        *([f'{at_target[:1].upper()}{at_target[1:]}.'] if at_target else []),
        *why_reversal(reversal),
        *late,
        DERIVED,
    )
    head = ('Axis', 'Unit', 'E, bidirectional systematic deviation', 'M, range of the mean',
            'B, largest reversal value', 'Mean reversal value', 'u of B, k = 1')  # fmt: skip
    tables = (
        Table(head, tuple(rows), numbers=(2, 3, 4, 5, 6), title='Derived, ISO 230-2 style'),
        reversal_table(reversal),
    )
    return Section('reversal', 'Forward and backward', words, {**data, 'derived': derived}, tables)


def reversal_table(reversal: Reversal) -> Table:
    """Reversal values of all motions, folded."""
    rows = []
    for name, table in reversal.motions.items():
        if table.identifiable:
            low, high = float(table.value.min()), float(table.value.max())
            rows.append((name, micro(low), micro(high), micro(float(table.u.mean()))))
        else:
            rows.append((name, 'not known', '', ''))
    head = ('Motion', 'Smallest', 'Largest', 'Mean u, k = 1')
    return Table(head, tuple(rows), numbers=(1, 2, 3), folded='Reversal values of all motions',
                 title='Forward minus backward (um, urad)')  # fmt: skip


def nodes_section(facts: CalibrationFacts) -> Section:
    """Every node of every table."""
    counts = {axis: node_counts(facts, axis) for axis in facts.machine.axis_names}
    tables = tuple(_node_table(facts, name, counts[name.axis]) for name in facts.machine.motions)
    words = (
        'Position in mm or degrees, value, u (k = 1) and U (95 %) in um or urad, as in '
        'error_tables.csv (there in m and rad). n_obs: samples nearer to this node than to its '
        'neighbours.',
    )
    return Section('nodes', 'All nodes', words, {}, tables)


def node_counts(facts: CalibrationFacts, axis: str) -> NDArray[np.int64]:
    """Samples used around every node of an axis, shape (k,)."""
    position = facts.tables.motions[f'E{axis}{axis}'].position
    edges = np.concatenate([[-np.inf], 0.5 * (position[1:] + position[:-1]), [np.inf]])
    k, wrapped = facts.machine.column(axis), facts.machine.axes[axis].wrapped
    q = np.concatenate([wrapped(run.q[:, k]) for run in facts.result.runs])
    count = np.concatenate([run.pieces.count for run in facts.result.runs])
    counts = np.histogram(q, edges, weights=count)[0]
    return np.asarray(counts, dtype=np.int64)


def _node_flag(seen: bool, identifiable: bool, count: int) -> str:
    if not identifiable:
        return 'unobservable'
    if not seen:
        return 'not determined, continued'
    return 'few data' if count < FEW_DATA_BELOW else 'ok'


def _node_table(facts: CalibrationFacts, name: ErrorMotion, counts: NDArray[np.int64]) -> Table:
    table, line = facts.tables.motions[name], facts.by_name.get(name)
    k = line.k if line else 0.0
    coverage = (f'{k:.2f}', dof_words(line.dof)) if line else ('-', '-')
    factor, unit = facts.machine.axes[name.axis].shown
    rows = tuple(
        (
            f'{tidy(factor * float(x)):.6g}',
            micro(float(v), 3),
            micro(float(u), 3),
            micro(k * float(u), 3),
            *coverage,
            str(int(n)),
            _node_flag(bool(seen), table.identifiable, int(n)),
        )
        for x, v, u, n, seen in zip(
            table.position, table.value, table.u, counts, table.nodes_seen, strict=True
        )
    )
    head = (f'Position ({unit})', 'Value', 'u (k = 1)', 'U', 'k', 'v_eff', 'n_obs', 'Flag')
    return Table(head, rows, numbers=tuple(range(7)), folded=f'{name} ({micro_unit(name.unit)})')
