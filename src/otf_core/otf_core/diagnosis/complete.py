# SPDX-License-Identifier: Apache-2.0
"""A whole diagnosis: answer, where it lies, calibration with the causes in it, files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from otf_core.calibrate import CalibrationResult, calibrate_runs
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.answer import DiagnosisData, answer, fitted_causes, run_views
from otf_core.diagnosis.assess import gap_um
from otf_core.diagnosis.decoys import DECOY_NAMES
from otf_core.diagnosis.diagnose import NO_GAP_SHARE, Findings, Twin, find
from otf_core.diagnosis.noise_check import check_noise
from otf_core.diagnosis.result import Diagnosis
from otf_core.diagnosis.where import describe_structure, where_of
from otf_core.effects import AppliedEffect, total_displacement
from otf_core.effects.state import state_on_path
from otf_core.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.frames import RigidTransform
from otf_core.io.effects_yaml import write_effects
from otf_core.io.files import ensure_folder, write_text
from otf_core.joint import Progress
from otf_core.kinematics import displacement
from otf_core.matching import OFF_PATH
from otf_core.observation import Samples
from otf_core.path import along_legs
from otf_core.results import write_calibration
from otf_core.runs import Recording, Run
from otf_core.tables import ErrorTables


def corrected_recording(
    run: Run, pose: RigidTransform, tables: ErrorTables, applied: Sequence[AppliedEffect]
) -> Recording:
    """Take fitted effects off the samples of a run.

    Parameters
    ----------
    run : Run
    pose : RigidTransform
        Tracker to machine.
    tables : ErrorTables
    applied : sequence of AppliedEffect

    Returns
    -------
    Recording
    """
    samples, leg, corners = run.recording.samples, run.alignment.leg, run.alignment.corners
    on = leg != OFF_PATH
    place = along_legs(pose.apply(samples.xyz[on]), corners, leg[on])
    along = place.along
    q = corners[leg[on]] + along[:, None] * place.unit
    time = samples.time[on]
    half = max(1, len(time) // 20000 + 2)
    speed = np.abs(np.gradient(np.convolve(along, np.ones(half) / half, 'same'), time))
    ends = float(samples.time[-1])
    state = state_on_path(run.machine, corners, leg[on], q, speed, time, pose, {}, tables, ends)
    xyz = samples.xyz.copy()
    xyz[on] -= total_displacement(state, applied) @ pose.rotation
    return replace(run.recording, samples=Samples(samples.stamp_ns, xyz))


def _with_causes(
    findings: Findings, applied: Sequence[AppliedEffect], config: CalibrationConfig
) -> CalibrationResult:
    rows = findings.rows
    recordings = [
        corrected_recording(run, solved.pose, rows.tables, applied)
        for run, solved in zip(rows.runs, rows.done.runs, strict=True)
    ]
    return calibrate_runs(recordings, config)


def _table_change_um(plain: CalibrationResult, other: CalibrationResult) -> float:
    points = lattice(plain.tables.machine)
    change = displacement(other.tables, points) - displacement(plain.tables, points)
    return 1e6 * mean_length(without_rigid_motion(change, points))


def _conditions(findings: Findings) -> dict[str, str]:
    rows = findings.rows
    first = rows.runs[0]
    noise = first.noise
    return {
        'machine': first.machine.name,
        'chain': str(first.machine.chain),
        'samples': ', '.join(str(len(r.recording.samples)) for r in rows.runs),
        'path pieces': ', '.join(str(len(r.pieces)) for r in rows.runs),
        'tracker noise, as measured in standstills': (
            f'{1e6 * noise.u_range:.2f} um along the beam, {1e6 * noise.u_angle:.2f} urad across, '
            f'{100 * noise.white_angle:.0f} % white, correlated over '
            f'{noise.correlation_time:.2f} s'
        ),
    }


def diagnose(
    recordings: Sequence[Recording],
    names: Sequence[str],
    twin: Twin,
    exclude: Sequence[str] = (),
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> tuple[Diagnosis, DiagnosisData]:
    """Diagnose runs of one machine.

    Parameters
    ----------
    recordings : sequence of Recording
    names : sequence of str
        Of the runs, for the report.
    twin : callable
        Simulates a run again: ``sim.twin.twin_recording``.
    exclude : sequence of str
        Effects taken out of the catalogue.
    config : CalibrationConfig, optional
    progress : callable(stage, fraction), optional

    Returns
    -------
    diagnosis : Diagnosis
    data : DiagnosisData
    """
    config = config or CalibrationConfig()
    findings = find(recordings, twin, exclude, config, progress)
    noise = None
    if (
        gap_um(findings.steps[-1].rms_um, findings.simulated_um)
        > NO_GAP_SHARE * findings.simulated_um
    ):
        noise = check_noise(findings.rows, config.standstill_speed, exclude)
    diagnosis, findings = answer(names, findings, noise)
    views = run_views(names, findings)
    project = findings.rows.project
    left = 'residual_after' if findings.causes else 'residual_before'
    diagnosis = replace(
        diagnosis,
        where=where_of(views, project=project),
        unexplained_where=describe_structure(views, left, project),
    )
    applied = tuple(
        part.applied()
        for part in fitted_causes(findings)
        if part.cause.option.effect.name not in DECOY_NAMES
    )
    data = DiagnosisData(findings, views, _conditions(findings), applied)
    return diagnosis, data


def write_diagnosis(
    diagnosis: Diagnosis,
    data: DiagnosisData,
    folder: str | Path,
    config: CalibrationConfig | None = None,
) -> list[Path]:
    """Write gap.json, report.html, and with causes effects.yaml and both calibrations.

    Returns
    -------
    list of Path
        gap.json last.
    """
    from otf_core.report_gap import write_report

    config = config or CalibrationConfig()
    folder = ensure_folder(folder)
    rows, written = data.findings.rows, []
    if data.applied:
        machine = rows.runs[0].machine
        write_effects(folder / 'effects.yaml', data.applied, machine)
        plain = calibrate_runs([r.recording for r in rows.runs], config)
        better = _with_causes(data.findings, data.applied, config)
        diagnosis = replace(diagnosis, table_change_um=_table_change_um(plain, better))
        write_calibration(plain, folder / 'calibration_plain')
        write_calibration(better, folder / 'calibration_with_effects')
        written += [folder / 'effects.yaml', folder / 'calibration_with_effects']
    write_report(diagnosis, data, folder / 'report.html')
    write_text(folder / 'gap.json', json.dumps(diagnosis.to_dict(), indent=1) + '\n')
    return [*written, folder / 'report.html', folder / 'gap.json']
