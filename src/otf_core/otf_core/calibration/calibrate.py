# SPDX-License-Identifier: Apache-2.0
"""From samples and path to error tables: align, reduce, solve, repeat, state uncertainty."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from otf_core.budget.typical import typical_warnings, with_typical
from otf_core.calibration.assessed import assess
from otf_core.calibration.headline import headline_of
from otf_core.calibration.mixtures import mixture_warnings
from otf_core.calibration.result import CalibrationResult, Fit
from otf_core.calibration.solved import solve_recordings
from otf_core.calibration.verdict import judge
from otf_core.config import CalibrationConfig
from otf_core.contradictions.table_checks import check_worth, sample_noise
from otf_core.effects.stated_effect import TakenOff
from otf_core.live.stages import Progress, silent
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.provenance import origins
from otf_core.model.tables import ErrorTables
from otf_core.pieces.finding import GATE, WARNING, Finding, words_of
from otf_core.pieces.methods import Preparation
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.prediction.volumetric import VolumetricError
from otf_core.solving.curve_lag import curve_remarks
from otf_core.solving.model_choice import ReversalSolution
from otf_core.solving.reversal import Reversal, backlash_at_target, reversal_tables
from otf_core.solving.tabulate import prior_of
from otf_core.threads import one_thread

MIN_COVERAGE = 0.8
"""Share of the path length below which a calibration fails the quality gate."""
MAX_OUTLIERS = 0.2
"""Share of left-out samples above which a calibration fails the quality gate."""
MAX_ERROR = 5e-4
"""m; mean distance from the path above which the input is not plausible for a machine tool."""


def _run_id(recordings: Sequence[Recording], config: CalibrationConfig) -> str:
    digest = hashlib.sha256()
    for r in recordings:
        for part in (r.samples.stamp_ns, r.samples.xyz, r.path.points):
            digest.update(np.ascontiguousarray(part).reshape(-1).data)
        digest.update(json.dumps(r.machine.to_dict(), sort_keys=True).encode())
    digest.update(json.dumps(asdict(config), sort_keys=True).encode())
    return digest.hexdigest()[:12]


def _warnings(fit: Fit, tables: ErrorTables, limit: float) -> list[str]:
    found = []
    unsure = [m for m in MOTIONS if tables.motions[m].u.max() > limit]
    if unsure:
        found.append(
            f'{", ".join(unsure)}: uncertain by more than {1e6 * limit:g} um or urad, with the '
            f'misfit of the model counted'
        )
    for name, table in tables.motions.items():
        if table.identifiable and table.node_identifiable is not None:
            loose = table.position[~table.node_identifiable]
            if loose.size:
                where = f'{loose[0]:g}' if loose.size == 1 else f'{loose[0]:g} ... {loose[-1]:g}'
                found.append(
                    f'{name}: not determined by the data at {loose.size} nodes ({where} m); '
                    f'continued smoothly'
                )
    if fit.coverage < 0.98:
        found.append(f'only {100 * fit.coverage:.1f} % of the path was recorded')
    if fit.residual_ratio > 1.5:
        found.append(
            f'residuals of path pieces are {fit.residual_ratio:.1f} times the noise specified for '
            f'single samples: an effect that the rigid-body model lacks, or more noise'
        )
    return found


def calibrate(
    samples: Samples,
    path: NominalPath,
    machine: Machine,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate one run on the fly; see ``calibrate_runs``."""
    return calibrate_runs([Recording(samples, path, machine)], config, progress)


def calibrate_runs(
    recordings: Sequence[Recording],
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
    prepare: Preparation = prepare_runs,
) -> CalibrationResult:
    """Calibrate on the fly: only deviations perpendicular to the path are used.

    Parameters
    ----------
    recordings : sequence of Recording
        Runs of one machine; no time relation between samples and path is needed. Other tracker
        places, feeds and target offsets add to what can be seen.
    config : CalibrationConfig, optional
    progress : callable(stage, fraction), optional
        Called as work goes on, stage 'aligning' or 'solving'; what it raises ends the work.
    prepare : callable, optional
        One of ``methods.PREPARATIONS``.

    Returns
    -------
    CalibrationResult

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.

    References
    ----------
    Sanders et al., J. Manuf. Mater. Process. 2023, 7, 60, section 1.2.
    """
    config, progress = config or CalibrationConfig(), progress or silent
    with one_thread():
        solved = solve_recordings(recordings, config, progress, prepare)
        return assemble(solved.solution, config, solved.findings)


