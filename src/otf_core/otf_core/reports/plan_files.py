# SPDX-License-Identifier: Apache-2.0
"""What ``otf plan`` writes: path.csv, plan.json, report.html, NC programs.

plan.json (``otf-plan/2``), SI units: machine, parts with target, feeds, dwells and axis positions
at the corners, what the forecast assumed, the forecast with its grid, findings in words, how well
reflectors are seen, places of the tracker, and effects beyond the rigid body. path.csv holds the
corners, ``x,y,z`` or with several parts or rotary axes ``target,x,y,z,a,c``; then path.mcap holds
them as ``/planner/axes`` messages, and verify.csv those of the program with TCP on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.bag import write_axis_paths
from otf_core.files.writing import tidy, write_csv, write_text
from otf_core.model.axis_path import along_legs, position_at
from otf_core.model.chain import Sight
from otf_core.model.expanded import micro_unit
from otf_core.model.machine import Machine, machine_from_dict
from otf_core.model.plan import Part
from otf_core.noise.noise_model import noise_from_fields
from otf_core.planning.chains import verification_part
from otf_core.planning.document import plan_length
from otf_core.planning.line_of_sight import linear_ends
from otf_core.planning.nc import Dialect
from otf_core.planning.nc.programs import programs_of
from otf_core.planning.plan_report import PlanReport
from otf_core.reports.charts import LEVELS, Bar, bars, heat_classes, heat_key, heat_step
from otf_core.reports.pages import write_document
from otf_core.reports.rendering import State, render
from otf_core.reports.scene import Dots, Item, Strokes, box, scene, tracker_items

DRAWN_STEP, DRAWN_TURN = 0.05, 0.05
"""m and rad between drawn points of a track."""


def driven_ranges(
    machine: Machine, positions: NDArray[np.float64]
) -> list[tuple[str, float, float, str]]:
    """What every axis drives: name, ends in mm or degrees, unit; positions (n, k), m and rad."""
    ends = zip(machine.axes.items(), positions.min(axis=0), positions.max(axis=0), strict=True)
    return [
        (name, np.degrees(low), np.degrees(high), 'degrees')
        if axis.rotary
        else (name, 1e3 * low, 1e3 * high, 'mm')
        for (name, axis), low, high in ends
    ]


def path_chart(doc: Mapping[str, Any]) -> str:
    """Tracks of the reflectors, tracker and its beams to the corners of the volume."""
    machine, at = machine_from_dict(doc['machine']), np.array(doc['assumed']['tracker_place'])
    strokes = []
    for part in doc['parts']:
        q = np.array(part['positions'])
        track = Sight.of_target(machine, part['target']).nominal(
            position_at(q, along_legs(machine.axis_names, q, DRAWN_STEP, DRAWN_TURN))
            if machine.rotary_names
            else q
        )
        strokes.append(np.stack([track[:-1], track[1:]], axis=1))
    ends = np.concatenate(strokes)
    low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
    if not machine.rotary_names:
        low, high = linear_ends(machine)
    corners = np.array(list(product(*zip(low, high, strict=True))))
    beams = np.stack([np.broadcast_to(at, corners.shape), corners], axis=1)
    items: list[Item] = [
        Strokes('z thin dash', beams),
        Strokes('after thin', ends),
        *box(low, high),
        *tracker_items(at, low, high),
    ]
    both = np.vstack([low, high, at])
    return scene(items, both.min(axis=0), both.max(axis=0), 'path and tracker')


def grid_chart(doc: Mapping[str, Any]) -> tuple[str, str]:
    """Uncertainty of the error vector on the grid by colour, and the key of its colours."""
    grid = doc['forecast']['grid']
    points = Sight.of_tool(machine_from_dict(doc['machine'])).nominal(np.array(grid['point']))
    size = 1e6 * np.linalg.norm(grid['u'], axis=1)
    low, high, step = points.min(axis=0), points.max(axis=0), heat_step(size)
    classes = heat_classes(size, step)
    dots = [Dots(f'heat big h{level}', points[classes == level]) for level in range(LEVELS)
            if np.any(classes == level)]  # fmt: skip
    drawn = scene([*box(low, high), *dots], low, high, 'uncertainty in the volume')
    return drawn, heat_key(step, float(size.max()), 'µm')


def error_charts(doc: Mapping[str, Any]) -> list[str]:
    """Bars of all errors: displacements, then angles."""
    rows: dict[str, list[Bar]] = {'m': [], 'rad': []}
    for name, own in doc['forecast']['errors'].items():
        if not own['identifiable']:
            rows[own['unit']].append(Bar(name, (), 'not shown by this path'))
            continue
        mean, most = 1e6 * float(np.mean(own['u'])), 1e6 * float(np.max(own['u']))
        label = f'{mean:.2f}, largest {most:.2f} {micro_unit(own["unit"])}'
        rows[own['unit']].append(Bar(name, ((mean, 'after'),), label, most))
    return [bars(own, f'uncertainty of errors in {micro_unit(unit)}', width=480.0)
            for unit, own in rows.items()]  # fmt: skip


def _content(doc: Mapping[str, Any]) -> dict[str, Any]:
    """What page and text both state."""
    positions = np.concatenate([part['positions'] for part in doc['parts']])
    feeds = np.unique(np.rint(60e3 * np.concatenate([part['feed'] for part in doc['parts']])))
    needs: dict[str, list[str]] = {}
    for finding in doc['not_shown']:
        needs.setdefault(finding['needs'], []).append(finding['error'])
    return {
        'd': doc,
        'corners': len(positions),
        'feeds': ', '.join(map(str, feeds.astype(int))),
        'driven': driven_ranges(machine_from_dict(doc['machine']), positions),
        'needs': needs,
        'hidden': [name for name, own in doc['effects'].items() if not own['visible']],
        'wide': max((len(part['target']) for part in doc['parts']), default=0),
    }


def plan_pages(doc: Mapping[str, Any]) -> dict[str, str]:
    """Return the page of a plan.json."""
    missing, (grid, key) = doc['not_shown'], grid_chart(doc)
    badge = State('all errors shown', 'good')
    if missing:
        badge = State(f'{len(missing)} errors not shown', 'open')
    page = render('plan.html.j2', path_chart=path_chart(doc), grid_chart=grid, key=key,
                  error_charts=error_charts(doc), badges=[badge],
                  noise=str(noise_from_fields(doc['assumed']['noise'])),
                  **_content(doc))  # fmt: skip
    return {'report.html': page}


def plan_summary(doc: Mapping[str, Any]) -> str:
    """Return a dozen lines for a terminal; the page holds all numbers."""
    return render('plan.txt.j2', **_content(doc))


def program_header(report: PlanReport) -> list[str]:
    """Comments at the head of a program."""
    machine, parts = report.setup.machine, [part.path.positions for part in report.plan.parts]
    positions = np.concatenate(parts)
    spans = [f'{a} {low + 0.0:.3f} TO {high + 0.0:.3f} {unit.upper()}'
             for a, low, high, unit in driven_ranges(machine, positions)]  # fmt: skip
    return [
        'OTF PATH FOR A LASER TRACKER CALIBRATION',
        f'MACHINE {machine.name}',
        f'{len(positions)} POINTS, {plan_length(report):.2f} M, {report.forecast.duration:.0f} S',
        ', '.join(spans),
        'ERROR COMPENSATION OFF, OR AS IT IS TO BE VERIFIED',
        'DRY RUN WITHOUT WORKPIECE FIRST',
    ]


def path_csv(machine: Machine, parts: Sequence[Part]) -> str:
    """Return the corners of parts, m and rad, as ``simulate --path`` reads them."""
    lines = [','.join(['target', *(a.lower() for a in machine.axis_names)])]
    for part in parts:
        for corner in part.path.positions.tolist():
            lines.append(','.join([part.target, *(f'{v:.12g}' for v in corner)]))
    return '\n'.join(lines) + '\n'


def write_plan(report: PlanReport, folder: Path, dialect: Dialect | None = None) -> list[Path]:
    """Write all files of a plan, programs only for a dialect; plan.json last.

    Raises
    ------
    ConfigError
        If the dialect cannot express the plan; nothing is written then.
    """
    machine, plan = report.setup.machine, report.plan
    texts: dict[str, str] = {}
    if dialect is not None:
        verification = verification_part(machine)
        texts = programs_of(dialect, machine, plan, program_header(report), verification)
        if verification is not None:
            texts['verify.csv'] = path_csv(machine, [verification])
    files = [folder / name for name in (*texts, 'path.csv')]
    for name, text in texts.items():
        write_text(folder / name, text)
    if plan.is_plain:
        write_csv(files[-1], 'x,y,z', np.vectorize(tidy)(plan.path.points))
    else:
        write_text(files[-1], path_csv(machine, plan.parts))
        files.append(folder / 'path.mcap')
        write_axis_paths(files[-1], [part.path for part in plan.parts])
    return [*files, *write_document(report.document, folder)]
