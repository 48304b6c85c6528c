# SPDX-License-Identifier: Apache-2.0
"""Parameters of the calibrator node, besides those of the method (CalibrationConfig)."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.config import METHODS, OTF, Parameters, parameter


@dataclass(frozen=True)
class CalibratorConfig(Parameters):
    """Files, and when a run counts as finished; read at the start of every calibration."""

    machine_file: str = parameter('', 'machine description (machine.yaml); required')
    output_directory: str = parameter(
        'calibrations', 'each result gets a folder in here; the link latest points to the newest',
    )  # fmt: skip
    journal_directory: str = parameter(
        '', 'samples are written here as they arrive, one bag per run, and a restarted '
        'calibrator resumes from it; empty: journal in output_directory; none: no journal',
    )  # fmt: skip
    history_directory: str = parameter(
        '',
        'the tables of every calibration are also stored here, for otf history; empty: not stored',
    )
    method: str = parameter(
        OTF, 'otf: on the fly; standstill: only the stops at the corner points are used',
        choices=METHODS,
    )  # fmt: skip
    finish_at_standstill: bool = parameter(
        True, 'calibrate when the target stands still at the end point after the whole path'
    )
    finish_at_stream_end: bool = parameter(
        True, 'calibrate when tracker/status is FINISHED and all its samples have arrived'
    )
    idle_timeout: float = parameter(
        10.0, 'calibrate when no sample has arrived for this time and 98 % of the path has been '
        'driven, or 90 % unless the driver reports that its stream continues; 0: never',
        's', 0, 3600,
    )  # fmt: skip
    save_bag: bool = parameter(
        True, 'keep the samples of every calibration as a bag beside its results'
    )
    report: bool = parameter(True, 'write report.html beside the tables of every calibration')
    effects: str = parameter(
        'none', 'effects removed before the tables are determined: none, auto (those found by a '
        'diagnosis of the run; takes a minute) or an effects.yaml; the tables without removal '
        'are kept in plain/',
    )  # fmt: skip
    diagnose: bool = parameter(
        False, 'diagnose every run once its tables are published; calibrator/diagnose does it for '
        'the last run at any time',
    )  # fmt: skip