def _failed_gates(fit: Fit) -> tuple[str, ...]:
    failed = []
    if fit.coverage < MIN_COVERAGE:
        failed.append(
            f'coverage: {100 * fit.coverage:.0f} % of the path driven, '
            f'{100 * MIN_COVERAGE:.0f} % needed'
        )
    if fit.outliers > MAX_OUTLIERS * fit.samples:
        failed.append(
            f'outliers: {100 * fit.outliers / fit.samples:.0f} % of the samples left out, '
            f'{100 * MAX_OUTLIERS:.0f} % allowed'
        )
    if fit.path_mae_before > MAX_ERROR:
        failed.append(
            f'plausibility: the track is {1e3 * fit.path_mae_before:.2f} mm off the path on '
            f'average; check units, scale and the machine description'
        )
    if fit.path_mae_after >= fit.path_mae_before:
        failed.append('compensation: the tables do not reduce the distance from the path')
    return tuple(failed)


def assemble(
    solved: ReversalSolution[Run],
    config: CalibrationConfig,
    findings: Sequence[Finding] = (),
    taken: TakenOff | None = None,
) -> CalibrationResult:
    """Work out fit and uncertainties of a solution, tables and verdicts: the result.

    Parameters
    ----------
    solved : ReversalSolution
    config : CalibrationConfig
    findings : sequence of Finding
        Of the examination of its runs.
    taken : TakenOff, optional
        Effects that were taken off the runs.
    """
    runs = solved.runs
    found = assess(runs, solved.done, config, taken)
    done, budget, table, tables = found.done, found.budget, found.table, found.tables
    solution, covariance = done.solution, budget.covariance
    findings = (*findings, *check_worth(tables, covariance, sample_noise(runs)))
    hidden = tuple(n for n in (*SQUARENESS, *MOTIONS) if n not in solution.accepted)
    prior = prior_of(done, tables, config.unidentifiable_above)
    stated = with_typical(budget, found.typical)
    whole = budget.covariance if found.typical is None else stated.covariance
    volume = VolumetricError(tables, whole, prior, hidden)
    return CalibrationResult(
        run_id=_run_id([r.recording for r in runs], config),
        tables=tables,
        covariance=covariance,
        budget=budget,
        runs=tuple(found.results),
        fit=found.fit,
        headline=headline_of(volume, stated, found.typical),
        reversal=Reversal(
            solved.choice.model,
            solved.choice.evidence,
            reversal_tables(
                tables,
                done.unknowns,
                solution.value,
                found.whole,
                solution.accepted,
            ),
            solved.choice.held,
            backlash_at_target(
                tables,
                done.unknowns,
                solution.value,
                found.whole,
                solution.accepted,
            ),
        ),
        fraction=table.fraction,
        table_costs=table.costs,
        prior=prior,
        not_identifiable=hidden,
        typical=found.typical,
        warnings=(
            *typical_warnings(found.typical),
            *words_of(findings, WARNING),
            *_warnings(found.fit, tables, config.unidentifiable_above),
            *filter(None, [found.lack_of_fit]),
            *mixture_warnings([r.machine for r in runs], hidden),
            *(r.alignment.remark for r in runs if r.alignment.remark),
            *curve_remarks(runs, done),
        ),
        failed_gates=(
            *words_of(findings, GATE),
            *_failed_gates(found.fit),
        ),
        config=config,
        origin=origins(r.recording for r in runs),
        effects=taken.stated if taken is not None else (),
        machine_verdict=judge(tables, whole, stated, hidden, prior),
    )
