# SPDX-License-Identifier: Apache-2.0
"""What ``otf calibrate`` writes of a machine with rotary axes: tables, text, report."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import OBSERVED, PLACES
from otf_core.budget.typical import typical_to_dict
from otf_core.calibration.axis_calibration import AxisCalibration, first_pose
from otf_core.calibration.machine_verdict import Verdicts, judge_axes
from otf_core.config import STANDSTILL, ForecastConfig, PlannerConfig
from otf_core.files.writing import ensure_folder, tidy, write_if_possible, write_text
from otf_core.model.evaluation import evenly_spread
from otf_core.model.expanded import (
    COVERAGE_FACTOR,
    micro_figure,
    micro_significant,
    micro_unit,
    micro_with_expanded,
    with_expanded,
)
from otf_core.model.kinematics import displacement
from otf_core.model.machine import SPINDLE
from otf_core.model.motions import DIRECTIONS, ErrorMotion, location_names, unit_of
from otf_core.model.provenance import STANDARD, provenance
from otf_core.model.tables import tables_to_dict
from otf_core.noise.noise_model import noise_to_fields
from otf_core.planning.rotary_forecast import RotaryForecast, forecast_parts
from otf_core.planning.rotary_paths import STOP_TIME, PlannedPart
from otf_core.prediction.covariance import pack_covariance
from otf_core.prediction.driven_volume import driven_volume
from otf_core.prediction.volumetric import table_places
from otf_core.reports.calibration_facts import (
    BudgetLine,
    budget_lines,
    budget_to_dict,
    expanded_uncertainties,
    measurement_dates,
    stated_tables,
)
from otf_core.reports.calibration_sections.error_motions import (
    reversal_table,
    reversal_to_dict,
    role,
    squareness_words,
    why_reversal,
)
from otf_core.reports.calibration_sections.uncertainty_budget import (
    section_of_budget,
    section_of_correlations,
)
from otf_core.reports.certificate import certificate_of_axes
from otf_core.reports.drawing.panel import (
    Panel,
    Scale,
    heat_classes,
    heat_key,
    heat_step,
    polyline,
    scale_around,
    svg,
)
from otf_core.reports.drawing.panel import words as svg_words
from otf_core.reports.page import (
    Heading,
    Picture,
    Section,
    State,
    Table,
    join_names,
    micro,
    page_html,
)
from otf_core.reports.residual_files import (
    RESIDUALS_FILE,
    RESIDUALS_TEXT,
    residual_arrays_of_axes,
    write_residuals,
    write_residuals_text,
)
from otf_core.rotary.tabulation import remove_rigid_motions
from otf_core.solving.reversal import ReversalTable

GAUGE = (
    'linear axes: positioning and rotations zero at axis position 0, else at the minimum, '
    'straightness zero at both ends; rotary axes: all six motions zero at position 0, else at the '
    'minimum; location errors are the least-squares line over the nodes'
)
TABLES_FILE, REPORT_FILE = 'error_tables.json', 'report.html'
CERTIFICATE_FILE = 'certificate.html'
GRID = 7
"""Positions of every rotary axis at which the volume error is drawn."""
DEGREES = 180.0 / math.pi


def budget_lines_of(result: AxisCalibration) -> tuple[BudgetLine, ...]:
    """Lines of the budget, with typical values where nothing is declared; the grid last."""
    return tuple(budget_lines(result.tables, result.budget_with_typical, result.made.hidden))


def result_to_dict(
    result: AxisCalibration, lines: Sequence[BudgetLine] | None = None
) -> dict[str, Any]:
    """Return a calibration as plain data in the layout of error_tables.json.

    ``lines`` of the budget are worked out if not given.
    """
    listed = list(lines or budget_lines_of(result))
    pose = first_pose(result)
    alignment = {'rotation': pose.rotation.tolist(), 'translation': pose.translation.tolist()}
    _solution, machine = result.solution, result.machine
    data = tables_to_dict(result.tables)
    for name, wide in expanded_uncertainties(result.tables, listed).items():
        data[_place_of(result, name)][name] |= wide
    for name, words in result.advice.items():
        data[_place_of(result, name)][name]['needs'] = words
    data |= {
        'targets': {
            name: {'place': place.tolist(), 'u': u.tolist()}
            for name, (place, u) in result.targets.items()
        },
        'alignment': alignment,
        'tracker_link': machine.tracker.link,
        'fit': asdict(result.fit),
        'runs': [_run_to_dict(result, k) for k in range(len(result.solution.runs))],
        'reversal': reversal_to_dict(result.reversal, result.tables)
        | {'lags': {r.axis: {'unit': 's', 'value': r.value, 'u': r.u} for r in result.lags}},
        'run_id': result.run_id,
        'gauge': GAUGE,
        'spacing': {'table_pitch_over': result.made.fraction},
        'covariance': pack_covariance(result.made.covariance, machine),
        **budget_to_dict(result.tables, result.budget, listed),
        'typical_systematic': typical_to_dict(result.typical),
        'driven': driven_volume(
            result.corners, result.config.corner_exclusion + result.config.piece_length
        ).to_dict(),
        'driven_axes': {
            axis: [float(result.driven[0][k]), float(result.driven[1][k])]
            for k, axis in enumerate(machine.axis_names)
        },
        'not_identifiable': list(result.made.hidden),
        'warnings': list(result.warnings),
        'failed_gates': list(result.failed_gates),
        'verdicts': verdicts_of(result).to_dict(),
        'headline': result.headline.to_dict(),
        'volumetric_error': volume_sizes(result),
        'config': asdict(result.config),
        'provenance': provenance_to_dict(result),
    }
    return data


def _place_of(result: AxisCalibration, name: str) -> str:
    """Entry of error_tables.json that holds an error."""
    if name in result.machine.location:
        return 'location'
    return 'squareness' if name in result.machine.squareness else 'motions'


def _run_to_dict(result: AxisCalibration, number: int) -> dict[str, Any]:
    solved, matched = result.solution.runs[number], result.matched[number]
    pose = result.solution.poses[solved.run.station]
    parts = [
        {'target': p.path.target, 'corners': len(p.path.positions), 'driven': share}
        for p, share in zip(matched.parts, matched.driven, strict=True)
    ]
    return {
        'name': Path(solved.run.name).name,
        'parts': parts,
        'alignment': {
            'rotation': pose.rotation.tolist(),
            'translation': pose.translation.tolist(),
        },
        'pieces': len(solved.run.pieces),
        'noise': noise_to_fields(solved.noise),
        'misfit': asdict(solved.misfit),
    }


def verdicts_of(result: AxisCalibration) -> Verdicts:
    """Verdict on the measurement, and on the machine by its limits."""
    machine = judge_axes(result.tables, result.covariance_with_typical, result.made.hidden)
    return Verdicts(result.failed_gates, machine)


def provenance_to_dict(result: AxisCalibration) -> dict[str, Any]:
    """The block ``provenance``."""
    return provenance('calibrate', method=result.method, runs=result.origin, coverage=STANDARD)


def volume_sizes(result: AxisCalibration) -> dict[str, Any]:
    """Size of the error vectors over the driven ranges, m, the best rigid motion taken out."""
    first = result.headline
    return {'points': first.points, **first.error, 'rigid_motion': 'taken out'}


def _rows_csv(result: AxisCalibration, budget: Sequence[BudgetLine]) -> str:
    lines = ['motion,axis,position,position_unit,value,unit,u,identifiable,U,k,U_with_typical']
    wide = expanded_uncertainties(result.tables, list(budget))
    for motion in result.machine.motions:
        table = result.tables.motions[motion]
        known = table.node_identifiable
        flags = np.ones(len(table.position), dtype=bool) if known is None else known
        along, k = result.machine.axes[motion.axis].unit, wide[motion]['k']
        rows = zip(table.position, table.value, table.u, flags, wide[motion]['U'],
                   result.expanded[motion], strict=True)  # fmt: skip
        lines += [
            f'{motion},{motion.axis},{tidy(position)!r},{along},{float(value) + 0.0!r},'
            f'{motion.unit},{float(u)!r},{str(bool(seen)).lower()},{expanded!r},{_factor(k)},'
            f'{float(whole)!r}'
            for position, value, u, seen, expanded, whole in rows
        ]
    for name in result.machine.scalars:
        value, u, seen = _scalar(result, name)
        lines.append(
            f'{name},,,,{value!r},{unit_of(name)},{u!r},{str(seen).lower()},'
            f'{wide[name]["U"]!r},{_factor(wide[name]["k"])},'
            f'{float(result.expanded[name][0])!r}'
        )
    return '\n'.join(lines) + '\n'


def _factor(k: float | None) -> str:
    """Coverage factor in a CSV cell; empty where nothing is stated."""
    return '' if k is None else repr(float(k))


def _scalar(result: AxisCalibration, name: str) -> tuple[float, float, bool]:
    """Value, standard uncertainty, and whether the data show a scalar."""
    tables = result.tables
    if name in tables.squareness:
        own = tables.squareness[name]
        return own.value, own.u, name not in result.made.hidden
    location = tables.location[name]
    return location.value, location.u, location.identifiable


def location_words(result: AxisCalibration, name: str) -> str:
    """State which way the line of an axis lies, in both habits of sign."""
    value, _, seen = _scalar(result, name)
    axis = name[2]
    if not seen:
        return f'{name}: not identifiable; needs {result.advice.get(name, "another path")}'
    wide = float(result.expanded[name][0])
    stated = micro_with_expanded(abs(value), wide, unit_of(name))
    if unit_of(name) == 'm':
        side = f'{"+" if value >= 0 else "-"}{name[0]}'
        return (
            f'{name} = {micro_with_expanded(value, wide)}: the average line of {axis} lies '
            f'{stated} towards {side} of its nominal place. A control that stores the centre of '
            f'{axis} is to add {with_expanded(1e3 * value, 1e3 * wide)} mm to its {name[0]}; a '
            f'table of corrections holds the opposite sign'
        )
    turn = np.eye(3)['ABC'.index(name[0])] * np.sign(value or 1.0)
    direction = np.array(result.machine.axes[axis].direction)
    lean = np.cross(turn, direction)
    k = int(np.argmax(np.abs(lean)))
    along = int(np.argmax(np.abs(direction)))
    side = f'{"+" if lean[k] >= 0 else "-"}{"XYZ"[k]}'
    end = f'{"+" if direction[along] >= 0 else "-"}{"XYZ"[along]}'
    arcsec = abs(value) * DEGREES * 3600.0
    return (
        f'{name} = {micro_with_expanded(value, wide, "rad")} ({arcsec:.2f} arcsec): the average '
        f'line of {axis} leans {stated} from {end} towards {side}; the correction has the '
        f'opposite sign'
    )


def sections(
    result: AxisCalibration,
    lines: Sequence[BudgetLine] | None = None,
    forecast: RotaryForecast | None = None,
) -> list[Section]:
    """Sections of the report; ``lines`` of the budget are worked out if not given.

    Parameters
    ----------
    forecast : RotaryForecast, optional
        See ``forecast_of``.
    """
    lines = lines or budget_lines_of(result)
    return [
        _overview(result),
        _motions(result),
        _lines(result),
        *_reversal(result),
        _volume(result),
        _targets(result),
        section_of_budget(result.tables, result.budget, lines),
        *([_forecast(result, forecast)] if forecast else []),
        section_of_correlations(result.tables, _seen_covariance(result), result.made.hidden),
        _conditions(result),
        _fit(result),
        _conventions(result),
    ]


def _overview(result: AxisCalibration) -> Section:
    fit, first = result.fit, result.headline
    hidden = ', '.join(result.made.hidden) or 'nothing'
    verdicts = verdicts_of(result)
    words = (
        f'{_capital(first.error_words)}: lengths of the error vectors at {first.points} positions '
        f'spread over the driven ranges of all axes, the best rigid motion of the table removed.',
        f'{_capital(first.expanded_words)}.',
        f'{_capital(first.observed_words)}.',
        f'Pieces of the path are {1e6 * fit.path_mae_before:.2f} um off on average before and '
        f'{1e6 * fit.path_mae_after:.2f} um after compensation.',
        f'Not determined by these data: {hidden}.',
        *(f'Warning: {text}.' for text in result.warnings),
        *(f'Failed: {text}.' for text in result.failed_gates),
        *(verdicts.words[1:] if result.machine.limits else ()),
    )
    data = {'volume': volume_sizes(result), 'headline': first.to_dict(), **asdict(fit)}
    return Section('overview', '', words, data)


def _capital(words: str) -> str:
    return f'{words[:1].upper()}{words[1:]}'


def _tile_rows(result: AxisCalibration) -> tuple[tuple[str, str, str], ...]:
    first = result.headline
    return (
        (
            'mean volumetric error',
            micro_figure(first.error['mean'], first.expanded['mean']),
            'over the driven ranges of all axes',
        ),
        (
            'expected after compensation',
            micro_significant(first.expanded['mean']),
            f'mean U, k = {first.k:.3g}',
        ),
        ('residual', f'{1e6 * result.fit.residual_rms:.2f} um', 'rms of the pieces'),
    )


def _motions(result: AxisCalibration) -> Section:
    rows = []
    for motion in result.machine.motions:
        table = result.tables.motions[motion]
        unit = micro_unit(motion.unit)
        start = (str(motion), role(motion), unit, str(len(table.position)))
        if not table.identifiable:
            needs = result.advice.get(str(motion), '')
            rows.append((*start, 'not identifiable', '', needs))
            continue
        low, high = 1e6 * table.value.min(), 1e6 * table.value.max()
        wide = 1e6 * float(result.expanded[motion].max())
        rows.append((*start, f'{low:.2f}', f'{high:.2f}', f'{wide:.2f}'))
    head = ('Motion', 'Is', 'Unit', 'Nodes', 'Min', 'Max', 'Largest U (95 %), or what it needs')
    return Section(
        'motions',
        'Error motions',
        (
            f'Rotary axes over degrees, linear axes over mm; band: U (95 %), '
            f'{result.headline.label}.',
        ),
        tables=(Table(head, tuple(rows), (3, 4, 5, 6), folded='All motions'),),
        draw=lambda: _pictures(result),
    )


def _pictures(result: AxisCalibration) -> Sequence[Picture]:
    names = result.machine.axis_names
    pictures = []
    for axis in names:
        panels = tuple(_panel(result, ErrorMotion(d, axis)) for d in DIRECTIONS)
        rotary = result.machine.axes[axis].rotary
        pictures.append(Picture(panels, '', columns=3, title=f'Axis {axis}'))
        if rotary:
            pictures.append(
                Picture(
                    (_polar(result, axis),),
                    f'Radial motion of {axis} about its average line; the circle is zero, the '
                    f'scale is magnified.',
                    title=f'Radial motion of {axis}',
                )
            )
    return pictures


def _panel(result: AxisCalibration, motion: ErrorMotion) -> str:
    table, spec = result.tables.motions[motion], result.machine.axes[motion.axis]
    factor, unit = (DEGREES, 'deg') if spec.rotary else (1e3, 'mm')
    x = factor * table.position
    ends = (float(x[0]), float(x[-1])) if len(x) > 1 else (float(x[0]) - 0.5, float(x[0]) + 0.5)
    along = Scale(*ends, f'{motion.axis} ({unit})')
    label = f'{motion} ({"µm" if motion.is_translation else "µrad"})'
    if not table.identifiable:
        marks = [svg_words(190.0, 100.0, 'not identifiable in these data', 'middle soft')]
        return Panel(along, Scale(-1.0, 1.0, label, marks=1)).draw(
            marks, f'{motion}: not identifiable', str(motion)
        )
    y, wide = 1e6 * table.value, 1e6 * result.expanded[motion]
    panel = Panel(along, scale_around(np.concatenate([y - wide, y + wide]), label))
    marks = [panel.band(x, y - wide, y + wide, 'after band')]
    if panel.y.low < 0 < panel.y.high:
        marks.append(panel.level(0.0, 'soft'))
    marks += [panel.line(x, y, 'after'), panel.dots(x, y, 'after node')]
    return panel.draw(marks, f'{motion} over {motion.axis}, with uncertainty', str(motion))


def _polar(result: AxisCalibration, axis: str) -> str:
    """Radial motion in the direction to the angle itself, about a circle."""
    direction = np.array(result.machine.axes[axis].direction)
    along = int(np.argmax(np.abs(direction)))
    first, second = ((along + 1) % 3, (along + 2) % 3)
    position = result.tables.motions[f'E{"XYZ"[first]}{axis}'].position
    angle = np.linspace(position[0], position[-1], 361)
    radial = 1e6 * (
        np.cos(angle) * result.tables.motions[f'E{"XYZ"[first]}{axis}'].at(angle)
        + np.sin(angle) * result.tables.motions[f'E{"XYZ"[second]}{axis}'].at(angle)
    )
    reach = max(float(np.abs(radial).max()), 1e-3)
    radius, centre = 70.0, 120.0

    def place(values: Array) -> Array:
        size = radius + 35.0 * values / reach
        return np.column_stack([centre + size * np.cos(angle), centre - size * np.sin(angle)])

    marks = [
        f'<path class="line soft" d="{polyline(place(np.zeros_like(radial)))}"/>',
        f'<path class="line after" d="{polyline(place(radial))}"/>',
        svg_words(centre, centre, f'35 px = {reach:.2f} µm', 'middle soft'),
        svg_words(centre + radius + 42.0, centre, '0 deg', 'soft'),
    ]
    return svg(290.0, 240.0, marks, f'radial motion of {axis}')


def _lines(result: AxisCalibration) -> Section:
    words = []
    for name in result.machine.squareness:
        value, _, seen = _scalar(result, name)
        if seen:
            wide = float(result.expanded[name][0])
            shown = micro_with_expanded(value, wide, 'rad')
            words.append(f'{name} = {shown}: {squareness_words(name, value, wide)}')
        else:
            words.append(f'{name}: not identifiable')
    for axis in result.machine.rotary_names:
        words += [location_words(result, n) for n in location_names(axis)]
    targets = result.machine.targets
    exact = [n for n in result.targets if targets[n].link == SPINDLE and targets[n].u == 0.0]
    if exact:
        words.append(
            f'The place of {join_names(exact)} in the spindle counts as exact (targets: u is 0, '
            f'that of tool also where it is not stated): U of location errors contains nothing '
            f'for it. With two lengths a spindle that leans makes a rotation of the axis that '
            f'carries it look wrong near its zero position; state u of all reflectors in the '
            f'spindle.'
        )
    data = {
        n: {'value': value, 'u': u, 'identifiable': seen}
        for n in result.machine.scalars
        for value, u, seen in [_scalar(result, n)]
    }
    return Section(
        'location',
        'Squareness of linear axes, location of rotary axes',
        tuple(words),
        data,
    )


def _reversal(result: AxisCalibration) -> list[Section]:
    """Differences between both senses of travel, where there are any."""
    reversal = result.reversal
    if not reversal.motions and not result.lags:
        return []
    lines = [_reversal_words(ErrorMotion.of(m), table) for m, table in reversal.motions.items()]
    lines += [
        f'{r.axis} is {"late" if r.value > 0.0 else "early"} against the axes that it is driven '
        f'with: ({1e6 * abs(r.value):.0f} +/- {1e6 * COVERAGE_FACTOR * r.u:.0f}) us'
        for r in result.lags
    ]
    words = (
        f'Reversal model: {reversal.model}. Tables hold the mean of both senses, without lag.',
        *why_reversal(reversal),
        *lines,
    )
    data = {
        **{m: {'value': t.value.tolist(), 'u': t.u.tolist()} for m, t in reversal.motions.items()},
        **{f'lag {r.axis}': {'value': r.value, 'u': r.u} for r in result.lags},
    }
    tables = (reversal_table(reversal),) if reversal.motions else ()
    return [Section('reversal', 'Reversal', words, data, tables)]


def _reversal_words(motion: ErrorMotion, table: ReversalTable) -> str:
    """Reversal value of a motion, and its range where it changes along the axis."""
    u = float(np.sqrt(np.mean(table.u**2)))
    value = micro_with_expanded(float(table.value.mean()), COVERAGE_FACTOR * u, motion.unit)
    words = f'{motion}: forward less backward travel of {motion.axis} {value}'
    low, high = float(table.value.min()), float(table.value.max())
    if high == low:
        return words
    return f'{words} on average, from {micro(low)} to {micro(high)} {micro_unit(motion.unit)}'


def _volume(result: AxisCalibration) -> Section:
    names = result.machine.rotary_names
    low, high = result.driven
    columns = [result.machine.column(a) for a in names]
    ends = [np.linspace(low[k], high[k], GRID) for k in columns]
    cells = np.stack([g.ravel() for g in np.meshgrid(*ends, indexing='ij')], axis=1)
    inner = evenly_spread(low, high, count=60)
    everywhere = np.concatenate([_with(inner, columns, cell) for cell in cells])
    field = displacement(result.tables, everywhere).reshape(-1, 1)
    free = remove_rigid_motions(result.machine, everywhere, field).reshape(len(cells), -1, 3)
    sizes = 1e6 * np.linalg.norm(free, axis=2).mean(axis=1)
    first = [f'{DEGREES * v:.0f}' for v in ends[0]]
    if len(names) == 1:
        pairs = zip(first, sizes, strict=True)
        table = Table(
            (f'{names[0]} (deg)', 'mean error (um)'),
            tuple((a, f'{v:.1f}') for a, v in pairs),
            (0, 1),
        )
    else:
        grid = sizes.reshape(GRID, -1)
        head = (f'{names[0]} \\ {names[1]} (deg)', *(f'{DEGREES * v:.0f}' for v in ends[1]))
        rows = tuple((a, *(f'{v:.1f}' for v in row)) for a, row in zip(first, grid, strict=True))
        table = Table(head, rows, tuple(range(len(head))))
    words = (
        f'Mean length of the error vector of the target (um) over {", ".join(names)}, the linear '
        f'axes anywhere in their driven ranges; the best rigid motion of the table is taken out.',
    )
    title = 'Volumetric error over the rotary axes'
    return Section('volume', title, words, tables=(table,), draw=partial(_map, names, ends, sizes))


def _map(names: Sequence[str], ends: Sequence[Array], sizes: Array) -> Sequence[Picture]:
    """Mean errors (um) at the ends of both rotary axes, by colour; none for a single axis."""
    if len(names) == 1:
        return ()
    y, x = (_edges(DEGREES * own) for own in ends)
    step = heat_step(sizes)
    classes = heat_classes(sizes, step).reshape(len(y) - 1, len(x) - 1)
    across, up = (
        Scale(float(own[0]), float(own[-1]), f'{name} (deg)')
        for name, own in zip(names[::-1], (x, y), strict=True)
    )
    panel = Panel(across, up)
    marks = [
        panel.band(x[k : k + 2], [y[i]] * 2, [y[i + 1]] * 2, f'heat h{classes[i, k]}')
        for i, k in np.ndindex(classes.shape)
    ]
    drawn = panel.draw(marks, f'mean error over {names[0]} and {names[1]}')
    key = heat_key(step, float(sizes.max()), 'µm')
    return (Picture((drawn,), 'The same by colour.', key=key),)


def _edges(values: Array) -> Array:
    """Edges (n + 1,) of cells about values (n,)."""
    return np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]])


def _with(q: Array, columns: list[int], values: Array) -> Array:
    positions = q.copy()
    positions[:, columns] = values
    return positions


def _targets(result: AxisCalibration) -> Section:
    rows = []
    for name, (place, u) in result.targets.items():
        stated = result.machine.targets[name]
        cells = tuple(
            with_expanded(1e3 * p, COVERAGE_FACTOR * 1e3 * v)
            for p, v in zip(place, u, strict=True)
        )
        moved = 1e3 * float(np.linalg.norm(place - np.array(stated.place)))
        rows.append((name, stated.link, *cells, f'{moved:.3f}'))
    head = ('target', 'link', 'x (mm)', 'y (mm)', 'z (mm)', 'away from nominal (mm)')
    return Section(
        'targets',
        'Places of the reflectors',
        ('As found, with U (k = 2); exact where machine.yaml states u = 0.',),
        {n: {'place': p.tolist(), 'u': u.tolist()} for n, (p, u) in result.targets.items()},
        (Table(head, tuple(rows), (2, 3, 4, 5)),),
    )


def _seen_covariance(result: AxisCalibration) -> Array:
    """Covariance of scalars and nodes, zero for what the data do not show."""
    seen = np.ones(len(result.made.covariance))
    for name, place in table_places(result.tables).items():
        seen[place] = name not in result.made.hidden
    return np.asarray(result.made.covariance * np.outer(seen, seen))


def forecast_of(result: AxisCalibration) -> RotaryForecast | None:
    """What ``plan`` forecasts for the parts that were driven; None if the tracker was moved."""
    if len(result.solution.poses) > 1:
        return None
    pieces = [s.run.pieces for s in result.solution.runs]
    linear = [k for k, a in enumerate(result.machine.axis_names) if a in 'XYZ']
    travel = np.concatenate([np.linalg.norm(p.rate[:, linear], axis=1) for p in pieces])
    feed = float(np.median(travel[travel > 0.0])) if np.any(travel > 0.0) else PlannerConfig().feed
    rate = sum(int(p.count.sum()) for p in pieces) / sum(float(p.duration.sum()) for p in pieces)
    dwell = STOP_TIME if result.method == STANDSTILL else 0.0
    parts = [PlannedPart(p.path, dwell, '') for m in result.matched for p in m.parts]
    return forecast_parts(
        result.machine,
        parts,
        first_pose(result).translation,
        PlannerConfig(feed=min(max(feed, 1e-4), 5.0)),
        ForecastConfig(rate=min(max(rate, 1.0), 5000.0)),
    )


def _forecast(result: AxisCalibration, forecast: RotaryForecast) -> Section:
    """Uncertainty by the noise alone: as specified and planned, and as it came out."""
    own = np.array([name in (*OBSERVED, PLACES) for name in result.budget.names])
    variances = result.budget.variances()[own].sum(axis=0)
    reached = {
        name: float(np.sqrt(np.mean(variances[place])))
        for name, place in table_places(result.tables).items()
        if name not in result.made.hidden
    }
    ratios = [reached[n] / forecast.u[n] for n in reached if forecast.u.get(n, 0.0) > 0.0]
    rows = tuple(
        (
            name,
            micro_unit(unit_of(name)),
            'not seen' if name in forecast.hidden else micro(forecast.u[name], 3),
            micro(u, 3),
        )
        for name, u in reached.items()
    )
    words = (
        'Standard uncertainties (k = 1) without systematic contributions, root mean square over '
        'all nodes: as otf plan forecasts them for the parts that were driven, with the noise '
        'that machine.yaml states and motions as smooth as usual, and as they came out.',
        f'They came out at {np.median(ratios):.2f} times the forecast (median; '
        f'{min(ratios):.2f} to {max(ratios):.2f}).',
    )
    head = ('Error', 'Unit', 'Forecast', 'Reached')
    data = {n: {'forecast': forecast.u[n], 'reached': u} for n, u in reached.items()}
    table = Table(head, rows, numbers=(2, 3), folded='All errors')
    return Section('forecast', 'Forecast and reached', words, data, (table,))


def _conditions(result: AxisCalibration) -> Section:
    given = result.machine.stated
    tables, words = stated_tables(result.machine)
    dates = measurement_dates(result.origin) or 'the stamps contain no date'
    tables.append(Table(('', ''), (('measured', dates),)))
    data = {'instrument': dict(given.instrument), 'conditions': dict(given.conditions)}
    return Section('conditions', 'Conditions and instrument', words, data, tuple(tables))


def _fit(result: AxisCalibration) -> Section:
    fit = result.fit
    rows = (
        ('samples', f'{fit.samples}, used {fit.used}, left out as outliers {fit.outliers}'),
        ('pieces', str(fit.pieces)),
        ('unknowns', f'{fit.unknowns}, determined {fit.rank}'),
        ('path driven', f'{100 * fit.coverage:.1f} %'),
        ('variance of the residuals over that expected', f'{fit.variance_ratio:.3f}'),
    )
    return Section('fit', 'Fit', (), asdict(fit), (Table(('', ''), rows),))


def _conventions(result: AxisCalibration) -> Section:
    words = (
        'Errors are actual minus nominal, of the target relative to the table, in the frame of '
        'the table; symbols of ISO 230-1 and ISO 230-7.',
        f'Gauge: {GAUGE}.',
        *(f'Not seen: {line}.' for line in result.needs),
    )
    return Section('conventions', 'Conventions', words)


def write_calibration(
    result: AxisCalibration,
    folder: str | Path,
    *,
    residuals_csv: bool = False,
    report: bool = True,
    lines: Sequence[BudgetLine] | None = None,
    missing: dict[str, str] | None = None,
) -> list[Path]:
    """Write all files of a calibration, the most important first.

    Parameters
    ----------
    residuals_csv : bool
        Write the residuals as text beside residuals.npz.
    report : bool
        Write report.html.
    lines : sequence of BudgetLine, optional
        See ``budget_lines_of``; worked out if not given.
    missing : dict of str to str, optional
        See ``reports.calibration.write_calibration``.
    """
    folder = ensure_folder(folder)
    lines = lines or budget_lines_of(result)
    data = result_to_dict(result, lines)
    write_text(folder / TABLES_FILE, json.dumps(data, indent=1) + '\n')
    wanted = {
        'error_tables.csv': lambda: write_text(
            folder / 'error_tables.csv', _rows_csv(result, lines)
        ),
    }
    if report:
        wanted[REPORT_FILE] = lambda: write_text(folder / REPORT_FILE, page(result, lines))
    if result.machine.stated.certificate:
        wanted[CERTIFICATE_FILE] = lambda: write_text(
            folder / CERTIFICATE_FILE,
            certificate_of_axes(result, verdicts_of(result), data['provenance']),
        )
    arrays = residual_arrays_of_axes(result)
    wanted[RESIDUALS_FILE] = lambda: write_residuals(arrays, folder)
    if residuals_csv:
        wanted[RESIDUALS_TEXT] = lambda: write_residuals_text(
            arrays, folder, result.machine.axis_names
        )
    written = [name for name, write in wanted.items() if write_if_possible(missing, name, write)]
    return [folder / TABLES_FILE, *(folder / name for name in written)]


def page(result: AxisCalibration, lines: Sequence[BudgetLine] | None = None) -> str:
    """Return the report as one page; ``lines`` of the budget are worked out if not given."""
    forecast = forecast_of(result)
    good = not result.failed_gates
    heading = Heading(
        f'Calibration of {result.machine.name}',
        'The measurement is good.' if good else 'The measurement is not good.',
        (
            State(
                'measurement good' if good else 'measurement not good', 'good' if good else 'bad'
            ),
        ),
        _tile_rows(result),
    )
    return page_html(heading, sections(result, lines, forecast))


def summary(result: AxisCalibration) -> str:
    """Return the lines of a terminal."""
    good = 'measurement not good' if result.failed_gates else 'measurement good'
    machine = result.machine
    return '\n'.join([f'{machine.name}, chain {machine.chain}: {good}', *_overview(result).words])
