# SPDX-License-Identifier: Apache-2.0
"""What ``otf plan`` writes: path.csv, plan.json, report.html, NC program.

plan.json (``otf-plan/1``), SI units: machine, path, feed, dwell, what the forecast assumed, the
forecast with its grid, findings in words, places of the tracker, and effects beyond the rigid
body, see ``EffectForecast``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.calibration.calibration_result import ExpectedRemainder
from otf_core.files.writing import tidy, write_csv, write_text
from otf_core.inputs.path_file import SCHEMA
from otf_core.model.expanded import COVERAGE_FACTOR, micro_significant
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion, unit_of
from otf_core.model.provenance import provenance
from otf_core.noise.noise_model import noise_to_fields
from otf_core.planning.forecast import Forecast
from otf_core.planning.nc import Dialect
from otf_core.planning.nc.programs import program
from otf_core.planning.plan_report import PlanReport
from otf_core.prediction.volumetric import length_sizes
from otf_core.reports.drawing.panel import (
    LEVELS,
    Bar,
    bars,
    heat_classes,
    heat_key,
    heat_step,
)
from otf_core.reports.drawing.scene import SCRIPT, Dots, Item, Strokes, box, scene, tracker_items
from otf_core.reports.page import (
    Heading,
    Picture,
    Section,
    State,
    Table,
    join_names,
    millimetres,
    page_html,
    place,
)

MILLIONTHS = {'m': 'um', 'rad': 'urad'}
"""Millionths of what errors are in."""
UNFOLDED_PLACES = 8
"""Places of the tracker that are not folded away."""


def draw_path(report: PlanReport, *, turns: bool = False) -> str:
    """Path, tracker and its beams to the corners of the volume."""
    machine, place = report.setup.machine, report.setup.place
    points, low, high = report.plan.path.points, machine.lower, machine.upper
    ends = np.stack([points[:-1], points[1:]], axis=1)
    ends = ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 0]
    corners = np.array(list(product(*zip(low, high, strict=True))))
    beams = np.stack([np.broadcast_to(place, corners.shape), corners], axis=1)
    items: list[Item] = [
        Strokes('z thin dash', beams),
        Strokes('after thin', ends),
        *box(low, high),
        *tracker_items(place, low, high),
    ]
    both = np.vstack([low, high, place])
    return scene(items, both.min(axis=0), both.max(axis=0), 'path and tracker', turns=turns)


def draw_grid(report: PlanReport, step: float, *, turns: bool = False) -> str:
    """Uncertainty of the error vector on the grid in classes of ``step``, um."""
    machine, outlook = report.setup.machine, report.forecast
    classes = heat_classes(1e6 * np.linalg.norm(outlook.grid_u_free, axis=1), step)
    items = box(machine.lower, machine.upper)
    items += [
        Dots(f'heat big h{level}', outlook.grid[classes == level])
        for level in range(LEVELS)
        if np.any(classes == level)
    ]
    return scene(items, machine.lower, machine.upper, 'uncertainty in the volume', turns=turns)


def draw_error_bars(report: PlanReport, unit: str) -> str:
    """Bars of all errors of a unit."""
    outlook, words = report.forecast, MILLIONTHS[unit]
    rows = []
    for name in (*SQUARENESS, *MOTIONS):
        if unit_of(name) != unit:
            continue
        if name not in outlook.solution.accepted:
            rows.append(Bar(name, (), 'not shown by this path'))
            continue
        u = outlook.u[name]
        mean, most = float(u.mean()), float(u.max())
        label = f'{1e6 * mean:.2f}, largest {1e6 * most:.2f} {words}'
        rows.append(Bar(name, ((1e6 * mean, 'after'),), label, 1e6 * most))
    return bars(rows, f'uncertainty of errors in {words}', width=480.0)


def plan_html(report: PlanReport, date: str) -> str:
    """Return the page; ``date`` is when the plan was made."""
    sections = [
        _overview_section(report),
        _path_section(report),
        _tracker_section(report),
        _effects_section(report),
    ]
    return page_html(_plan_heading(report, date), [s for s in sections if s is not None])


def _expected_volume(report: PlanReport) -> ExpectedRemainder:
    """What a calibration from this plan would state first; of noise alone if no more is known."""
    if report.systematic is not None:
        return report.systematic.expected
    noise = length_sizes(COVERAGE_FACTOR * np.linalg.norm(report.forecast.grid_u_free, axis=1))
    return ExpectedRemainder(noise, noise, COVERAGE_FACTOR, (), nothing_declared=True)


def _plan_heading(report: PlanReport, date: str) -> Heading:
    plan, outlook = report.plan, report.forecast
    expected = _expected_volume(report)
    wide, largest = (micro_significant(expected.expanded[size]) for size in ('mean', 'max'))
    noise, most = (micro_significant(expected.observed[size]) for size in ('mean', 'max'))
    label = 'tracker noise alone' if report.systematic is None else expected.label
    sentence = f'{expected.expanded_words[:1].upper()}{expected.expanded_words[1:]}.'
    if report.systematic is None:
        sentence = f'{expected.forecast_words[:1].upper()}{expected.forecast_words[1:]}.'
    missing = [f.error for f in report.findings]
    badge = (
        State(f'{len(missing)} errors not shown', 'open')
        if missing
        else State('all errors shown', 'good')
    )
    tiles = (
        ('Expected after compensation', wide,
         f'mean U over the volume (k = {expected.k:.3g}), largest {largest}; {label}'),
        ('Noise of the tracker alone', noise, f'the same mean, largest {most}'),
        ('Drive', f'{outlook.duration:.0f} s', f'{plan.path.length:.1f} m, '
         f'{len(plan.path.points)} points'),
    )  # fmt: skip
    name = report.setup.machine.name
    return Heading(
        f'Plan for {name}: {report.how}', sentence, (badge,), tiles, f'{name}, plan, {date}'
    )


def _overview_section(report: PlanReport) -> Section:
    words = [f'Not shown: {f.words}; needs {f.needs}.' for f in report.findings]
    words += [f'{a.words[:1].upper()}{a.words[1:]}.' for a in report.after]

    def draw() -> Sequence[Picture]:
        size = 1e6 * np.linalg.norm(report.forecast.grid_u_free, axis=1)
        step = heat_step(size)
        return [
            Picture(
                (draw_path(report, turns=True), draw_grid(report, step, turns=True)),
                'Left: the path, the tracker and its beams to the corners of the volume. Right: '
                'standard uncertainty of the error vector (k = 1) from tracker noise alone, '
                'best rigid motion removed.',
                columns=2,
                key=heat_key(step, float(size.max()), 'µm'),
            ),
            Picture(
                (draw_error_bars(report, 'm'), draw_error_bars(report, 'rad')),
                'Standard uncertainty (k = 1) from tracker noise alone: bar and first number the '
                'mean over the nodes of a table, stroke the largest.',
                columns=2,
                title='All 21 errors',
            ),
        ]

    return Section('overview', '', tuple(words), draw=draw, script=SCRIPT)


def _path_section(report: PlanReport) -> Section:
    plan, setup = report.plan, report.setup
    points = plan.path.points
    feeds = np.unique(np.rint(60e3 * plan.feed)).astype(int)
    ranges = zip(setup.machine.axis_names, points.min(axis=0), points.max(axis=0), strict=True)
    driven = [f'{a} {millimetres(low)} to {millimetres(high)} mm' for a, low, high in ranges]
    rows = (
        ('how', report.how),
        ('driven', ', '.join(driven)),
        ('feeds', f'{", ".join(map(str, feeds))} mm/min'),
        ('accelerations assumed', f'{1e3 * setup.config.acceleration:g} mm/s²'),
        ('samples assumed', f'{setup.config.rate:g} a second'),
        ('noise assumed', str(setup.noise)),
        ('unknowns determined', f'{report.forecast.solution.rank} of '
         f'{report.forecast.solution.unknowns}'),
    )  # fmt: skip
    return Section('path', 'Path and assumptions', tables=(Table(('', ''), rows),))


def _tracker_section(report: PlanReport) -> Section:
    words = (
        f'Assumed here: {place(report.setup.place)}.',
        *(f'{line[:1].upper()}{line[1:]}.' for line in report.advice),
    )
    rows = tuple(
        (p.words, place(p.place), f'{1e6 * p.mean_grid_u:.3f}',
         f'{p.shortest:.2f} to {p.longest:.2f}')
        for p in report.places
    )  # fmt: skip
    head = ('Place', 'Position', 'Mean u in the volume, noise alone (um)', 'Beam (m)')
    tables = [Table(head, rows[:UNFOLDED_PLACES], numbers=(2, 3), stacked=True)]
    if rows[UNFOLDED_PLACES:]:
        tables.append(
            Table(head, rows[UNFOLDED_PLACES:], (2, 3), folded='Other places', stacked=True)
        )
    return Section('tracker', 'Position of the tracker', words, tables=tuple(tables))


def _effects_section(report: PlanReport) -> Section | None:
    if not report.effects:
        return None
    rows = tuple(
        (e.effect.replace('_', ' '), e.words.removeprefix(e.effect).strip())
        for e in report.effects
    )
    hidden = [e.effect.replace('_', ' ') for e in report.effects if not e.data.get('visible')]
    words = (f'Not shown by this path: {join_names(hidden)}.',) if hidden else ()
    table = Table(('Effect', 'Smallest size that a diagnosis would find'), rows, stacked=True)
    return Section('effects', 'Effects beyond the rigid body', words, tables=(table,))


def _margin(report: PlanReport) -> float:
    """Least distance of the path from the ends of the axis ranges, m."""
    points, machine = report.plan.path.points, report.setup.machine
    inside = np.minimum(points - machine.lower, machine.upper - points).min()
    return float(max(inside, 0.0))


def _errors(forecast: Forecast) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for name in (*SQUARENESS, *MOTIONS):
        entry: dict[str, Any] = {'unit': unit_of(name)}
        if name in MOTIONS:
            axis = ErrorMotion.of(name).axis
            entry |= {'axis': axis, 'position': forecast.nodes[axis].tolist()}
        entry |= {
            'identifiable': name in forecast.solution.accepted,
            'node_identifiable': forecast.seen_at(name).tolist(),
            'u': forecast.u[name].tolist(),
        }
        entries[name] = entry
    return entries


def report_to_dict(report: PlanReport) -> dict[str, Any]:
    """Return a report as plain data in the layout of plan.json."""
    plan, outlook, setup = report.plan, report.forecast, report.setup
    return {
        'schema': SCHEMA,
        'machine': setup.machine.to_dict(),
        'how': report.how,
        'path': plan.path.points.tolist(),
        'feed': plan.feed.tolist(),
        'dwell': plan.dwell.tolist(),
        'length': plan.path.length,
        'duration': outlook.duration,
        'margin': _margin(report),
        'assumed': {
            'tracker_place': setup.place.tolist(),
            'noise': noise_to_fields(setup.noise),
            'rate': setup.config.rate,
            'acceleration': setup.config.acceleration,
        },
        'forecast': {
            'pieces': len(outlook.pieces),
            'unknowns': outlook.solution.unknowns,
            'rank': outlook.solution.rank,
            'holds': 'noise',
            'mean_grid_u': outlook.mean_grid_u,
            'mean_grid_u_in_gauge': float(np.linalg.norm(outlook.grid_u, axis=1).mean()),
            'errors': _errors(outlook),
            'grid': {
                'point': outlook.grid.tolist(),
                'u': outlook.grid_u_free.tolist(),
                'u_in_gauge': outlook.grid_u.tolist(),
            },
        },
        'systematic': report.systematic.to_dict() if report.systematic else None,
        'not_shown': [asdict(f) for f in report.findings],
        'tracker_places': [asdict(p) | {'place': p.place.tolist()} for p in report.places],
        'effects': {e.effect: dict(e.data) for e in report.effects},
        'after': [a.to_dict() for a in report.after],
    }


def first_lines(report: PlanReport) -> list[str]:
    """What is expected, what it takes, what it does not show."""
    plan, outlook = report.plan, report.forecast
    feeds = ', '.join(map(str, np.unique(np.rint(60e3 * plan.feed)).astype(int)))
    expected = report.systematic.expected if report.systematic else None
    return [
        *((expected.expanded_words, expected.forecast_words) if expected else ()),
        f'Plan: {report.how}',
        f'{len(plan.path.points)} points, {plan.path.length:.2f} m, {outlook.duration:.0f} s; '
        f'feeds '
        f'{feeds} mm/min; at least {1e3 * _margin(report):.1f} mm inside the axis ranges',
    ]


def plan_summary(report: PlanReport) -> str:
    """Return a dozen lines for a terminal; the page holds all numbers."""
    lines = first_lines(report)
    lines += [f'for the diagnosis: {a.words}' for a in report.after]
    needs: dict[str, list[str]] = {}
    for finding in report.findings:
        needs.setdefault(finding.needs, []).append(finding.error)
    lines += [f'does not show {", ".join(names)}; needs {what}' for what, names in needs.items()]
    lines += [] if needs else ['shows all 21 errors']
    lines += [f'tracker: {line}' for line in report.advice[:1]]
    hidden = [e.effect for e in report.effects if not e.data['visible']]
    if report.effects:
        seen = len(report.effects) - len(hidden)
        rest = f'; not visible: {", ".join(hidden)}' if hidden else ''
        lines.append(
            f'effects beyond the rigid body: {seen} of {len(report.effects)} visible{rest}'
        )
    return '\n'.join(lines) + '\n'


def _mm(value: float) -> str:
    return f'{round(1e3 * float(value), 3) + 0.0:.3f}'


def program_header(report: PlanReport) -> list[str]:
    """Comments at the head of a program."""
    plan = report.plan
    low, high = plan.path.points.min(axis=0), plan.path.points.max(axis=0)
    ranges = zip(report.setup.machine.axis_names, low, high, strict=True)
    spans = [f'{a} {_mm(lo)} TO {_mm(hi)}' for a, lo, hi in ranges]
    return [
        'OTF PATH FOR A LASER TRACKER CALIBRATION',
        f'MACHINE {report.setup.machine.name}',
        f'{len(plan.path.points)} POINTS, {plan.path.length:.2f} M, '
        f'{report.forecast.duration:.0f} S',
        f'{", ".join(spans)} MM',
        'ERROR COMPENSATION OFF, OR AS IT IS TO BE VERIFIED',
        'DRY RUN WITHOUT WORKPIECE FIRST',
    ]


def write_report(
    report: PlanReport,
    folder: Path,
    dialect: Dialect | None,
    about: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Write all files of a plan, the program only for a dialect; plan.json last.

    Parameters
    ----------
    about : mapping, optional
        Block ``provenance`` of plan.json; of the machine alone if not given.

    Raises
    ------
    ConfigError
        If the dialect cannot express the plan; nothing is written then.
    """
    files = []
    text = None if dialect is None else program(dialect, report.plan, program_header(report))
    if dialect is not None and text is not None:
        files.append(folder / dialect.file_name)
        write_text(files[-1], text)
    files.append(folder / 'path.csv')
    write_csv(files[-1], 'x,y,z', np.vectorize(tidy)(report.plan.path.points))
    files.append(folder / 'report.html')
    block = about or provenance('plan', machines=[report.setup.machine])
    write_text(files[-1], plan_html(report, str(block['written'])))
    files.append(folder / 'plan.json')
    content = report_to_dict(report) | {'provenance': block}
    write_text(files[-1], json.dumps(content) + '\n')
    return files
