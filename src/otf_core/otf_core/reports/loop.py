# SPDX-License-Identifier: Apache-2.0
"""A round against a real control: page, loop.json, text.

The page is in the order of the clauses of ISO/TR 16907:2015: determination of the errors (clause
7), their representation (9), application in the control (10), validation of the compensation (11),
documentation (12). It states what it does not hold: the machine is simulated, without load and
without change of temperature.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.bags.bag import BagContent, write_bag
from otf_core.calibration.axis_calibration import AxisCalibration
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.files.writing import ensure_folder, write_text
from otf_core.loop.circle import PROGRAM, VOLUME, Circle, Proof
from otf_core.loop.trunnion import PoseProof, TrunnionCircle
from otf_core.model.machine import Axis
from otf_core.model.path import NominalPath
from otf_core.model.provenance import provenance
from otf_core.model.tables import ErrorTables, tables_to_dict
from otf_core.reports import rotary_calibration
from otf_core.reports.calibration import write_calibration
from otf_core.reports.page import Heading, Section, State, Table, page_html

STANDARD = 'ISO/TR 16907:2015'
REPRESENTED = {
    'axes': (
        'a table of actual positions per axis: positioning along the middle lines of the volume',
        'LinuxCNC .comp files, COMP_FILE_TYPE 0, one per joint, read at its start',
        'actual positions: the control moves the motors by nominal minus actual',
    ),
    'volume': (
        'errors on a lattice over the volume, trilinear between its points, at the measured '
        'target offset',
        'external offsets of LinuxCNC, set about every millisecond for the present position',
        'errors (actual minus nominal): the component sets the offsets to minus their values',
    ),
    'pivot': (
        'new centres of the rotary axes, and a table of actual positions per axis',
        'pins of the trunnion kinematics of LinuxCNC; .comp files, COMP_FILE_TYPE 0, one per '
        'joint, of rotary joints over degrees',
        'new values of the pins; actual positions: the control moves the motors by nominal minus '
        'actual',
    ),
    'program': (
        'errors at the ends of the parts into which the lines of the program are cut',
        'an NC program whose points are moved; nothing is set in the control',
        'errors (actual minus nominal): the points are moved by minus their values',
    ),
}
"""What represents the errors, how it is applied, and the sign, by way."""
Row = tuple[str, str]
SCHEMA = 'otf-loop/1'


def _fact_table(rows: Sequence[Row]) -> tuple[Table, ...]:
    return (Table(('', ''), tuple(rows)),)


def _range_words(name: str, axis: Axis) -> str:
    scale, unit = (np.degrees(1.0), 'deg') if axis.rotary else (1e3, 'mm')
    return f'{name} {scale * axis.min:.6g} to {scale * axis.max:.6g} {unit}'


def _determination_section(
    result: CalibrationResult | AxisCalibration, path: str, model: str
) -> Section:
    """What was measured: ``path`` and ``model`` in words."""
    machine, fit = result.tables.machine, result.fit
    ranges = ', '.join(_range_words(name, axis) for name, axis in machine.axes.items())
    offset = ', '.join(f'{1e3 * v:g}' for v in machine.target_offset)
    return Section(
        'determination',
        f'Determination of the errors ({STANDARD}, 7)',
        tables=_fact_table(
            (
                ('machine', f'{machine.name}, chain {machine.chain}'),
                ('ranges', ranges),
                ('target offset', f'({offset}) mm'),
                ('measured by', 'a simulated laser tracker, on the fly, with a clock of its own'),
                ('path', path),
                ('samples', f'{fit.used} of {fit.samples} used'),
                ('model', model),
                ('run', result.run_id),
            )
        ),
    )


def _compensation_sections(way: str, files: Iterable[str]) -> tuple[Section, Section]:
    represented, applied, sign = REPRESENTED[way]
    return (
        Section(
            'representation',
            f'Representation for the compensation ({STANDARD}, 9)',
            tables=_fact_table((('represented as', represented), ('sign', sign))),
        ),
        Section(
            'application',
            f'Application in the control ({STANDARD}, 10)',
            tables=_fact_table(
                (
                    ('control', 'LinuxCNC, servo period 1 ms'),
                    ('applied as', applied),
                    ('files (control/)', ', '.join(sorted(files))),
                )
            ),
        ),
    )


def _validation_section(data: Mapping[str, Any]) -> Section:
    rows = [
        (
            f'{number}',
            *(', '.join(f'{1e3 * v:.1f}' for v in line[end]) for end in ('start', 'end')),
            *(f'{line[when]["mean_um"]:.2f}' for when in ('before', 'after')),
            *(f'{line[when]["largest_um"]:.2f}' for when in ('before', 'after')),
        )
        for number, line in enumerate(data['lines'], start=1)
    ]
    head = ('line', 'from (mm)', 'to (mm)', 'mean before (um)', 'after', 'largest before (um)',
            'after')  # fmt: skip
    remainder, seen = data['left_um'], data['seen_by_tracker']
    return Section(
        'validation',
        f'Validation of the compensation ({STANDARD}, 11)',
        (
            f'{len(rows)} random lines through the volume, none of them used for the fit, were '
            f'driven without and with the compensation. The volumetric error is the length '
            f'of actual minus nominal position of the target, every millimetre, best rigid '
            f'motion removed; it is the true error, since the machine is simulated.',
            f'Mean {data["before_um"]:.2f} um before, {data["after_um"]:.2f} um after; forecast '
            f'{data["forecast_um"]:.2f} um with the standard uncertainty of the tables in it.',
            f'Of the remainder, the errors of the tables account for {remainder["of_tables"]:.2f} '
            f'um, the export format for {remainder["of_export"]:.2f} um and the control for '
            f'{remainder["of_control"]:.2f} um.',
            f'As measured by a tracker across the lines, including its noise: '
            f'{seen["before_um"]:.2f} um before, {seen["after_um"]:.2f} um after.',
        ),
        tables=(Table(head, tuple(rows), (3, 4, 5, 6)),),
    )


def _documentation_section(data: Mapping[str, Any], gates: Sequence[str]) -> Section:
    block = data['provenance']
    software = f'{block["software"]["name"]} {block["software"]["version"]}'
    return Section(
        'documentation',
        f'Documentation ({STANDARD}, 12)',
        tables=_fact_table(
            (
                ('written', str(block['written'])),
                ('software', software),
                ('convention', str(block['convention'])),
                ('uncertainty', str(block['coverage'])),
                ('conditions', 'no load, no change of temperature: the machine is simulated'),
                ('quality gates', '; '.join(gates) or 'all passed'),
                ('beside this page', 'loop.json, calibration/, bags/, control/'),
            )
        ),
    )


def loop_page(
    data: Mapping[str, Any],
    result: CalibrationResult,
    path: NominalPath,
    files: Iterable[str],
    gates: Sequence[str],
) -> str:
    """Return the page: self-contained HTML.

    Parameters
    ----------
    data : mapping
        loop.json.
    path : NominalPath
        That was fitted.
    files : iterable of str
        Names of what the control was given.
    gates : sequence of str
        Quality gates that failed.
    """
    way, fall = str(data['compensate']), f'{data["fall_percent"]:.1f} % less'
    tiles = (
        ('before', f'{data["before_um"]:.2f} um', 'mean volumetric error'),
        ('after', f'{data["after_um"]:.2f} um', fall),
        ('forecast', f'{data["forecast_um"]:.2f} um', 'of the export, u of the tables in it'),
    )
    heading = Heading(
        f'Compensation of {result.tables.machine.name} by {way}',
        '; '.join(gates)
        or 'Volumetric error on lines that were not fitted, before and after the compensation.',
        (State('quality gate failed', 'bad') if gates else State(fall, 'good'),),
        tiles,
    )
    sections = [
        Section('loop', ''),
        _determination_section(
            result,
            f'{len(path.leg_lengths)} lines, {path.length:.2f} m',
            'rigid bodies: 18 error motions and 3 squareness errors',
        ),
        *_compensation_sections(way, files),
    ]
    return page_html(
        heading, [*sections, _validation_section(data), _documentation_section(data, gates)]
    )


def _proof_to_dict(way: str, proof: Proof | PoseProof) -> dict[str, Any]:
    """What a proof on lines and one at poses state alike."""
    return {
        'schema': SCHEMA,
        'compensate': way,
        'before_um': 1e6 * proof.before,
        'after_um': 1e6 * proof.after,
        'forecast_um': 1e6 * proof.forecast,
        'fall_percent': 100 * (1 - proof.after / proof.before),
        'left_um': {
            'of_tables': 1e6 * proof.of_tables,
            'of_export': 1e6 * proof.of_export,
            'of_control': 1e6 * proof.of_control,
        },
    }


def loop_to_dict(circle: Circle) -> dict[str, Any]:
    """Return a round as plain data: loop.json."""
    proof, path = circle.proof, circle.recordings['check'].path
    return {
        **_proof_to_dict(circle.way, proof),
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
    proof = circle.proof
    own = _gates(proof.before, proof.after, proof.lost, circle.way)
    return (*circle.result.failed_gates, *own)


def _gates(before: float, after: float, lost: int, way: str) -> tuple[str, ...]:
    own = []
    if after >= before:
        own.append(
            f'compensation by {way} made it worse: {1e6 * before:.2f} um before, '
            f'{1e6 * after:.2f} um after; check the sign'
        )
    if lost:
        own.append(f'{lost} servo periods were not sampled: the computer is too busy')
    return tuple(own)


def format_loop(circle: Circle) -> str:
    """Return the text for a terminal."""
    proof, ways = circle.proof, {VOLUME: 'external offsets', PROGRAM: 'a corrected program'}
    lines = [
        f'compensated: {circle.way} ({ways.get(circle.way, "a .comp file per joint")})',
        f'volumetric error on lines that were not fitted, best rigid motion removed: '
        f'{1e6 * proof.before:.2f} um before, {1e6 * proof.after:.2f} um after '
        f'({100 * (1 - proof.after / proof.before):.1f} % less); forecast '
        f'{1e6 * proof.forecast:.2f} um',
        f'contributions to the remainder: tables {1e6 * proof.of_tables:.2f} um, export format'
        f' {1e6 * proof.of_export:.2f} um, control {1e6 * proof.of_control:.2f} um',
        f'as measured by the tracker across the lines: {1e6 * proof.seen_before:.2f} um before, '
        f'{1e6 * proof.seen_after:.2f} um after, both including its noise',
    ]
    if circle.way == VOLUME:
        lines.append(
            f'external offsets miss {1e6 * proof.lag_mean:.2f} um of the correction on average, '
            f'{1e6 * proof.lag_max:.2f} um at most'
        )
    return '\n'.join(lines)


def write_loop(circle: Circle, folder: str | Path) -> list[Path]:
    """Write loop.json, the calibration, the bags, and what the control was given."""
    folder = ensure_folder(folder)
    _write_control(circle.files, folder)
    for name, recording in circle.recordings.items():
        write_bag(folder / 'bags' / name, BagContent(recording.samples, recording.path))
    written = write_calibration(circle.result, folder / 'calibration')
    data = loop_to_dict(circle)
    path, gates = circle.recordings['fit'].path, failed_gates(circle)
    page = loop_page(data, circle.result, path, circle.files, gates)
    return [*_write_answer(folder, data, page, format_loop(circle), circle.truth), written[0]]


def _write_control(files: Mapping[str, bytes], folder: Path) -> None:
    control = ensure_folder(folder / 'control')
    for name, content in files.items():
        (control / name).write_bytes(content)


def _write_answer(
    folder: Path, data: Mapping[str, Any], page: str, words: str, truth: ErrorTables
) -> list[Path]:
    texts = {
        'loop.json': json.dumps(data, indent=1) + '\n',
        'loop.html': page,
        'summary.txt': words + '\n',
        'truth_tables.json': json.dumps(tables_to_dict(truth), indent=1) + '\n',
    }
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


# A trunnion: pivot and joint files, judged at poses.


def trunnion_loop_to_dict(circle: TrunnionCircle) -> dict[str, Any]:
    """Return a round of a trunnion as plain data: loop.json."""
    proof, machine = circle.proof, circle.truth.machine
    angles = [name.lower() for name in machine.rotary_names]
    return {
        **_proof_to_dict('pivot', proof),
        'pins': {
            name: {'unit': 'mm', 'old': old, 'new': new}
            for name, (old, new) in circle.pins.items()
            if not name.endswith('directions')
        },
        'poses': [
            {
                'place': place.tolist(),
                **dict(zip(angles, turned.tolist(), strict=True)),
                'before_um': 1e6 * float(before),
                'after_um': 1e6 * float(after),
            }
            for place, turned, before, after in zip(
                proof.places, proof.angles, proof.error_before, proof.error_after, strict=True
            )
        ],
        'servo_periods_lost': proof.lost,
        'failed_gates': list(failed_gates_of_trunnion(circle)),
        'provenance': provenance('loop', machines=[machine]),
    }


def failed_gates_of_trunnion(circle: TrunnionCircle) -> tuple[str, ...]:
    """Quality gates of the calibration and of the proof that failed."""
    proof = circle.proof
    return (*circle.result.failed_gates, *_gates(proof.before, proof.after, proof.lost, 'pivot'))


def format_trunnion_loop(circle: TrunnionCircle) -> str:
    """Return the text for a terminal."""
    proof = circle.proof
    moved = ', '.join(
        f'{name.partition(".")[2]} {1e3 * (new - old):+.1f} um'
        for name, (old, new) in circle.pins.items()
        if new != old
    )
    return '\n'.join(
        (
            'compensated: pivot (new pins of the kinematics, a .comp file per joint)',
            f'pins changed: {moved or "none"}',
            f'position error at {len(proof.places)} poses that were not measured, workpiece zero '
            f'set: {1e6 * proof.before:.2f} um before, {1e6 * proof.after:.2f} um after '
            f'({100 * (1 - proof.after / proof.before):.1f} % less); forecast '
            f'{1e6 * proof.forecast:.2f} um',
            f'contributions to the remainder: tables {1e6 * proof.of_tables:.2f} um, what pins '
            f'and joint files cannot hold {1e6 * proof.of_export:.2f} um, control '
            f'{1e6 * proof.of_control:.2f} um',
        )
    )


def _poses_section(circle: TrunnionCircle, data: Mapping[str, Any]) -> Section:
    names = circle.truth.machine.rotary_names
    rows = [
        (
            f'{number}',
            ', '.join(f'{1e3 * v:.1f}' for v in pose['place']),
            *(f'{np.degrees(pose[name.lower()]):.1f}' for name in names),
            f'{pose["before_um"]:.2f}',
            f'{pose["after_um"]:.2f}',
        )
        for number, pose in enumerate(data['poses'], start=1)
    ]
    pins = [
        (name, f'{value["old"]:.6f}', f'{value["new"]:.6f}', f'{value["new"] - value["old"]:+.6f}')
        for name, value in data['pins'].items()
    ]
    remainder = data['left_um']
    head = ('pose', 'place on the workpiece (mm)', *(f'{name} (deg)' for name in names),
            'before (um)', 'after (um)')  # fmt: skip
    return Section(
        'validation',
        f'Validation of the compensation ({STANDARD}, 11)',
        (
            f'{len(rows)} random poses within the ranges of all axes, none of them measured, were '
            f'driven with the kinematics of the control switched on, before and after. The error '
            f'is the length of actual minus programmed position of the tool relative to the '
            f'workpiece, workpiece zero set (best rigid motion removed); it is the true error, '
            f'since the machine is simulated.',
            f'Mean {data["before_um"]:.2f} um before, {data["after_um"]:.2f} um after; forecast '
            f'{data["forecast_um"]:.2f} um with the standard uncertainty of the tables in it.',
            f'Of the remainder, the errors of the tables account for {remainder["of_tables"]:.2f} '
            f'um, what pins and joint files cannot hold for {remainder["of_export"]:.2f} um and '
            f'the control for {remainder["of_control"]:.2f} um.',
        ),
        tables=(
            Table(('pin', 'old (mm)', 'new (mm)', 'change (mm)'), tuple(pins), (1, 2, 3)),
            Table(head, tuple(rows), tuple(range(2, len(head)))),
        ),
    )


def trunnion_loop_page(circle: TrunnionCircle, data: Mapping[str, Any]) -> str:
    """Return the page of a trunnion: self-contained HTML."""
    result, gates = circle.result, data['failed_gates']
    fall = f'{data["fall_percent"]:.1f} % less'
    tiles = (
        ('before', f'{data["before_um"]:.2f} um', 'mean position error'),
        ('after', f'{data["after_um"]:.2f} um', fall),
        ('forecast', f'{data["forecast_um"]:.2f} um', 'of the export, u of the tables in it'),
    )
    heading = Heading(
        f'Compensation of {result.machine.name} by pivot and joint files',
        '; '.join(gates) or 'Position error at poses not measured, before and after.',
        (State('quality gate failed', 'bad') if gates else State(fall, 'good'),),
        tiles,
    )
    targets = ', '.join(part.target for part in circle.recording.axis_paths)
    model = (
        f'rigid bodies: {len(result.machine.motions)} error motions, 3 squareness and '
        f'{len(result.machine.location)} location errors'
    )
    parts = f'{len(circle.recording.axis_paths)} parts: {targets}'
    return page_html(
        heading,
        [
            Section('loop', ''),
            _determination_section(result, parts, model),
            *_compensation_sections('pivot', circle.files),
            _poses_section(circle, data),
            _documentation_section(data, gates),
        ],
    )


def write_trunnion_loop(circle: TrunnionCircle, folder: str | Path) -> list[Path]:
    """Write loop.json, the calibration, the bag, and what the control was given."""
    folder = ensure_folder(folder)
    _write_control(circle.files, folder)
    recording = circle.recording
    content = BagContent(recording.samples, None, axis_paths=recording.axis_paths)
    write_bag(folder / 'bags' / 'fit', content)
    written = rotary_calibration.write_calibration(circle.result, folder / 'calibration')
    data = trunnion_loop_to_dict(circle)
    page, words = trunnion_loop_page(circle, data), format_trunnion_loop(circle)
    return [*_write_answer(folder, data, page, words, circle.truth), written[0]]
