# SPDX-License-Identifier: Apache-2.0
"""How well a solution fits its runs and how uncertain it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import (
    EFFECTS,
    Budget,
    make_budget,
    noise_parts,
    whole_check,
    with_source,
)
from otf_core.budget.typical import TypicalSystematic, typical_pulls, typical_systematic
from otf_core.calibration.passes import unfollowed
from otf_core.calibration.result import Fit, RunResult
from otf_core.config import CalibrationConfig
from otf_core.effects.stated_effect import TakenOff
from otf_core.memory import give_back
from otf_core.model.tables import ErrorTables, with_uncertainty
from otf_core.noise.noise_model import NoiseModel, sample_variance
from otf_core.noise.standstill import lost_samples
from otf_core.pieces.runs import Run, rigid_pose
from otf_core.solving.joint import JointSolution, SolvedRun, settled, tables_of
from otf_core.solving.system import deviations
from otf_core.solving.tabulate import Tabulation, mean_grid_uncertainty, tabulate


@dataclass(frozen=True)
class Assessed:
    """What a result says of a solution, whatever was decided about reversal or found in runs.

    Attributes
    ----------
    done : JointSolution
        With the covariance of all passes.
    results : list of RunResult
    budget : Budget
        Of the rows of ``table``.
    whole : ndarray, shape (full, full)
        Covariance of all unknowns.
    fit : Fit
    table : Tabulation
    tables : ErrorTables
        With their uncertainties.
    typical : TypicalSystematic, optional
    lack_of_fit : str, optional
        Words on what the tables leave in every pass over a line, where it matters.
    """

    done: JointSolution
    results: list[RunResult]
    budget: Budget
    whole: Array
    fit: Fit
    table: Tabulation
    tables: ErrorTables
    typical: TypicalSystematic | None
    lack_of_fit: str | None


def assess(
    runs: Sequence[Run],
    done: JointSolution,
    config: CalibrationConfig,
    taken: TakenOff | None = None,
) -> Assessed:
    """Work out fit and uncertainty of a solution, with the effects ``taken`` off its runs."""
    pulls = typical_pulls(runs, done)
    parts = noise_parts(runs, done)
    give_back()
    done = settled(done, config.unidentifiable_above, parts.normal)
    unknowns, machine = done.unknowns, runs[0].machine
    results = [_run_result(r, s, config) for r, s in zip(runs, done.runs, strict=True)]
    fine = tables_of(machine, unknowns, done.solution)
    budget = make_budget(runs, done, parts, fine, config.standstill_speed)
    if taken is not None:
        budget = with_source(budget, EFFECTS, budget.inflation * taken.of_unknowns)
    fit = _fit(runs, results, done, budget.inflation)
    grid_u = mean_grid_uncertainty(machine, unknowns, budget.whole)
    table = tabulate(machine, done, grid_u, config.unidentifiable_above)
    whole, budget = budget.whole, replace(budget, rows=table.rows, straight=table.straight)
    tables = with_uncertainty(table.tables, budget.covariance)
    give_back()
    typical = typical_systematic(runs, done, tables, table.rows, budget.covariance, pulls)
    again = unfollowed(runs, done)
    lack = again.warning(grid_u) if again is not None else None
    return Assessed(done, results, budget, whole, fit, table, tables, typical, lack)


def _run_result(run: Run, solved: SolvedRun, config: CalibrationConfig) -> RunResult:
    rigid = rigid_pose(run.pieces, run.pose, config)  # that of a solution holds its gauge
    specified = sample_variance(NoiseModel.from_spec(run.machine.tracker), solved.system.shares)
    return RunResult(
        name=Path(run.recording.name).name,
        target_offset=run.machine.target_offset,
        samples=len(run.recording.samples),
        remarks=run.recording.remarks,
        rate=1.0 / run.recording.samples.step,
        lost=lost_samples(run.recording.samples),
        T_machine_tracker=solved.pose,
        noise=run.noise_and_misfit[0],
        misfit=run.noise_and_misfit[1],
        coverage=run.alignment.coverage,
        pieces=run.pieces,
        q=solved.system.q,
        axes=solved.system.axes,
        aligned=deviations(run.pieces, rigid),
        deviation=solved.system.deviation,
        residual=solved.residual,
        normalised=solved.residual / np.sqrt(specified),
        whitened=solved.whitener.whiten(solved.residual),
    )


def _lengths(components: Array) -> Array:
    return np.asarray(np.linalg.norm(components, axis=0))


def _fit(
    runs: Sequence[Run], results: Sequence[RunResult], done: JointSolution, inflation: float
) -> Fit:
    check = whole_check(runs, done, [s.residual for s in done.runs])
    before = np.concatenate([_lengths(r.aligned) for r in results])
    after = np.concatenate([_lengths(r.residual) for r in results])
    normalised = np.concatenate([r.normalised for r in results], axis=1)
    return Fit(
        samples=sum(len(r.recording.samples) for r in runs),
        used=sum(r.pieces.used for r in runs),
        outliers=sum(r.pieces.outliers for r in runs),
        pieces=len(after),
        unknowns=done.solution.unknowns,
        rank=done.solution.rank,
        coverage=min(r.alignment.coverage for r in runs),
        path_mae_before=float(before.mean()),
        path_mae_after=float(after.mean()),
        residual_rms=float(np.sqrt(np.mean(after**2))),
        residual_ratio=float(np.sqrt(np.mean(normalised**2))),
        variance_ratio=check.variance_ratio,
        correlation_factor=check.correlation_factor,
        inflation=inflation,
        iterations=done.iterations,
    )
