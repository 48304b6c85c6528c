# SPDX-License-Identifier: Apache-2.0
"""From a solution to the result: uncertainty budget, tables, fit, verdicts.

A solution of any chain gives its rows, unknowns and covariance; what is stated of a calibration is
worked out here, in one way.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import (
    EFFECTS,
    OBSERVED,
    Budget,
    NoiseParts,
    make_budget,
    noise_parts,
    piece_states,
    standstill_freedom,
    whole_check,
    with_source,
)
from otf_core.budget.typical import (
    typical_pulls,
    typical_systematic,
    with_typical,
)
from otf_core.calibration.calibration_result import (
    CalibrationResult,
    RunResult,
    headline_of,
)
from otf_core.calibration.lack_of_fit import find_lack_of_fit
from otf_core.calibration.machine_verdict import judge, measurement_verdict
from otf_core.config import CalibrationConfig
from otf_core.contradictions.table_checks import check_worth, sample_noise
from otf_core.effects import State
from otf_core.effects.removable_effect import RemovedEffects
from otf_core.errors import InputError
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import SPINDLE, TABLE, TOOL, Machine
from otf_core.model.nodes import SAME_PLACE
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
from otf_core.pieces.pieces import Pieces
from otf_core.pieces.runs import Observed, Recording, Run, rigid_pose, run_id
from otf_core.prediction.calibration_document import DrivenPart, Fit, TargetPlace, Verdicts
from otf_core.prediction.volumetric import VolumetricError
from otf_core.solving.joint import (
    JointSolution,
    SolvedRun,
    settle_covariance,
    tables_of,
)
from otf_core.solving.model_choice import ReversalSolution
from otf_core.solving.residuals import ResidualCheck
from otf_core.solving.reversal import (
    AxisLag,
    Choice,
    Reversal,
    backlash_at_target,
    lags,
    reversal_tables,
)
from otf_core.solving.system import deviations
from otf_core.solving.tabulate import mean_grid_uncertainty, tabulate, unseen_sizes
from otf_core.solving.unknowns import place_block
from otf_core.tracking.mismatch import wrong_lines

COLLINEAR_WITHIN = 1e-3
"""m; targets that are nearer than this to a line lie on it."""
ALONG_AN_AXIS = 0.999
"""Cosine of the angle up to which a line is along a machine axis."""
MAX_MEAN_DISTANCE = 5e-4
"""m; mean distance from the path above which the input is not plausible for a machine tool whose
lines of rotary axes are where they are said to be."""
LARGE_RESIDUAL = 1.5
"""Residual of pieces, in specified noise of single samples, that is worth a warning."""


def assemble(
    solved: ReversalSolution[Run],
    config: CalibrationConfig,
    findings: Sequence[Finding] = (),
    removed: RemovedEffects | None = None,
) -> CalibrationResult:
    """Work out budget, tables, fit and verdicts of a solution: the result.

    Parameters
    ----------
    findings : sequence of Finding
        Of the examination of its runs.
    removed : RemovedEffects, optional
        Effects that were taken off the runs.
    """
    limit = config.unidentifiable_above
    recordings = [run.recording for run in solved.runs]
    driven = [_driven_parts(*pair) for pair in zip(solved.runs, solved.joint.runs, strict=True)]
    runs, joint, parts, pulls = _settled(solved, limit)
    states = piece_states(runs, joint, tables_of(joint.machine, joint.unknowns, joint.solution))
    check = whole_check(runs, joint, [s.residual for s in joint.runs])
    budget = _declared_budget(solved, runs, joint, parts, states, check, config, removed)
    # what a machine does not declare changes no table: nodes and gates go by what is stated
    stated = budget.whole
    grid_u = mean_grid_uncertainty(joint.machine, joint.unknowns, stated)
    made = tabulate(joint.machine, joint, grid_u, limit)
    hidden, covariance = made.hidden, made.covariance_of(stated)
    declared = with_uncertainty(made.tables, covariance)
    declares = not set(budget.names) <= set(OBSERVED)
    typical = typical_systematic(runs, joint, pulls)
    budget = replace(with_typical(budget, typical), rows=made.rows, straight=made.straight)
    whole, run = budget.whole, budget.run
    expected, observed = made.covariance_of(whole), made.covariance_of(run)
    tables = with_uncertainty(made.tables, expected, observed)
    results = _run_results(solved, runs, driven, states, config)
    fit = _fit(recordings, joint, results, check, budget.inflation)
    findings = (*findings, *_findings_of_tables(declared, covariance, runs))
    machines = [r.machine for r in recordings]
    warnings = (
        *([typical.warning] if typical else []),
        *words_of(findings, WARNING),
        *_warnings(fit, declared, limit),
        *_lack_of_fit(runs, joint, grid_u),
        *mixture_warnings(machines, hidden),
    )
    gates = (*words_of(findings, GATE), *_failed_gates(fit, tables))
    return CalibrationResult(
        run_id=run_id(recordings, config),
        tables=tables,
        covariance=expected,
        covariance_run=observed,
        covariance_change=covariance if declares else None,
        budget=budget,
        runs=tuple(results),
        targets=_targets(driven, joint, whole, run),
        fit=fit,
        headline=headline_of(VolumetricError(tables, expected), budget, typical),
        reversal=_reversal(solved.choice, tables, joint, whole, run),
        lags=_lags(joint, whole, run),
        fraction=made.fraction,
        table_costs=made.costs,
        prior=unseen_sizes(tables, [n for n in tables.machine.motions if n not in hidden]),
        not_identifiable=hidden,
        advice=advice_for(machines, driven, hidden),
        typical=typical,
        warnings=warnings,
        failed_gates=gates,
        verdicts=Verdicts(measurement_verdict(gates), judge(tables, expected, budget, hidden)),
        config=config,
        origin=origins(recordings),
        effects=removed.stated if removed is not None else (),
    )


def _declared_budget(
    solved: ReversalSolution[Run],
    runs: Sequence[Observed],
    joint: JointSolution,
    parts: NoiseParts,
    states: Sequence[State],
    check: ResidualCheck,
    config: CalibrationConfig,
    removed: RemovedEffects | None,
) -> Budget:
    """The budget without typical values."""
    samples = [run.recording.samples for run in solved.runs]
    still = standstill_freedom(samples, runs, solved.runs[0].speed_at_rest(config))
    budget = make_budget(runs, joint, parts, states, still, check)
    if removed is None:
        return budget
    return with_source(budget, EFFECTS, budget.inflation * removed.of_unknowns)


def _findings_of_tables(
    tables: ErrorTables, covariance: Array, runs: Sequence[Observed]
) -> list[Finding]:
    """What the tables contradict: lines of rotary axes elsewhere, errors below their u."""
    lines = {name: (v.value, v.identifiable) for name, v in tables.location.items()}
    wrong = wrong_lines(lines, tables.machine)
    return [
        *(Finding('machine.yaml', GATE, words) for words in wrong),
        *check_worth(tables, covariance, sample_noise(runs)),
    ]


def _driven_parts(run: Run, solved: SolvedRun) -> list[DrivenPart]:
    """Parts of a run, those that were not recorded last."""
    parts = []
    for number, one in enumerate(run.alignment.parts):
        target, q = one.path.target, solved.system.q[solved.run.pieces.part == number]
        met = {joint.name for joint in run.sight(target).joints}
        moves = np.ptp(q, axis=0) > SAME_PLACE if len(q) else np.zeros(q.shape[1], dtype=bool)
        pairs = zip(run.machine.axis_names, moves.tolist(), strict=True)
        moved = tuple(axis for axis, own in pairs if own and axis in met)
        parts.append(DrivenPart(target, len(one.path.positions), one.driven, moved))
    missing = [DrivenPart(p.target, len(p.positions), 0.0, ()) for p in run.alignment.missing]
    return parts + missing


def _settled(
    solved: ReversalSolution[Run], limit: float
) -> tuple[list[Observed], JointSolution, NoiseParts, Array]:
    """Runs, their solution with its covariance, parts of the noise, pulls of typical values."""
    joint = solved.joint
    pairs = zip(joint.runs, solved.runs, strict=True)
    runs = [replace(one.run, machine=run.recording.machine) for one, run in pairs]
    tables = tables_of(joint.machine, joint.unknowns, joint.solution)
    pulls = typical_pulls(runs, joint, lambda some: piece_states(some, joint, tables))
    parts = noise_parts(runs, joint)
    return runs, settle_covariance(joint, limit, parts.normal), parts, pulls


def _reversal(
    choice: Choice, tables: ErrorTables, joint: JointSolution, whole: Array, run: Array
) -> Reversal:
    start, accepted = (tables, joint.unknowns, joint.solution.value), joint.solution.accepted
    motions, motions_run = (reversal_tables(*start, c, accepted) for c in (whole, run))
    backlash, backlash_run = (backlash_at_target(*start, c, accepted) for c in (whole, run))
    return Reversal(
        choice.model,
        choice.evidence,
        {n: replace(own, u_run=motions_run[n].u) for n, own in motions.items()},
        choice.held,
        {a: replace(own, u_run=backlash_run[a].u) for a, own in backlash.items()},
    )


def _lags(joint: JointSolution, whole: Array, run: Array) -> tuple[AxisLag, ...]:
    pairs = zip(lags(joint, whole), lags(joint, run), strict=True)
    return tuple(replace(own, u_run=of_run.u) for own, of_run in pairs)


def _targets(
    driven: Sequence[Sequence[DrivenPart]], joint: JointSolution, whole: Array, run: Array
) -> dict[str, TargetPlace]:
    """Places of the reflectors that were seen; none where there is a known one alone."""
    machine, places = joint.machine, {}
    for name in sorted({part.target for own in driven for part in own}):
        block = joint.unknowns.blocks.get(place_block(name))
        u, u_run = (
            np.zeros(3) if block is None else np.sqrt(np.maximum(np.diag(c[block, block]), 0.0))
            for c in (whole, run)
        )
        known = np.array(machine.targets[name].place)
        place = np.asarray(joint.places.get(name, known))
        places[name] = TargetPlace(machine.targets[name].link, place, u, u_run)
    return {} if set(places) == {TOOL} and not places[TOOL].u.any() else places


def _run_results(
    solved: ReversalSolution[Run],
    runs: Sequence[Observed],
    driven: Sequence[Sequence[DrivenPart]],
    states: Sequence[State],
    config: CalibrationConfig,
) -> list[RunResult]:
    own = zip(solved.runs, runs, solved.joint.runs, driven, states, strict=True)
    return [
        RunResult(
            name=Path(whole.name).name,
            target_offset=whole.machine.target_offset,
            samples=len(whole.samples),
            remarks=whole.recording.remarks,
            rate=1.0 / whole.samples.step,
            lost=lost_samples(whole.samples),
            T_machine_tracker=one.pose,
            noise=run.noise_and_misfit[0],
            misfit=run.noise_and_misfit[1],
            parts=tuple(parts),
            coverage=whole.alignment.coverage,
            pieces=run.pieces,
            part=run.pieces.part,
            q=one.system.q,
            speed=state.speed,
            axes=one.system.axes,
            aligned=_rigidly_aligned(run.pieces, one.pose, config),
            deviation=one.system.deviation,
            residual=one.residual,
        )
        for whole, run, one, parts, state in own
    ]


def _rigidly_aligned(pieces: Pieces, pose: RigidTransform, config: CalibrationConfig) -> Array:
    """Deviations (c, p), m, after a rigid fit to the path, or as solved where none is defined."""
    with suppress(InputError):
        pose = rigid_pose(pieces, pose, config)
    return deviations(pieces, pose)


def _fit(
    recordings: Sequence[Recording],
    joint: JointSolution,
    results: Sequence[RunResult],
    check: ResidualCheck,
    inflation: float,
) -> Fit:
    before, after = (
        np.concatenate([np.linalg.norm(getattr(r, what), axis=0) for r in results])
        for what in ('aligned', 'residual')
    )
    ratios = []
    for recording, one in zip(recordings, joint.runs, strict=True):
        noise = NoiseModel.from_spec(recording.machine.tracker)
        ratios.append(one.residual**2 / sample_variance(noise, one.system.shares))
    return Fit(
        samples=sum(len(r.samples) for r in recordings),
        used=sum(r.pieces.used for r in results),
        outliers=sum(r.pieces.outliers for r in results),
        pieces=len(after),
        unknowns=joint.solution.unknowns,
        rank=joint.solution.rank,
        coverage=min(r.coverage for r in results),
        path_mae_before=float(before.mean()),
        path_mae_after=float(after.mean()),
        residual_rms=float(np.sqrt(np.mean(after**2))),
        residual_ratio=float(np.sqrt(np.mean(np.concatenate(ratios, axis=1)))),
        variance_ratio=check.variance_ratio,
        correlation_factor=check.correlation_factor,
        inflation=inflation,
        iterations=joint.iterations,
    )


def _failed_gates(fit: Fit, tables: ErrorTables) -> tuple[str, ...]:
    failed = failed_gates_of_data(fit.coverage, fit.outliers, fit.samples)
    if fit.path_mae_before > MAX_MEAN_DISTANCE and not tables.location:
        failed.append(
            f'plausibility: the track is {1e3 * fit.path_mae_before:.2f} mm off the path on '
            f'average; check units, scale and the machine description'
        )
    if fit.path_mae_after >= fit.path_mae_before:
        failed.append('compensation: the tables do not reduce the distance from the path')
    return tuple(failed)


def _lack_of_fit(runs: Sequence[Observed], joint: JointSolution, grid_u: float) -> list[str]:
    found = find_lack_of_fit(runs, joint)
    return [*filter(None, [found.warning(grid_u) if found else None])]


def _warnings(fit: Fit, tables: ErrorTables, limit: float) -> list[str]:
    warnings = []
    shown = {n: t for n, t in tables.motions.items() if t.identifiable}
    unsure = [name for name, table in shown.items() if table.u.max() > limit]
    if unsure:
        warnings.append(
            f'{", ".join(unsure)}: uncertain by more than {1e6 * limit:g} um or urad, the '
            f'misfit of the model included'
        )
    for name, table in shown.items():
        loose = table.position[~table.nodes_seen]
        if loose.size:
            where = f'{loose[0]:g}' if loose.size == 1 else f'{loose[0]:g} ... {loose[-1]:g}'
            unit = tables.machine.axes[name[2]].unit
            warnings.append(
                f'{name}: not determined by the data at {loose.size} nodes ({where} {unit}); '
                f'continued smoothly'
            )
    if fit.coverage < COMPLETE_PATH:
        warnings.append(f'only {100 * fit.coverage:.1f} % of the path was recorded')
    if fit.residual_ratio > LARGE_RESIDUAL:
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
        rotations = [m for m in machines[0].motions if m.axis == axis and not m.is_translation]
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


def advice_for(
    machines: Sequence[Machine], parts: Sequence[Sequence[DrivenPart]], hidden: Collection[str]
) -> dict[str, str]:
    """State for every error that the data do not show which path would show it.

    Parameters
    ----------
    machines, parts : sequence
        Of every run.
    """
    machine, advice = machines[0], dict[str, str]()
    every = [
        (one.targets[p.target], p) for one, own in zip(machines, parts, strict=True) for p in own
    ]
    moving = {axis for _, p in every for axis in p.moved}
    tools = {tuple(np.round(t.place, 6)) for t, _ in every if t.link == SPINDLE}
    nests = {p.target for t, p in every if t.link == TABLE}
    for name in hidden:
        axis = name[-1]
        if axis not in moving:
            advice[name] = f'a part in which {axis} moves a reflector in view of the tracker'
        elif axis in machine.rotary_names:
            advice[name] = _rotary_advice(machine, name, axis, nests, len(parts))
        elif len(tools) < 2 and name[1] in 'ABC':
            advice[name] = 'a second reflector place on the tool side (another length or off axis)'
        else:
            advice[name] = (
                'a reflector off the spindle axis: it acts only as a turn about that axis'
                if name[1] in 'ABC'
                else f'longer lines of {axis}, together with the other axes'
            )
    return advice


def _rotary_advice(machine: Machine, name: str, axis: str, nests: set[str], runs: int) -> str:
    others = [a for a in machine.rotary_names if a != axis]
    if name[1] == axis or name[1] == '0':
        combined = (
            f'{axis} and {others[0]} together' if others else f'{axis} together with a linear axis'
        )
        words = (
            f'legs that drive {combined} in both senses, a path in which the linear axes follow '
            f'the rotation and creep (TCP), or stops (--method standstill)'
        )
        if name[1] == '0' and runs > 1:
            words += '; one place of the tracker for all parts (one bag, or --same-station)'
        return words
    if 0 < len(nests) < 3:
        return 'three places of the reflector on the table, not in line with the axis'
    return f'legs of {axis} with the reflector at other radii and heights'
