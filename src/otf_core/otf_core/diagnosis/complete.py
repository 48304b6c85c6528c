# SPDX-License-Identifier: Apache-2.0
"""A whole diagnosis: answer, where it lies, calibration with the causes in it, files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.config import CalibrationConfig
from otf_core.diagnosis.answer import DiagnosisData, answer, fitted_causes, run_views
from otf_core.diagnosis.diagnose import NO_GAP_SHARE, Findings, Twin, find
from otf_core.diagnosis.engine.assess import gap_um
from otf_core.diagnosis.engine.noise_check import check_noise
from otf_core.diagnosis.place.where import describe_structure, where_and_shape
from otf_core.diagnosis.place.where_words import EVERYWHERE, NO_STRUCTURE
from otf_core.diagnosis.result import Diagnosis
from otf_core.pieces.runs import Recording
from otf_core.solving.joint import Progress
from otf_core.threads import in_one_thread

Array = NDArray[np.float64]


def _conditions(findings: Findings) -> dict[str, str]:
    rows = findings.rows
    first = rows.runs[0]
    return {
        'machine': first.machine.name,
        'chain': str(first.machine.chain),
        'samples': ', '.join(str(len(r.recording.samples)) for r in rows.runs),
        'path pieces': ', '.join(str(len(r.pieces)) for r in rows.runs),
        'tracker noise, as measured in standstills': str(first.noise),
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
