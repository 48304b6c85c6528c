# SPDX-License-Identifier: Apache-2.0
"""The files of a diagnosis: gap.json, report.html, and with causes what they do to the tables."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from otf_core.calibration.calibrate import calibrate_prepared
from otf_core.calibration.correction import calibrate_without
from otf_core.calibration.result import CalibrationResult
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.answer import DiagnosisData
from otf_core.diagnosis.engine.rows import Rows
from otf_core.diagnosis.result import Diagnosis
from otf_core.effects import AppliedEffect, BelongsTo
from otf_core.effects.effects_yaml import write_effects
from otf_core.effects.stated import FOUND
from otf_core.effects.taken import taken
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.provenance import COVERAGE, origin_of, provenance
from otf_core.reports.calibration import write_calibration
from otf_core.reports.gap import write_report
from otf_core.threads import in_one_thread


def _with_causes(
    rows: Rows,
    applied: Sequence[Sequence[AppliedEffect]],
    plain: CalibrationResult,
    config: CalibrationConfig,
) -> CalibrationResult:
    """Calibrate again with the causes taken off, reversal among them."""
    found = [taken(list(one), FOUND) for one in zip(*applied, strict=True)]
    taking = [one for one in found if one.effect.belongs_to is not BelongsTo.TABLES]
    if not taking:
        return plain
    config = replace(config, reversal='none')
    return calibrate_without([r.recording for r in rows.runs], taking, config)[0]


def _table_change_um(plain: CalibrationResult, other: CalibrationResult) -> float:
    points = lattice(plain.tables.machine)
    change = displacement(other.tables, points) - displacement(plain.tables, points)
    return 1e6 * mean_length(without_rigid_motion(change, points))


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
