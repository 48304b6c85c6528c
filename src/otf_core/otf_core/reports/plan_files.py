# SPDX-License-Identifier: Apache-2.0
"""What ``otf plan`` writes: path.csv, plan.json, report.html, NC programs.

plan.json (``otf-plan/2``), SI units: machine, parts with target, feeds, dwells and axis positions
at the corners, what the forecast assumed, the forecast with its grid, findings in words, how well
reflectors are seen, places of the tracker, and effects beyond the rigid body. path.csv holds the
corners, ``x,y,z`` or with several parts or rotary axes ``target,x,y,z,a,c``; then path.mcap holds
them as ``/planner/axes`` messages, and verify.csv those of the program with TCP on.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.bags.bag import write_axis_paths
from otf_core.files.writing import tidy, write_csv, write_text
from otf_core.inputs.path_file import SCHEMA
from otf_core.model.axis_path import along_legs, nominal_track, position_at
from otf_core.model.chain import Sight
from otf_core.model.expanded import micro_significant
from otf_core.model.machine import BED, TABLE, Machine
from otf_core.model.motions import is_motion, unit_of
from otf_core.model.plan import Part
from otf_core.model.provenance import provenance
from otf_core.noise.noise_model import noise_to_fields
from otf_core.planning.chains import verification_part
from otf_core.planning.forecast import Forecast
from otf_core.planning.line_of_sight import (
    ENOUGH,
    LEAST_OPEN,
    SightShare,
    facings_needed,
    linear_ends,
)
from otf_core.planning.nc import Dialect
from otf_core.planning.nc.programs import programs_of
from otf_core.planning.plan_report import PlanReport
from otf_core.reports.charts import (
    LEVELS,
    Bar,
    bars,
    heat_classes,
    heat_key,
    heat_step,
)
from otf_core.reports.scene import SCRIPT, Dots, Item, Strokes, box, scene, tracker_items
from otf_core.reports.page import (
    Heading,
    Picture,
    Section,
    State,
    Table,
    join_names,
    page_html,
    place,
)

MILLIONTHS = {'m': 'um', 'rad': 'urad'}
"""Millionths of what errors are in."""
UNFOLDED_PLACES = 8
"""Places of the tracker that are not folded away."""
DRAWN_STEP, DRAWN_TURN = 0.05, 0.05
"""m and rad between drawn points of a track."""


def draw_path(report: PlanReport, *, turns: bool = False) -> str:
    """Tracks of the reflectors, tracker and its beams to the corners of the volume."""
    machine, place = report.setup.machine, report.setup.place
    strokes = []
    for part in report.plan.parts:
        q = part.path.positions
        track = Sight.of_target(machine, part.target).nominal(
            position_at(q, along_legs(q, DRAWN_STEP, DRAWN_TURN)) if machine.rotary_names else q
        )
        strokes.append(np.stack([track[:-1], track[1:]], axis=1))
    ends = np.concatenate(strokes)
    low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
    if not machine.rotary_names:
        low, high = linear_ends(machine)
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
    outlook = report.forecast
    points = Sight.of_tool(report.setup.machine).nominal(outlook.grid)
    low, high = points.min(axis=0), points.max(axis=0)
    classes = heat_classes(1e6 * np.linalg.norm(outlook.grid_u_free, axis=1), step)
    items = box(low, high)
    items += [
        Dots(f'heat big h{level}', points[classes == level])
        for level in range(LEVELS)
        if np.any(classes == level)
    ]
    return scene(items, low, high, 'uncertainty in the volume', turns=turns)


def draw_error_bars(report: PlanReport, unit: str) -> str:
    """Bars of all errors of a unit."""
    outlook, words = report.forecast, MILLIONTHS[unit]
    rows = []
    for name, u in outlook.u.items():
        if unit_of(name) != unit:
            continue
        if name in outlook.not_identifiable:
            rows.append(Bar(name, (), 'not shown by this path'))
            continue
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
    return page_html(_plan_heading(report, date), sections)


def _plan_heading(report: PlanReport, date: str) -> Heading:
    expected = report.systematic.expected
    wide, largest = (micro_significant(expected.expanded[size]) for size in ('mean', 'max'))
    noise, most = (micro_significant(expected.observed[size]) for size in ('mean', 'max'))
    missing = [f.error for f in report.findings]
    badge = (
        State(f'{len(missing)} errors not shown', 'open')
        if missing
        else State('all errors shown', 'good')
    )
    tiles = (
        ('Expected after compensation', wide,
         f'mean U over the volume (k = {expected.k:.3g}), largest {largest}; {expected.label}'),
        ('Noise of the tracker alone', noise, f'the same mean, largest {most}'),
        ('Drive', f'{report.forecast.duration:.0f} s',
         f'{_length(report):.1f} m, {_corners(report)} points'),
    )  # fmt: skip
    name, words = report.setup.machine.name, expected.expanded_words
    sentence = f'{words[:1].upper()}{words[1:]}.'
    return Heading(
        f'Plan for {name}: {report.how}', sentence, (badge,), tiles, f'{name}, plan, {date}'
    )


def _corners(report: PlanReport) -> int:
    return sum(len(part.path.positions) for part in report.plan.parts)


def _length(report: PlanReport) -> float:
    """Length of the tracks of the reflectors, m."""
    paths = [part.path for part in report.plan.parts]
    return sum(nominal_track(report.setup.machine, paths).part_lengths)


def _overview_section(report: PlanReport) -> Section:
    words = [f'Not shown: {f.words}; needs {f.needs}.' for f in report.findings]
    words += [f'{a.words[:1].upper()}{a.words[1:]}.' for a in report.after]
    words += [*_work_words(report), *_sight_words(report)]

    def draw() -> Sequence[Picture]:
        size = 1e6 * np.linalg.norm(report.forecast.grid_u_free, axis=1)
        step = heat_step(size)
        return [
            Picture(
                (draw_path(report, turns=True), draw_grid(report, step, turns=True)),
                'Left: the tracks of the reflectors, the tracker and its beams to the corners of '
                'the volume. Right: standard uncertainty of the error vector (k = 1) from tracker '
                'noise alone, best rigid motion removed.',
                columns=2,
                key=heat_key(step, float(size.max()), 'µm'),
            ),
            Picture(
                (draw_error_bars(report, 'm'), draw_error_bars(report, 'rad')),
                'Standard uncertainty (k = 1) from tracker noise alone: bar and first number the '
                'mean over the nodes of a table, stroke the largest.',
                columns=2,
                title=f'All {len(report.forecast.u)} errors',
            ),
        ]

    return Section('overview', '', tuple(words), draw=draw, script=SCRIPT)


def _ranges(report: PlanReport) -> list[tuple[str, float, float, str]]:
    """What every axis drives: name, ends in mm or degrees, unit."""
    q = np.concatenate([part.path.positions for part in report.plan.parts])
    ends = zip(report.setup.machine.axes.items(), q.min(axis=0), q.max(axis=0), strict=True)
    return [
        (name, np.degrees(low), np.degrees(high), 'degrees')
        if axis.rotary
        else (name, 1e3 * low, 1e3 * high, 'mm')
        for (name, axis), low, high in ends
    ]


def _feeds(report: PlanReport) -> str:
    feeds = np.concatenate([part.feed for part in report.plan.parts])
    return ', '.join(map(str, np.unique(np.rint(60e3 * feeds)).astype(int)))


def _path_section(report: PlanReport) -> Section:
    setup, solution = report.setup, report.forecast.joint.solution
    driven = [f'{a} {low:.1f} to {high:.1f} {unit}' for a, low, high, unit in _ranges(report)]
    rows = (
        ('how', report.how),
        ('driven', ', '.join(driven)),
        ('feeds', f'{_feeds(report)} mm/min'),
        ('accelerations assumed', f'{1e3 * setup.config.acceleration:g} mm/s²'),
        ('samples assumed', f'{setup.config.rate:g} a second'),
        ('noise assumed', str(setup.noise)),
        ('unknowns determined', f'{solution.rank} of {solution.unknowns}'),
    )
    parts = tuple((p.target, f'{setup.seconds(p) / 60:.1f}', p.words) for p in report.plan.parts)
    tables = (
        Table(('Target', 'Time (min)', 'What'), parts, (1,)),
        Table(('', ''), rows),
    )
    return Section('path', 'Path and assumptions', tables=tables)


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


def _effects_section(report: PlanReport) -> Section:
    rows = tuple(
        (e['effect'].replace('_', ' '), e['words'].removeprefix(e['effect']).strip())
        for e in report.effects
    )
    hidden = [e['effect'].replace('_', ' ') for e in report.effects if not e['visible']]
    words = (f'Not shown by this path: {join_names(hidden)}.',) if hidden else ()
    table = Table(('Effect', 'Smallest size that a diagnosis would find'), rows, stacked=True)
    return Section('effects', 'Effects beyond the rigid body', words, tables=(table,))


def _margin(report: PlanReport) -> float:
    """Least distance of the path from the ends of the linear axes, m."""
    machine, least = report.setup.machine, np.inf
    for part in report.plan.parts:
        for k, axis in enumerate(machine.axes.values()):
            q = part.path.positions[:, k]
            if not axis.rotary:
                least = min(least, float(np.minimum(q - axis.min, axis.max - q).min()))
    return max(least, 0.0) if np.isfinite(least) else 0.0


def _work_words(report: PlanReport) -> list[str]:
    """What driving and moving reflectors by hand takes."""
    if not report.moves + report.turns:
        return []
    link = 'bed' if report.setup.machine.tracker.link == BED else 'table'
    return [
        f'tracker on the {link}; {report.moves} moves of the reflector by hand and {report.turns} '
        f'turns to another facing (about {report.by_hand / 60:.0f} min); the tracker stays where '
        f'it is throughout'
    ]


def _sight_words(report: PlanReport) -> list[str]:
    """How much of every reflector is seen, and what comes near to it."""
    machine, lines = report.setup.machine, list[str]()
    for name, own in report.sight.items():
        count = facings_needed(own)
        lines.append(
            f'{name}: seen in {100 * own.facings[count - 1]:.0f} % of the positions of the rotary '
            f'axes with {count} facings of the reflector '
            f'({np.degrees(machine.surroundings.half_angle):.0f} degrees to each side)'
        )
        if own.facings[-1] < ENOUGH <= own.open:
            lines.append(
                f'{name}: a cat-eye or an active target sees more (surroundings: half_angle in '
                f'machine.yaml)'
            )
        if own.open < LEAST_OPEN:
            lines.append(f'{name}: {_hidden_words(machine, name, own)}')
    return [*lines, *_facing_words(report), *report.near]


def _facing_words(report: PlanReport) -> list[str]:
    """What to do where one facing of a reflector on the table does not show enough."""
    targets = report.setup.machine.targets
    driven = {part.target for part in report.plan.parts}
    lines: list[str] = []
    whole: dict[str, int] = {}
    for name, own in report.sight.items():
        if targets[name].link != TABLE or facings_needed(own) == 1:
            continue
        facings = [t for t in driven if targets[t].nest == name]
        if facings:
            lines.append(
                f'{name}: {len(facings)} facings planned; turn the reflector to the tracker '
                f'where the part of each begins'
            )
        elif name in driven:
            whole[name] = facings_needed(own)
    if whole:
        lines.append(
            f'{", ".join(whole)}: planned for a reflector that is seen throughout (active '
            f'target); of one that is turned by hand state facings: {max(whole.values())} in '
            f'machine.yaml and plan again'
        )
    return lines


def _hidden_words(machine: Machine, name: str, sight: SightShare) -> str:
    what = 'table' if machine.targets[name].link == TABLE else 'spindle'
    ranges = ' or '.join(
        f'{axis} from {np.degrees(low):.0f} to {np.degrees(high):.0f} degrees'
        for axis, (low, high) in sight.ranges.items()
        if high > low and not machine.axes[axis].endless
    )
    words = (
        f'the {what} hides it in {100 * (1 - sight.open):.0f} % of the positions from the best '
        f'place of the tracker'
    )
    return words + (f'; it is never hidden with {ranges}' if ranges else '')


def report_to_dict(report: PlanReport) -> dict[str, Any]:
    """Return a report as plain data in the layout of plan.json."""
    outlook, setup = report.forecast, report.setup
    machine = setup.machine
    return {
        'schema': SCHEMA,
        'machine': machine.to_dict(),
        'how': report.how,
        'axes': list(machine.axis_names),
        'parts': [
            {
                'target': part.target,
                'words': part.words,
                'feed': part.feed.tolist(),
                'dwell': part.dwell.tolist(),
                'duration': setup.seconds(part),
                'positions': part.path.positions.tolist(),
            }
            for part in report.plan.parts
        ],
        'length': _length(report),
        'duration': outlook.duration,
        'by_hand': report.by_hand,
        'margin': _margin(report),
        'assumed': {
            'tracker_link': machine.tracker.link,
            'tracker_place': setup.place.tolist(),
            'noise': noise_to_fields(setup.noise),
            'rate': setup.config.rate,
            'acceleration': setup.config.acceleration,
        },
        'forecast': _forecast_to_dict(outlook),
        'systematic': report.systematic.to_dict(),
        'not_shown': [asdict(f) for f in report.findings],
        'sight': {
            name: {
                'half_angle': machine.surroundings.half_angle,
                'open': own.open,
                'facings': list(own.facings),
                'ranges': {a: list(ends) for a, ends in own.ranges.items()},
            }
            for name, own in report.sight.items()
        },
        'near': list(report.near),
        'tracker_places': [asdict(p) | {'place': p.place.tolist()} for p in report.places],
        'effects': {e['effect']: dict(e) for e in report.effects},
        'after': [a.to_dict() for a in report.after],
    }


def _forecast_to_dict(outlook: Forecast) -> dict[str, Any]:
    errors: dict[str, Any] = {}
    for name, u in outlook.u.items():
        entry: dict[str, Any] = {'unit': unit_of(name)}
        if is_motion(name):
            entry |= {'axis': name[-1], 'position': outlook.nodes[name[-1]].tolist()}
        errors[name] = entry | {
            'identifiable': name not in outlook.not_identifiable,
            'node_identifiable': outlook.determined[name].tolist(),
            'u': u.tolist(),
        }
    return {
        'pieces': sum(len(run.pieces) for run in outlook.runs),
        'unknowns': outlook.joint.solution.unknowns,
        'rank': outlook.joint.solution.rank,
        'holds': 'noise',
        'mean_grid_u': outlook.mean_grid_u,
        'mean_grid_u_in_gauge': float(np.linalg.norm(outlook.grid_u, axis=1).mean()),
        'errors': errors,
        'grid': {
            'point': outlook.grid.tolist(),
            'u': outlook.grid_u_free.tolist(),
            'u_in_gauge': outlook.grid_u.tolist(),
        },
    }


def plan_summary(report: PlanReport) -> str:
    """Return a dozen lines for a terminal; the page holds all numbers."""
    outlook, expected = report.forecast, report.systematic.expected
    lines = [
        expected.expanded_words,
        expected.forecast_words,
        f'Plan: {report.how}',
        f'{_corners(report)} points, {_length(report):.2f} m, {outlook.duration:.0f} s; feeds '
        f'{_feeds(report)} mm/min; at least {1e3 * _margin(report):.1f} mm inside the axis ranges',
    ]
    if len(report.plan.parts) > 1:
        width = max(len(part.target) for part in report.plan.parts)
        for part in report.plan.parts:
            minutes = report.setup.seconds(part) / 60
            lines.append(f'  {part.target:{width}s} {minutes:5.1f} min  {part.words}')
    lines += [*_work_words(report), *_sight_words(report)]
    lines += [f'for the diagnosis: {a.words}' for a in report.after]
    needs: dict[str, list[str]] = {}
    for finding in report.findings:
        needs.setdefault(finding.needs, []).append(finding.error)
    lines += [f'does not show {", ".join(names)}; needs {what}' for what, names in needs.items()]
    lines += [] if needs else [f'shows all {len(outlook.u)} errors']
    lines += [f'tracker: {line}' for line in report.advice[:1]]
    hidden = [e['effect'] for e in report.effects if not e['visible']]
    seen = len(report.effects) - len(hidden)
    rest = f'; not visible: {", ".join(hidden)}' if hidden else ''
    lines.append(f'effects beyond the rigid body: {seen} of {len(report.effects)} visible{rest}')
    return '\n'.join(lines) + '\n'


def program_header(report: PlanReport) -> list[str]:
    """Comments at the head of a program."""
    spans = [f'{a} {low + 0.0:.3f} TO {high + 0.0:.3f} {unit.upper()}'
             for a, low, high, unit in _ranges(report)]  # fmt: skip
    return [
        'OTF PATH FOR A LASER TRACKER CALIBRATION',
        f'MACHINE {report.setup.machine.name}',
        f'{_corners(report)} POINTS, {_length(report):.2f} M, {report.forecast.duration:.0f} S',
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


def write_report(
    report: PlanReport,
    folder: Path,
    dialect: Dialect | None,
    about: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Write all files of a plan, programs only for a dialect; plan.json last.

    Parameters
    ----------
    about : mapping, optional
        Block ``provenance`` of plan.json; of the machine alone if not given.

    Raises
    ------
    ConfigError
        If the dialect cannot express the plan; nothing is written then.
    """
    machine, plan = report.setup.machine, report.plan
    block = about or provenance('plan', machines=[machine])
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
    files += [folder / 'report.html', folder / 'plan.json']
    write_text(files[-2], plan_html(report, str(block['written'])))
    content = report_to_dict(report) | {'provenance': block}
    write_text(files[-1], json.dumps(content) + '\n')
    return files
