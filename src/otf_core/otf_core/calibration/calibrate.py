# SPDX-License-Identifier: Apache-2.0
"""From recordings to error tables: align, reduce, examine, solve, state uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import (
    EFFECTS,
    Budget,
    make_budget,
    noise_parts,
    piece_states,
    whole_check,
    with_source,
)
from otf_core.budget.typical import (
    TypicalSystematic,
    typical_pulls,
    typical_systematic,
    typical_warnings,
    with_typical,
)
from otf_core.calibration.calibration_result import CalibrationResult, Fit, RunResult, headline_of
from otf_core.calibration.lack_of_fit import find_lack_of_fit
from otf_core.calibration.machine_verdict import judge
from otf_core.config import CalibrationConfig
from otf_core.contradictions.examine import check_left_out, examine
from otf_core.contradictions.recording_checks import check_recordings
from otf_core.contradictions.table_checks import check_table_pitch, check_worth, sample_noise
from otf_core.effects.stated_effect import RemovedEffects
from otf_core.live.stages import Progress, silent
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.provenance import origins
from otf_core.model.tables import ErrorTables, with_uncertainty
from otf_core.noise.noise_model import NoiseModel, sample_variance
from otf_core.noise.standstill import lost_samples
from otf_core.pieces.finding import (
    COMPLETE_PATH,
    GATE,
    WARNING,
    Finding,
    failed_gates_of_data,
    words_of,
)
from otf_core.pieces.methods import Preparation
from otf_core.pieces.runs import Recording, Run, prepare_runs, rigid_pose, run_id
from otf_core.prediction.volumetric import VolumetricError, driven_rows
from otf_core.solving.joint import JointSolution, SolvedRun, settle_covariance, tables_of
from otf_core.solving.model_choice import ReversalSolution, solve_with_reversal
from otf_core.solving.reversal import Reversal, backlash_at_target, reversal_tables
from otf_core.solving.system import deviations
from otf_core.solving.tabulate import Tabulation, mean_grid_uncertainty, tabulate, unseen_sizes
from otf_core.threads import one_thread

COLLINEAR_WITHIN = 1e-3
"""m; targets that are nearer than this to a line lie on it."""
ALONG_AN_AXIS = 0.999
"""Cosine of the angle up to which a line is along a machine axis."""
MAX_MEAN_DISTANCE = 5e-4
"""m; mean distance from the path above which the input is not plausible for a machine tool."""


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
    progress : callable(stage, fraction), optional
        Called as work goes on, stage 'aligning' or 'solving'; what it raises ends the work.
    prepare : callable, optional
        One of ``methods.PREPARATIONS``.

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


@dataclass(frozen=True)
class ExaminedRecordings:
    """Recordings that are examined: solutions, corrections and a diagnosis start here.

    Attributes
    ----------
    runs : list of Run
        Repaired where ``contradictions`` could repair them, with all their pieces.
    nodes : mapping of axis to ndarray, m
        Table nodes.
    findings : tuple of Finding
        Contradictions, and what was repaired, of all runs.
    """

    runs: list[Run]
    nodes: dict[str, Array]
    findings: tuple[Finding, ...]

    @property
    def source(self) -> list[int]:
        """Recording that each run is of, or a part of where it was cut."""
        return [int(k) for k in np.cumsum([run.late == 0.0 for run in self.runs]) - 1]


@dataclass(frozen=True)
class SolvedRecordings(ExaminedRecordings):
    """Recordings that are examined and solved."""

    solution: ReversalSolution[Run]


def solve_recordings(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress = silent,
    prepare: Preparation = prepare_runs,
    *,
    repair: bool = True,
) -> SolvedRecordings:
    """Align, reduce to pieces, examine and solve.

    Parameters
    ----------
    recordings, config, progress, prepare
        As of ``calibrate_runs``.
    repair : bool
        Repair what can be repaired, see ``contradictions.examine``.
    """
    progress('aligning', 0.0)
    check_recordings(recordings)
    pitch = check_table_pitch(recordings[0].machine, config.piece_length)
    runs, nodes = prepare(recordings, config)

    progress('solving', 0.0)
    runs, contradictions = examine(runs, nodes, config, repair=repair)

    solution = solve_with_reversal(runs, nodes, config, progress)

    left_out = [f for pair in zip(runs, solution.runs, strict=True) for f in check_left_out(*pair)]
    repairs = [Finding('recording', WARNING, text) for r in recordings for text in r.remarks]
    if pitch:
        repairs.append(Finding('table_pitch', WARNING, pitch.removeprefix('table_pitch: ')))
    return SolvedRecordings(runs, nodes, (*repairs, *contradictions, *left_out), solution)


def assemble(
    solved: ReversalSolution[Run],
    config: CalibrationConfig,
    findings: Sequence[Finding] = (),
    removed: RemovedEffects | None = None,
) -> CalibrationResult:
    """Work out fit and uncertainties of a solution, tables and verdicts: the result.

    Parameters
    ----------
    findings : sequence of Finding
        Of the examination of its runs.
    removed : RemovedEffects, optional
        Effects that were taken off the runs.
    """
    runs = solved.runs
    assessed = assess(runs, solved.joint, config, removed)
    joint, budget, table, tables = assessed.joint, assessed.budget, assessed.table, assessed.tables
    solution, covariance = joint.solution, budget.covariance
    findings = (*findings, *check_worth(tables, covariance, sample_noise(runs)))
    hidden = tuple(n for n in (*SQUARENESS, *MOTIONS) if n not in solution.accepted)
    stated = with_typical(budget, assessed.typical)
    whole = budget.covariance if assessed.typical is None else stated.covariance
    volume = VolumetricError(tables, whole)
    return CalibrationResult(
        run_id=run_id([r.recording for r in runs], config),
        tables=tables,
        covariance=covariance,
        budget=budget,
        runs=tuple(assessed.results),
        fit=assessed.fit,
        headline=headline_of(volume, stated, assessed.typical),
        reversal=Reversal(
            solved.choice.model,
            solved.choice.evidence,
            reversal_tables(
                tables,
                joint.unknowns,
                solution.value,
                assessed.whole,
                solution.accepted,
            ),
            solved.choice.held,
            backlash_at_target(
                tables,
                joint.unknowns,
                solution.value,
                assessed.whole,
                solution.accepted,
            ),
        ),
        fraction=table.fraction,
        table_costs=table.costs,
        prior=unseen_sizes(tables, solution.accepted),
        not_identifiable=hidden,
        typical=assessed.typical,
        warnings=(
            *typical_warnings(assessed.typical),
            *words_of(findings, WARNING),
            *_warnings(assessed.fit, tables, config.unidentifiable_above),
            *filter(None, [assessed.lack_of_fit]),
            *mixture_warnings([r.machine for r in runs], hidden),
            *(r.alignment.remark for r in runs if r.alignment.remark),
        ),
        failed_gates=(
            *words_of(findings, GATE),
            *_failed_gates(assessed.fit),
        ),
        config=config,
        origin=origins(r.recording for r in runs),
        effects=removed.stated if removed is not None else (),
        machine_verdict=judge(tables, whole, stated, hidden),
    )


@dataclass(frozen=True)
class Assessment:
    """Fit and uncertainty of a solution, with any reversal model.

    Attributes
    ----------
    joint : JointSolution
        With the covariance of all passes.
    budget : Budget
        Of the rows of ``table``.
    whole : ndarray, shape (full, full)
        Covariance of all unknowns.
    tables : ErrorTables
        With their uncertainties.
    lack_of_fit : str, optional
        Words on what the tables leave in every pass over a line, where it matters.
    """

    joint: JointSolution
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
    joint: JointSolution,
    config: CalibrationConfig,
    removed: RemovedEffects | None = None,
) -> Assessment:
    """Work out fit and uncertainty of a solution, with the effects ``removed`` off its runs."""
    as_solved = tables_of(runs[0].machine, joint.unknowns, joint.solution)
    pulls = typical_pulls(runs, joint, lambda some: piece_states(some, joint, as_solved))
    parts = noise_parts(runs, joint)
    joint = settle_covariance(joint, config.unidentifiable_above, parts.normal)
    unknowns, machine = joint.unknowns, runs[0].machine
    results = [_run_result(r, s, config) for r, s in zip(runs, joint.runs, strict=True)]
    fine = tables_of(machine, unknowns, joint.solution)
    states = partial(piece_states, runs, joint, fine)
    budget = make_budget(runs, joint, parts, states, config.standstill_speed)
    if removed is not None:
        budget = with_source(budget, EFFECTS, budget.inflation * removed.of_unknowns)
    fit = _fit(runs, results, joint, budget.inflation)
    grid_u = mean_grid_uncertainty(machine, unknowns, budget.whole)
    table = tabulate(machine, joint, grid_u, config.unidentifiable_above)
    whole, budget = budget.whole, replace(budget, rows=table.rows, straight=table.straight)
    tables = with_uncertainty(table.tables, budget.covariance)
    typical = typical_systematic(
        runs,
        joint,
        tables,
        table.rows,
        budget.covariance,
        pulls,
        partial(driven_rows, tables),
        set(SQUARENESS) - set(joint.solution.accepted),
    )
    lack_of_fit = find_lack_of_fit(runs, joint)
    warning = lack_of_fit.warning(grid_u) if lack_of_fit is not None else None
    return Assessment(joint, results, budget, whole, fit, table, tables, typical, warning)


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
    runs: Sequence[Run], results: Sequence[RunResult], joint: JointSolution, inflation: float
) -> Fit:
    check = whole_check(runs, joint, [s.residual for s in joint.runs])
    before = np.concatenate([_lengths(r.aligned) for r in results])
    after = np.concatenate([_lengths(r.residual) for r in results])
    normalised = np.concatenate([r.normalised for r in results], axis=1)
    return Fit(
        samples=sum(len(r.recording.samples) for r in runs),
        used=sum(r.pieces.used for r in runs),
        outliers=sum(r.pieces.outliers for r in runs),
        pieces=len(after),
        unknowns=joint.solution.unknowns,
        rank=joint.solution.rank,
        coverage=min(r.alignment.coverage for r in runs),
        path_mae_before=float(before.mean()),
        path_mae_after=float(after.mean()),
        residual_rms=float(np.sqrt(np.mean(after**2))),
        residual_ratio=float(np.sqrt(np.mean(normalised**2))),
        variance_ratio=check.variance_ratio,
        correlation_factor=check.correlation_factor,
        inflation=inflation,
        iterations=joint.iterations,
    )


def _failed_gates(fit: Fit) -> tuple[str, ...]:
    failed = failed_gates_of_data(fit.coverage, fit.outliers, fit.samples)
    if fit.path_mae_before > MAX_MEAN_DISTANCE:
        failed.append(
            f'plausibility: the track is {1e3 * fit.path_mae_before:.2f} mm off the path on '
            f'average; check units, scale and the machine description'
        )
    if fit.path_mae_after >= fit.path_mae_before:
        failed.append('compensation: the tables do not reduce the distance from the path')
    return tuple(failed)


def _warnings(fit: Fit, tables: ErrorTables, limit: float) -> list[str]:
    warnings = []
    unsure = [m for m in MOTIONS if tables.motions[m].u.max() > limit]
    if unsure:
        warnings.append(
            f'{", ".join(unsure)}: uncertain by more than {1e6 * limit:g} um or urad, the '
            f'misfit of the model included'
        )
    for name, table in tables.motions.items():
        if table.identifiable and table.node_identifiable is not None:
            loose = table.position[~table.node_identifiable]
            if loose.size:
                where = f'{loose[0]:g}' if loose.size == 1 else f'{loose[0]:g} ... {loose[-1]:g}'
                warnings.append(
                    f'{name}: not determined by the data at {loose.size} nodes ({where} m); '
                    f'continued smoothly'
                )
    if fit.coverage < COMPLETE_PATH:
        warnings.append(f'only {100 * fit.coverage:.1f} % of the path was recorded')
    if fit.residual_ratio > 1.5:
        warnings.append(
            f'residuals of path pieces are {fit.residual_ratio:.1f} times the noise specified for '
            f'single samples: an effect that the rigid-body model does not contain, or more noise'
        )
    return warnings


def mixture_warnings(machines: Sequence[Machine], hidden: Collection[str]) -> list[str]:
    """Name the motions that contain a share of a rotation that two target offsets do not show.

    With the offsets T1 and T2 a rotation r of an axis whose lever arm no other axis changes is a
    translation where r x (T2 - T1) = 0: the turn about the line between both targets is not seen.
    If that line is along a machine axis it is one motion, which is not identifiable; if not, it is
    a mixture of three of which one is taken for zero, and the others take its share.

    Parameters
    ----------
    machines : sequence of Machine
        Of the runs, with their target offsets.
    hidden : collection of str
        Motions that are not identifiable.
    """
    offsets = np.array([machine.target_offset for machine in machines])
    size, lines = np.linalg.svd(offsets - offsets.mean(axis=0))[1:]
    if np.count_nonzero(size > COLLINEAR_WITHIN) != 1 or np.abs(lines[0]).max() > ALONG_AN_AXIS:
        return []
    warnings = []
    for axis in machines[0].axis_names:
        rotations = [m for m in MOTIONS if m.axis == axis and not m.is_translation]
        unseen = [m for m in rotations if m in hidden]
        if len(unseen) != 1 or set(machines[0].chain.lever_axes(axis)) - {axis}:
            continue
        others = ' and '.join(m for m in rotations if m not in unseen)
        warnings.append(
            f'{others} contain a share of {unseen[0]}, which is set to zero: the target offsets '
            f'do not differ along one machine axis, so that a rotation of {axis} about the line '
            f'between them cannot be observed; the translations of {axis} contain the rest of it. '
            f'Predictions at these offsets are right. Take offsets that differ along a machine '
            f'axis, or a third one'
        )
    return warnings
