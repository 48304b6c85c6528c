# SPDX-License-Identifier: Apache-2.0
"""What ``otf plan`` writes: path.csv, plan.json, plan.svg, report.html, forecast.txt, NC program.

plan.json (``otf-plan/1``), SI units: machine, path, feed, dwell, what the forecast assumed, the
forecast with its grid, findings in words, places of the tracker, and effects beyond the rigid
body, see ``EffectForecast``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.files.csv_points import tidy, write_csv
from otf_core.files.writing import write_text
from otf_core.inputs.plan_json import SCHEMA
from otf_core.model.expanded import micro_significant
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion, unit_of
from otf_core.model.provenance import provenance
from otf_core.noise.fields import noise_to_fields
from otf_core.planning.forecast import Forecast
from otf_core.planning.nc import Dialect
from otf_core.planning.nc.programs import program
from otf_core.planning.plan_report import PlanReport
from otf_core.reports.plan_page import plan_html
from otf_core.reports.plots.plan import write_plan_picture
from otf_core.reports.quantities import place


def _margin(report: PlanReport) -> float:
    """Least distance of the path from the ends of the axis ranges, m."""
    points, machine = report.plan.path.points, report.setup.machine
    inside = np.minimum(points - machine.lower, machine.upper - points).min()
    return float(max(inside, 0.0))


def _errors(found: Forecast) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for name in (*SQUARENESS, *MOTIONS):
        entry: dict[str, Any] = {'unit': unit_of(name)}
        if name in MOTIONS:
            axis = ErrorMotion.of(name).axis
            entry |= {'axis': axis, 'position': found.nodes[axis].tolist()}
        entry |= {
            'identifiable': name in found.solution.accepted,
            'node_identifiable': found.seen_at(name).tolist(),
            'u': found.u[name].tolist(),
        }
        entries[name] = entry
    return entries


def report_to_dict(report: PlanReport) -> dict[str, Any]:
    """Return a report as plain data in the layout of plan.json."""
    plan, found, setup = report.plan, report.forecast, report.setup
    return {
        'schema': SCHEMA,
        'machine': setup.machine.to_dict(),
        'how': report.how,
        'path': plan.path.points.tolist(),
        'feed': plan.feed.tolist(),
        'dwell': plan.dwell.tolist(),
        'length': plan.path.length,
        'duration': found.duration,
        'margin': _margin(report),
        'assumed': {
            'tracker_place': setup.place.tolist(),
            'noise': noise_to_fields(setup.noise),
            'rate': setup.config.rate,
            'acceleration': setup.config.acceleration,
        },
        'forecast': {
            'pieces': len(found.pieces),
            'unknowns': found.solution.unknowns,
            'rank': found.solution.rank,
            'holds': 'noise',
            'mean_grid_u': found.mean_grid_u,
            'mean_grid_u_in_gauge': float(np.linalg.norm(found.grid_u, axis=1).mean()),
            'errors': _errors(found),
            'grid': {
                'point': found.grid.tolist(),
                'u': found.grid_u_free.tolist(),
                'u_in_gauge': found.grid_u.tolist(),
            },
        },
        'systematic': report.systematic.to_dict() if report.systematic else None,
        'not_shown': [asdict(f) for f in report.findings],
        'tracker_places': [asdict(p) | {'place': p.place.tolist()} for p in report.places],
        'effects': {e.effect: dict(e.data) for e in report.effects},
        'after': [a.to_dict() for a in report.after],
    }


def _table(found: Forecast) -> list[str]:
    lines = [f'{"error":6} {"mean u":>10} {"max u":>10}']
    for name in (*SQUARENESS, *MOTIONS):
        if name not in found.solution.accepted:
            lines.append(f'{name:6} not identifiable')
            continue
        u, unit = 1e6 * found.u[name], 'um' if name in MOTIONS and unit_of(name) == 'm' else 'urad'
        lines.append(f'{name:6} {u.mean():10.3f} {u.max():10.3f} {unit}')
    return lines


def first_lines(report: PlanReport) -> list[str]:
    """What is expected, what it takes, what it does not show."""
    plan, found = report.plan, report.forecast
    feeds = ', '.join(map(str, np.unique(np.rint(60e3 * plan.feed)).astype(int)))
    expected = report.systematic.expected if report.systematic else None
    return [
        *((expected.expanded_words, expected.forecast_words) if expected else ()),
        f'Plan: {report.how}',
        f'{len(plan.path.points)} points, {plan.path.length:.2f} m, {found.duration:.0f} s; feeds '
        f'{feeds} mm/min; at least {1e3 * _margin(report):.1f} mm inside the axis ranges',
    ]


def plan_summary(report: PlanReport) -> str:
    """Return a dozen lines for a terminal; ``format_report`` holds all numbers."""
    lines = first_lines(report)
    lines += [f'says to the diagnosis: {a.words}' for a in report.after]
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


def format_report(report: PlanReport) -> str:
    """Return the text of forecast.txt; it stands for itself in a terminal."""
    found, setup = report.forecast, report.setup
    gauge = np.linalg.norm(found.grid_u, axis=1)
    lines = [
        *first_lines(report),
        f'Assumed: tracker at {place(setup.place)} in the machine frame, '
        f'{setup.config.rate:g} samples/s, '
        f'accelerations of {setup.config.acceleration:g} m/s^2; noise of a sample:',
        *(f'  {part}' for part in str(setup.noise).split('; ')),
        '',
        f'Of the noise of the tracker alone, standard uncertainties (k = 1), '
        f'{found.solution.rank} of {found.solution.unknowns} unknowns determined:',
        f'in the gauge of the tables, on the grid: mean {micro_significant(gauge.mean())}, '
        f'largest {micro_significant(gauge.max())}',
        *_table(found),
        '',
        *(['What it would say to the diagnosis:'] if report.after else []),
        *(f'  {a.words}' for a in report.after),
        *([''] if report.after else []),
        'What this plan does not show:',
        *(f'  {f.words}; needs {f.needs}' for f in report.findings),
        *(['  nothing is missing'] if not report.findings else []),
        '',
        'Tracker:',
        *(f'  {line}' for line in report.advice),
        *(
            f'  {p.words:52} {1e6 * p.mean_grid_u:7.3f} um, beams {p.shortest:.2f} m to '
            f'{p.longest:.2f} m'
            for p in report.places
        ),
    ]
    if report.effects:
        lines += ['', 'Effects beyond the rigid body:', *(f'  {e.words}' for e in report.effects)]
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
        'ERROR COMPENSATION OFF OR AS IT IS TO BE CHECKED',
        'TRY IN THE AIR FIRST',
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
    report : PlanReport
    folder : Path
    dialect : Dialect, optional
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
    files.append(folder / 'forecast.txt')
    write_text(files[-1], format_report(report))
    files.append(write_plan_picture(report, folder))
    files.append(folder / 'report.html')
    block = about or provenance('plan', machines=[report.setup.machine])
    write_text(files[-1], plan_html(report, str(block['written'])))
    files.append(folder / 'plan.json')
    content = report_to_dict(report) | {'provenance': block}
    write_text(files[-1], json.dumps(content) + '\n')
    return files
