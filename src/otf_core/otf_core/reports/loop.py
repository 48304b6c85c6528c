# SPDX-License-Identifier: Apache-2.0
"""A round against a real control as data, as text and as files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from otf_core.bags.bag import BagContent, write_bag
from otf_core.files.writing import ensure_folder, write_text
from otf_core.loop.circle import PROGRAM, VOLUME, Circle
from otf_core.model.provenance import provenance
from otf_core.model.tables import tables_to_dict
from otf_core.reports.calibration import write_calibration
from otf_core.reports.loop_page import loop_page

SCHEMA = 'otf-loop/1'


def loop_to_dict(circle: Circle) -> dict[str, Any]:
    """Return a round as plain data: loop.json."""
    proof, path = circle.proof, circle.recordings['check'].path
    return {
        'schema': SCHEMA,
        'compensate': circle.way,
        'before_um': 1e6 * proof.before,
        'after_um': 1e6 * proof.after,
        'forecast_um': 1e6 * proof.forecast,
        'fall_percent': 100 * (1 - proof.after / proof.before),
        'left_um': {
            'of_tables': 1e6 * proof.of_tables,
            'of_export': 1e6 * proof.of_export,
            'of_control': 1e6 * proof.of_control,
        },
        'seen_by_tracker': {
            'before_um': 1e6 * proof.seen_before,
            'after_um': 1e6 * proof.seen_after,
        },
        'external_offsets': {
            'lacking_mean_um': 1e6 * proof.lag_mean,
            'lacking_max_um': 1e6 * proof.lag_max,
        }
        if circle.way == VOLUME
        else None,
        'lines': [
            {'start': path.points[k].tolist(), 'end': path.points[k + 1].tolist()}
            | {
                name: {'mean_um': 1e6 * sizes[k][0], 'largest_um': 1e6 * sizes[k][1]}
                for name, sizes in (('before', proof.lines_before), ('after', proof.lines_after))
            }
            for k in range(len(proof.lines_after))
        ],
        'servo_periods_lost': proof.lost,
        'failed_gates': list(failed_gates(circle)),
        'provenance': provenance('loop', machines=[circle.truth.machine]),
    }


def failed_gates(circle: Circle) -> tuple[str, ...]:
    """Quality gates of the calibration and of the proof that failed."""
    proof, own = circle.proof, []
    if proof.after >= proof.before:
        own.append(
            f'compensation by {circle.way} made it worse: {1e6 * proof.before:.2f} um before, '
            f'{1e6 * proof.after:.2f} um after; check the sign'
        )
    if proof.lost:
        own.append(f'{proof.lost} servo periods were not sampled: the computer is too busy')
    return (*circle.result.failed_gates, *own)


def format_loop(circle: Circle) -> str:
    """Return the text for a terminal."""
    proof, ways = circle.proof, {VOLUME: 'external offsets', PROGRAM: 'a corrected program'}
    lines = [
        f'compensated: {circle.way} ({ways.get(circle.way, "a .comp file per joint")})',
        f'volumetric error on lines that were not fitted, best rigid motion taken out: '
        f'{1e6 * proof.before:.2f} um before, {1e6 * proof.after:.2f} um after '
        f'({100 * (1 - proof.after / proof.before):.1f} % less); forecast '
        f'{1e6 * proof.forecast:.2f} um',
        f'what is left comes of the tables (they do not know {1e6 * proof.of_tables:.2f} um), the '
        f'export (cannot hold {1e6 * proof.of_export:.2f} um) and the control (does not bring '
        f'{1e6 * proof.of_control:.2f} um of it to the motors)',
        f'as the tracker sees it, across the lines: {1e6 * proof.seen_before:.2f} um before, '
        f'{1e6 * proof.seen_after:.2f} um after, its noise in both',
    ]
    if circle.way == VOLUME:
        lines.append(
            f'external offsets lack {1e6 * proof.lag_mean:.2f} um of the correction in the mean, '
            f'{1e6 * proof.lag_max:.2f} um at most'
        )
    return '\n'.join(lines)


def write_loop(circle: Circle, folder: str | Path) -> list[Path]:
    """Write loop.json, the calibration, the bags, and what the control was given.

    Returns
    -------
    list of Path
    """
    folder = ensure_folder(folder)
    control = ensure_folder(folder / 'control')
    for name, content in circle.files.items():
        (control / name).write_bytes(content)
    for name, recording in circle.recordings.items():
        write_bag(folder / 'bags' / name, BagContent(recording.samples, recording.path))
    written = write_calibration(circle.result, folder / 'calibration')
    truth = json.dumps(tables_to_dict(circle.truth), indent=1)
    write_text(folder / 'truth_tables.json', truth + '\n')
    write_text(folder / 'summary.txt', format_loop(circle) + '\n')
    data = loop_to_dict(circle)
    path, gates = circle.recordings['fit'].path, failed_gates(circle)
    page = loop_page(data, circle.result, path, circle.files, gates)
    write_text(folder / 'loop.html', page)
    write_text(folder / 'loop.json', json.dumps(data, indent=1) + '\n')
    names = [
        folder / name for name in ('loop.json', 'loop.html', 'summary.txt', 'truth_tables.json')
    ]
    return [*names, written[0]]
