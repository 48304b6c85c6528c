# SPDX-License-Identifier: Apache-2.0
"""Verbs on recordings and tables: calibrate, diagnose, noise, predict, compare, check."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from otf_core.cli.options import output_folder, parameters, reading_options
from otf_core.cli.output import answer, finish, note, progress_of
from otf_core.config import AUTO, POINTS, CalibrationConfig, DiagnosisConfig, WritingConfig
from otf_core.errors import ConfigError
from otf_core.live.stages import CALIBRATE, DIAGNOSE

if TYPE_CHECKING:
    from otf_core.pieces.point_pairs import PointPairs
    from otf_core.pieces.runs import Recording


# Verbs that work on recorded bags and on tables: calibrate, diagnose, noise, predict, compare.


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


def read_pairs(arguments: argparse.Namespace) -> list[PointPairs]:
    """Read tables of nominal and measured positions, as ``read_recordings``."""
    from otf_core.inputs.point_pairs import read_point_pairs

    given = {'--path': arguments.path, '--columns': arguments.columns, '--rate': arguments.rate,
             '--join': arguments.join, '--same-station': arguments.same_station}  # fmt: skip
    if wrong := [option for option, value in given.items() if value]:
        raise ConfigError(f'{wrong[0]}: means nothing with --method {POINTS}; leave it out')
    machines = _for_each(arguments.machine, [[name] for name in arguments.bag], '--machine')
    pairs = zip(arguments.bag, machines, strict=True)
    return [run for name, machine in pairs for run in read_point_pairs(name, machine)]


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
    given = [effects] if effects not in (None, AUTO) else []
    out = output_folder(arguments, *_inputs(arguments), *given)
    with progress_of('reading', DIAGNOSE if effects else CALIBRATE) as progress:
        read = read_pairs if arguments.method == POINTS else read_recordings
        result = api.calibrate(
            read(arguments), method=arguments.method, effects=effects,
            same_station=arguments.same_station, config=config, progress=progress,
        )  # fmt: skip

    def write(folder: Path) -> list[Path]:
        return write_calibration(result, folder, report=writing.report, missing=out.missing)

    return finish(arguments, out, result.document, write)


def _inputs(arguments: argparse.Namespace) -> list[str]:
    """Files and folders that a verb on recordings reads."""
    return [*arguments.bag, *arguments.machine, *(arguments.path or ())]


def run_diagnose(arguments: argparse.Namespace) -> int:
    """Where and why real runs depart from their simulation."""
    from otf_core.api import functions as api
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
    code = finish(arguments, out, diagnosis.document, partial(write_diagnosis, diagnosis))
    for remark in diagnosis.contradictions:
        note(f'otf: {remark.severity}: {remark.check}: {remark.words}')
    return code


def run_noise(arguments: argparse.Namespace) -> int:
    """Tracker noise in the standstills of a bag."""
    from otf_core.api import functions as api

    out = output_folder(arguments, arguments.bag)
    speed = parameters(CalibrationConfig, arguments).standstill_speed
    with progress_of('looking at standstills'):
        document = api.noise(arguments.bag, speed, reading_options(arguments))
    return finish(arguments, out, document)


def run_predict(arguments: argparse.Namespace) -> int:
    """Volumetric errors at points, from error tables."""
    import numpy as np

    from otf_core.files.output_folder import OutputFile
    from otf_core.files.writing import ends_head, write_csv
    from otf_core.inputs.path_file import read_target_points
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
    points, read_as = read_target_points(arguments.points, names)
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
    from otf_core.api import functions as api

    given = [arguments.a, arguments.b, arguments.machine, arguments.points]
    out = output_folder(arguments, *filter(None, given))
    document = api.compare(
        arguments.a, arguments.b, arguments.machine, arguments.points, arguments.sign
    )
    return finish(arguments, out, document)


# Verb that answers in seconds: check.


def run_check(arguments: argparse.Namespace) -> int:
    """State whether a recording is usable."""
    from otf_core.checking.checks import check, format_check
    from otf_core.model.machine import load_machine

    config = parameters(CalibrationConfig, arguments)
    machine = load_machine(arguments.machine) if arguments.machine else None
    path = arguments.path[-1] if arguments.path else None
    with progress_of('checking'):
        report = check(arguments.bag, machine, config, reading_options(arguments, path))
    answer(arguments, format_check(report), report.to_dict())
    return report.exit_code
