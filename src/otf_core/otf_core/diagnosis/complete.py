# SPDX-License-Identifier: Apache-2.0
"""A whole diagnosis: answer, where it lies, calibration with the causes in it, files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.calibrate import calibrate_prepared
from otf_core.calibration_result import CalibrationResult
from otf_core.config import CalibrationConfig
from otf_core.correction import TABLES_OWN, calibrate_without
from otf_core.diagnosis.answer import DiagnosisData, answer, fitted_causes, run_views
from otf_core.diagnosis.assess import gap_um
from otf_core.diagnosis.diagnose import NO_GAP_SHARE, Findings, Twin, find
from otf_core.diagnosis.noise_check import check_noise
from otf_core.diagnosis.result import Diagnosis
from otf_core.diagnosis.rows import Rows
from otf_core.diagnosis.where import describe_structure, where_and_shape
from otf_core.diagnosis.where_words import EVERYWHERE, NO_STRUCTURE
from otf_core.effects import AppliedEffect
from otf_core.effects.stated import FOUND
from otf_core.effects.taken import taken
from otf_core.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.io.effects_yaml import write_effects
from otf_core.io.files import ensure_folder, write_text
from otf_core.joint import Progress
from otf_core.kinematics import displacement
from otf_core.provenance import COVERAGE, origin_of, provenance
from otf_core.results import write_calibration
from otf_core.runs import Recording
from otf_core.threads import in_one_thread

Array = NDArray[np.float64]


def _with_causes(
    rows: Rows,
    applied: Sequence[Sequence[AppliedEffect]],
    plain: CalibrationResult,
    config: CalibrationConfig,
) -> CalibrationResult:
    """Calibrate again with the causes taken off, reversal among them."""
    found = [taken(list(one), FOUND) for one in zip(*applied, strict=True)]
    taking = [one for one in found if one.effect.name not in TABLES_OWN]
    if not taking:
        return plain
    config = replace(config, reversal='none')
    return calibrate_without([r.recording for r in rows.runs], taking, config)[0]


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


@in_one_thread
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
    project, left = findings.rows.project, NO_STRUCTURE
    if findings.causes:
        left = describe_structure(run_views(names, findings), 'residual_after', project)
        rest = left
        if findings.known_rest is not findings.fitted:
            known = run_views(names, replace(findings, fitted=findings.known_rest))
            rest = describe_structure(known, 'residual_after', project)
        findings = replace(findings, left_has_place=rest not in (NO_STRUCTURE, EVERYWHERE))
    diagnosis, findings = answer(names, findings, noise)
    views = run_views(names, findings)
    where, shape = where_and_shape(views, project=project)
    if findings.causes:
        shape = left
    remarks = findings.rows.runs[0].remarks
    told = {**diagnosis.extra, 'contradictions': [asdict(r) for r in remarks]}
    diagnosis = replace(diagnosis, where=where, unexplained_where=shape, extra=told)
    named = fitted_causes(findings)
    applied = tuple(tuple(p.applied(k) for p in named) for k in range(len(recordings)))
    data = DiagnosisData(findings, views, _conditions(findings), applied)
    return diagnosis, data


def _provenance(diagnosis: Diagnosis, rows: Rows) -> dict[str, Any]:
    recordings = [run.recording for run in rows.runs]
    named = zip(diagnosis.runs, recordings, strict=True)
    return provenance(
        'diagnose',
        method='otf',
        runs=[origin_of(name, r.samples, r.path, r.machine) for name, r in named],
        coverage=f'{COVERAGE}; intervals: 95 %',
    )


def effects_file(run: int) -> str:
    """File of the effects in one run; further runs have one where theirs differ."""
    return f'effects_run_{run + 1}.yaml' if run else 'effects.yaml'


@in_one_thread
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
    rows = data.findings.rows
    written: list[Path] = []
    if data.applied[0]:
        for number, (run, applied) in enumerate(zip(rows.runs, data.applied, strict=True)):
            if not number or applied != data.applied[0]:
                written.append(folder / effects_file(number))
                write_effects(written[-1], applied, run.machine)
        plain = calibrate_prepared(rows.runs, rows.done.unknowns, config)
        better = _with_causes(rows, data.applied, plain, config)
        diagnosis = replace(diagnosis, table_change_um=_table_change_um(plain, better))
        write_calibration(plain, folder / 'calibration_plain', 'diagnose')
        write_calibration(better, folder / 'calibration_with_effects', 'diagnose')
        written.append(folder / 'calibration_with_effects')
    write_report(diagnosis, data, folder / 'report.html')
    content = diagnosis.to_dict() | {'provenance': _provenance(diagnosis, rows)}
    write_text(folder / 'gap.json', json.dumps(content, indent=1) + '\n')
    return [*written, folder / 'report.html', folder / 'gap.json']
