# SPDX-License-Identifier: Apache-2.0
"""Verbs on recordings and tables: calibrate, diagnose, noise, predict, compare, check."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from otf_core.cli.options import output_folder, parameters, reading_options
from otf_core.cli.output import QUALITY_GATE_FAILED, answer, answer_from, note, progress_of
from otf_core.config import AUTO, CalibrationConfig, DiagnosisConfig, WritingConfig
from otf_core.errors import ConfigError, InputError, OtfError
from otf_core.live.stages import CALIBRATE, DIAGNOSE

if TYPE_CHECKING:
    from otf_core.pieces.runs import Recording


# Verbs that work on recorded bags and on tables: calibrate, diagnose, noise, predict, compare.

TABLES = 'error_tables.json'


def read_recordings(arguments: argparse.Namespace) -> list[Recording]:
    """Read the recordings of a command, each with its machine.yaml, and its path where given.

    Raises
    ------
    ConfigError
        If there is neither one machine.yaml or path nor one per recording.
    InputError
        Names the recording that cannot be read.
    """
    from otf_core.inputs.recordings import read_recording
    from otf_core.model.machine import load_machine

    runs = [arguments.bag] if arguments.join else [[name] for name in arguments.bag]
    machines = [load_machine(file) for file in _for_each(arguments.machine, runs, '--machine')]
    paths = _for_each(arguments.path or [None], runs, '--path')
    return [
        read_recording(parts, machine, reading_options(arguments, path))
        for parts, machine, path in zip(runs, machines, paths, strict=True)
    ]


def _for_each(files: list[Any], runs: list[list[str]], option: str) -> list[Any]:
    """One of the files given for every run; ConfigError if it is not clear which."""
    if len(files) not in (1, len(runs)):
        what = 'machine.yaml' if option == '--machine' else 'path'
        raise ConfigError(
            f'{option}: given {len(files)} times for {len(runs)} runs; give one {what} '
            f'for all of them, or one for each in their order'
        )
    return files * len(runs) if len(files) == 1 else files


def run_calibrate(arguments: argparse.Namespace) -> int:
    """Error tables from recorded bags."""
    from otf_core.api import functions as api
    from otf_core.reports.calibration import write_calibration

    config = parameters(CalibrationConfig, arguments)
    writing = parameters(WritingConfig, arguments)
    effects = arguments.effects
    out = output_folder(
        arguments, *_inputs(arguments), *([effects] if effects not in (None, AUTO) else [])
    )
    with progress_of('reading', DIAGNOSE if effects else CALIBRATE) as progress:
        result = api.calibrate(
            read_recordings(arguments), method=arguments.method, effects=effects,
            same_station=arguments.same_station, config=config, progress=progress,
        )  # fmt: skip
        progress('writing', 0.0)
        with out.filled('calibrate') as folder:
            files = write_calibration(result, folder, residuals_csv=writing.residuals_csv,
                                      report=writing.report, missing=out.missing)  # fmt: skip
    if out.missing:
        note(f'otf: warning: {out.missing_words}')
    answer_from(arguments, api.summary(result), files, TABLES)
    return result.document.exit_code


def _inputs(arguments: argparse.Namespace) -> list[str]:
    """Files and folders that a verb on recordings reads."""
    return [*arguments.bag, *arguments.machine, *(arguments.path or ())]


def run_diagnose(arguments: argparse.Namespace) -> int:
    """Where and why real runs depart from their simulation."""
    from otf_core.api import functions as api
    from otf_core.pieces.finding import GATE
    from otf_core.reports.diagnosis import write_diagnosis

    config = parameters(CalibrationConfig, arguments)
    search = parameters(DiagnosisConfig, arguments)
    api.check_excluded(search.exclude)
    out = output_folder(arguments, *_inputs(arguments))
    with progress_of('reading', DIAGNOSE) as progress:
        diagnosis = api.diagnose(
            read_recordings(arguments), exclude=search.exclude, own_causes=search.own_causes,
            same_station=arguments.same_station, config=config, progress=progress,
        )  # fmt: skip
        progress('writing', 0.0)
        with out.filled('diagnose') as folder:
            files = write_diagnosis(diagnosis, folder)
    answer_from(arguments, api.summary(diagnosis), files, 'gap.json')
    for remark in diagnosis.contradictions:
        note(f'otf: {remark.severity}: {remark.check}: {remark.words}')
    return QUALITY_GATE_FAILED if any(r.severity == GATE for r in diagnosis.contradictions) else 0


def run_noise(arguments: argparse.Namespace) -> int:
    """Tracker noise in the standstills of a bag."""
    from otf_core.bags.bag import points_of
    from otf_core.files.strict_yaml import read_json
    from otf_core.inputs.recordings import open_reading
    from otf_core.model.provenance import origin_of, provenance
    from otf_core.noise.report import noise_report
    from otf_core.reports.noise_report import format_noise, write_noise

    out = output_folder(arguments, arguments.bag)
    speed = parameters(CalibrationConfig, arguments).standstill_speed
    with progress_of('looking at standstills'):
        reading = open_reading(arguments.bag, reading_options(arguments))
        samples = points_of(reading, arguments.bag)
        try:
            report = noise_report(samples, speed, max(len(reading.axis_paths), 1))
        except OtfError as error:
            raise type(error)(f'{arguments.bag}: {error}') from None
        origin = dataclasses.replace(
            origin_of(Path(arguments.bag).name, samples), left_out=tuple(reading.left_out)
        )
        with out.filled('noise') as folder:
            files = write_noise(report, folder, provenance('noise', runs=[origin]))
    words = format_noise(read_json(out.path / 'noise.json'))
    answer_from(arguments, words + '\n', files, 'noise.json')
    return 0


def _points(file: str, names: Sequence[str]) -> tuple[Any, str]:
    """Points (n, m) of a file, a column each for these, and what its text was read as."""
    from otf_core.inputs.path_file import read_points, read_positions

    return (read_positions(file, names), '') if len(names) > 3 else read_points(file)


def run_predict(arguments: argparse.Namespace) -> int:
    """Volumetric errors at points, from error tables."""
    import numpy as np

    from otf_core.files.output_folder import OutputFile
    from otf_core.files.writing import ends_head, write_csv
    from otf_core.prediction.calibration_document import load_tables
    from otf_core.prediction.predict import predict

    tail = 'dx,dy,dz,u_dx,u_dy,u_dz,u_run_dx,u_run_dy,u_run_dz,inside'
    out = OutputFile(
        arguments.out,
        lambda path: ends_head(path, tail),
        overwrite=arguments.overwrite,
        inputs=(arguments.tables, arguments.points),
    )
    content = load_tables(arguments.tables)
    names = content.tables.machine.point_names
    points, read_as = _points(arguments.points, names)
    if read_as:
        note(f'otf predict: {read_as}')
    offset = None if arguments.target_offset is None else np.array(arguments.target_offset)
    prediction = predict(content, points, offset, arguments.points)
    columns = np.hstack([points, prediction.error, prediction.u, prediction.u_run])
    header = f'{",".join(names).lower()},{tail}'
    with out.filled() as partial:
        write_csv(partial, header, columns, prediction.inside)
    for text in prediction.notes:
        note(f'otf predict: {text}')
    heads, within = header.split(','), prediction.inside.astype(int).tolist()
    rows = zip(columns.tolist(), within, strict=True) if arguments.json else ()
    listed = [dict(zip(heads, [*row, inside], strict=True)) for row, inside in rows]
    data = {'points': [{k: v if v == v else None for k, v in p.items()} for p in listed]}
    about = {'notes': list(prediction.notes), 'u_contains': prediction.holds}
    answer(arguments, prediction.summary, {**about, **data, 'out': arguments.out})
    return 0


def run_compare(arguments: argparse.Namespace) -> int:
    """Error tables or direct measurements, motion by motion."""
    from otf_core.comparison.compare import compare, load_sources
    from otf_core.files.strict_yaml import read_json
    from otf_core.model.machine import load_machine
    from otf_core.model.provenance import STANDARD, provenance
    from otf_core.reports.comparison import format_comparison, write_comparison

    given = [arguments.a, arguments.b, arguments.machine, arguments.points]
    out = output_folder(arguments, *(name for name in given if name))
    machine = load_machine(arguments.machine) if arguments.machine else None
    (a, b), remarks = load_sources([arguments.a, arguments.b], machine, arguments.sign)
    for remark in remarks:
        note(f'otf compare: {remark}')
    points = None
    if arguments.points:
        own = a.tables.machine
        points = own.axis_positions(_points(arguments.points, own.point_names)[0])
    about = provenance(
        'compare',
        machines=[machine] if machine else [],
        files={'a': arguments.a, 'b': arguments.b, 'points': arguments.points},
        coverage=f'{STANDARD}; normalised errors with U = 2 u (k = 2)',
    )
    result = compare(a, b, points)
    with progress_of('drawing'), out.filled('compare') as folder:
        files = write_comparison(result, folder, about)
    words = format_comparison(read_json(out.path / 'comparison.json'))
    answer_from(arguments, words + '\n', files, 'comparison.json')
    return 0


# Verb that answers in seconds: check.


def run_check(arguments: argparse.Namespace) -> int:
    """State whether a recording is usable."""
    config = parameters(CalibrationConfig, arguments)
    from otf_core.checking.checks import check, format_check
    from otf_core.model.machine import load_machine

    machine = load_machine(arguments.machine) if arguments.machine else None
    path = arguments.path[-1] if arguments.path else None
    with progress_of('checking'):
        report = check(arguments.bag, machine, config, reading_options(arguments, path))
    answer(arguments, format_check(report), report.to_dict())
    return 0 if report.usable else InputError.exit_code
