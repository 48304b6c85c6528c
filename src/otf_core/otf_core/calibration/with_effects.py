# SPDX-License-Identifier: Apache-2.0
"""Calibration with effects removed: their displacement subtracted, their uncertainty propagated.

With c the columns of the coefficients theta of effects, jointly with tables and poses,

    theta = theta_0 + M^-1 (c^T W e - P (theta_0 - theta_p)),  M = c^T W c - c^T W A C A^T W c + P

e the residual of the solution of the data less c theta_0, C its covariance, theta_p and P mean and
precision of the prior of theta. The joint estimate of the tables is the solution of the data less
c theta; its covariance is C + S M^-1 S^T, S = C A^T W c. What an effect is not linear in (a time
constant, a period) is linearised about its last value, in its logarithm. Noise and misfit are
fitted to the corrected residuals: otherwise they would include the effect.

Reversal is left to the calibration's own choice (``model_choice``) unless the configuration states
'none': backlash and direction-dependent tables that a diagnosis finds are not removed twice. A
file that names one of them switches that choice off. Nodes too far apart are not removed: the
tables follow finer instead. Each effect states which it is (``belongs_to``).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import linalg

from otf_core.arrays import Array
from otf_core.calibration.assembly import assemble
from otf_core.calibration.calibrate import ExaminedRecordings, solve_recordings
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import CalibrationConfig
from otf_core.effects import AppliedEffect, BelongsTo, Shape, State
from otf_core.effects.effects_yaml import read_effects
from otf_core.effects.removable_effect import (
    FILE,
    RemovableEffect,
    RemovedEffects,
    removable_effect,
)
from otf_core.effects.state import probe_state
from otf_core.errors import ConfigError
from otf_core.live.stages import Progress, silent
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Recording, Run, located_tables
from otf_core.prediction.calibration_document import StatedEffect
from otf_core.solving.joint import (
    PARTS_PER_INTERVAL,
    JointSolution,
    Start,
    solve_robustly,
    tables_of,
)
from otf_core.solving.model_choice import ReversalSolution, solve_with_reversal
from otf_core.solving.residuals import sample_state
from otf_core.solving.sensitivity import (
    ROUNDING,
    Places,
    beside_tables,
    column_size,
    components_across,
    name_in_run,
    piece_state,
    state_at,
)
from otf_core.solving.solution import Positive
from otf_core.solving.system import positions_on_path
from otf_core.threads import limit_to_one_thread

MAX_ROUNDS = 6
MAX_CHOICES = 3
"""Rounds that choose functions and reversal anew; two models may follow each other for ever."""
MAX_FINAL_CHANGE = 2e-8
"""m; change of the displacement by an effect below which its coefficients count as settled."""
MAX_CHANGE_FOR_SAME_MODEL = 1e-6
"""m; a larger change can alter which functions and which reversal the data call for."""


@dataclass(frozen=True)
class Estimates:
    """Effects with the parameters that the data give them.

    Attributes
    ----------
    covariance : ndarray, shape (k, k)
        Of all parameters, effect by effect: coefficients run by run, then shape in logarithms.
    change : ndarray, shape (full, k)
        S: what a unit of each does to the unknowns of the calibration.
    """

    effects: tuple[RemovableEffect, ...]
    covariance: Array
    change: Array

    def taken_off(self, solved: ReversalSolution[Run]) -> RemovedEffects:
        """State effects and what the unknowns of a solution are uncertain by for them."""
        machine = solved.runs[0].machine
        ends = np.cumsum([e.size for e in self.effects])
        u = np.split(np.sqrt(np.diag(self.covariance)), ends[:-1])
        stated = tuple(
            _stated_effects(e, part, machine) for e, part in zip(self.effects, u, strict=True)
        )
        covariance = self.change @ self.covariance @ self.change.T
        return RemovedEffects(stated, covariance + missing_in_tables(solved, self.effects))


@dataclass(frozen=True)
class CorrectedCalibration:
    """A calibration with effects taken off.

    Attributes
    ----------
    parameters : tuple of tuple of mapping
        Of the effects as they were estimated, run by run.
    """

    result: CalibrationResult
    parameters: tuple[tuple[Shape, ...], ...]


def _stated_effects(one: RemovableEffect, u: Array, machine: Machine) -> StatedEffect:
    units = one.effect.units(probe_state(machine), one.applied(0).parameters)
    parameters, uncertain = dict(one.shape), {}
    for name, relative in zip(one.widths, u[one.values.size :], strict=True):
        uncertain[name] = float(relative * one.shape[name])
    places = np.ndindex(*one.values.shape)
    for (run, k), value, own in zip(places, one.values.ravel(), u, strict=False):
        name = name_in_run(one.names[k], run)
        parameters[name], uncertain[name] = float(value), float(own)
        units[name] = units[one.names[k]]
    return StatedEffect(one.effect.name, parameters, uncertain, units, one.how)


def missing_in_tables(solved: ReversalSolution[Run], effects: Sequence[RemovableEffect]) -> Array:
    """What the tables lack of effects that stay at their place, covariance, (full, full).

    Such an effect displaces the target in the same way whenever it comes by, but no table holds
    it. Its mean square along X, Y and Z is stated as uncertain positioning of that axis.
    """
    joint, machine = solved.joint, solved.runs[0].machine
    variance = np.zeros(joint.unknowns.full)
    tables = tables_of(machine, joint.unknowns, joint.solution)
    staying = [one for one in effects if one.effect.stays_in_place]
    for one in staying:
        parts = []
        for number, (run, at) in enumerate(zip(solved.runs, joint.runs, strict=True)):
            state = piece_state(run, at, joint.unknowns.knots, tables)
            parts.append(one.displacement(state, number))
        square = np.mean(np.concatenate(parts) ** 2, axis=0)
        for k, axis in enumerate(AXES):
            if axis not in machine.axes:
                continue
            basis = joint.unknowns.bases[axis]
            share = float(
                np.mean(np.sum(basis.matrix(basis.finer(PARTS_PER_INTERVAL)) ** 2, axis=1))
            )
            variance[joint.unknowns.blocks[f'E{axis}{axis}']] += square[k] / share
    return np.diag(variance)


def _places(run: Run, state: State, effects: Sequence[RemovableEffect]) -> Places:
    """Where the pieces of one run lie, and the samples that effects ask for."""
    samples = None
    bends = any(e.effect.changes_within_pieces for e in effects)
    if bends and run.shape is not None and len(run.pieces.samples):
        samples = sample_state(run, run.pose, state.tables, dict(state.nodes))
    return Places(run.pieces, state, samples)


def correct_runs(
    runs: Sequence[Run],
    effects: Sequence[RemovableEffect],
    nodes: dict[str, Array],
    tables: ErrorTables | None,
) -> list[Run]:
    """Runs with the displacement by effects taken off their pieces.

    Parameters
    ----------
    runs : sequence of Run
        Their poses good to the errors sought.
    nodes : mapping of axis to ndarray, m
    tables : ErrorTables, optional
        For the place along the path, as far as they are known.
    """
    corrected_runs = []
    for number, run in enumerate(runs):
        points, q = run.pose.apply(run.pieces.xyz), np.empty_like(run.pieces.q)
        for name, own in run.by_target().items():
            some = run.pieces.without(~own)
            q[own] = positions_on_path(run.sight(name), some, points[own], tables)
        places = _places(run, state_at(run, q, run.pose, nodes, tables), effects)
        moves = (places.columns(e.effect, partial(e.displacement, run=number), 1) for e in effects)
        shift = sum(moves, start=np.zeros((len(run.pieces), 3)))
        xyz = run.pieces.xyz - shift @ run.pose.rotation
        corrected_runs.append(replace(run, pieces=replace(run.pieces, xyz=xyz)))
    return corrected_runs


def estimates(
    runs: Sequence[Run], joint: JointSolution, effects: Sequence[RemovableEffect]
) -> tuple[Estimates, Array, Array]:
    """Estimate the parameters of effects anew, jointly with tables and poses.

    Parameters
    ----------
    runs : sequence of Run
        Corrected by the effects as they are, as solved.
    joint : JointSolution
        Of these runs.

    Returns
    -------
    estimates : Estimates
        With the parameters moved.
    step : ndarray, shape (k,)
        Change of all parameters.
    size : ndarray, shape (k,), m
        Displacement per unit of each where it acts.
    """
    tables = tables_of(runs[0].machine, joint.unknowns, joint.solution)
    bounds = np.cumsum([0, *(e.size for e in effects)])
    columns, places = [], []
    for number, (run, solved) in enumerate(zip(runs, joint.runs, strict=True)):
        acting = [e.acting(number) for e in effects]
        places.append(np.concatenate([a + own for a, own in zip(bounds, acting, strict=False)]))
        columns.append(np.empty((*solved.system.deviation.shape, len(places[-1]))))
        state = piece_state(run, solved, joint.unknowns.knots, tables)
        at, end = _places(replace(run, pose=solved.pose), state, effects), 0
        for e, own in zip(effects, acting, strict=True):
            moves = at.columns(e.effect, partial(e.columns, run=number), len(own))
            start, end = end, end + len(own)
            columns[-1][..., start:end] = components_across(solved, moves)
    products = beside_tables(joint, columns, places, bounds[-1])
    size = column_size(*(c.reshape(-1, c.shape[2]) for c in columns), places=places)
    prior = np.concatenate([
        e.precision(size[a:b]) for e, a, b in zip(effects, bounds[:-1], bounds[1:], strict=True)
    ])  # fmt: skip
    covariance = _covariance(products.normal, products.square, prior)
    step = covariance @ (products.right - prior * np.concatenate([e.away() for e in effects]))
    moved = tuple(
        e.moved(step[a:b]) for e, a, b in zip(effects, bounds[:-1], bounds[1:], strict=True)
    )
    return Estimates(moved, covariance, products.change), step, size


def _covariance(matrix: Array, own: Array, prior: Array) -> Array:
    """Inverse of what columns are known by, with their prior, shape (k, k).

    Parameters
    ----------
    matrix : ndarray, shape (k, k)
        Products of what tables leave of the columns: a difference of large numbers.
    own : ndarray, shape (k,)
        Squares of the whole columns.
    prior : ndarray, shape (k,)
        Precision known before.
    """
    scale = 1.0 / np.sqrt(np.maximum(own + prior, np.finfo(float).tiny))
    unit = scale[:, None] * matrix * scale
    value, vectors = linalg.eigh(0.5 * (unit + unit.T))
    # none can be negative: the lowest shows how far rounding goes
    floor = max(ROUNDING, -float(value[0]))
    known = (vectors * np.maximum(value, 0.0)) @ vectors.T + np.diag(scale**2 * prior + floor)
    return np.asarray(scale[:, None] * Positive(known).inverse * scale)


def solve_with_effects(
    runs: Sequence[Run],
    nodes: dict[str, Array],
    effects: Sequence[RemovableEffect],
    config: CalibrationConfig,
    progress: Progress,
) -> tuple[ReversalSolution[Run], Estimates]:
    """Solve with effects taken off and their parameters estimated with the rest.

    Parameters
    ----------
    runs : sequence of Run
        As prepared.
    nodes : mapping of axis to ndarray, m
    progress : callable(stage, fraction)

    Returns
    -------
    solved : ReversalSolution
        Of the corrected runs.
    """
    now, whole, machine = tuple(effects), list(runs), runs[0].machine
    location = runs[0].alignment.location
    first = located_tables(machine, nodes, location) if location else None
    solved = solve_with_reversal(
        correct_runs(whole, now, nodes, first), nodes, config, progress, first
    ).without_plain()
    for k in range(MAX_ROUNDS):
        fitted, step, size = estimates(solved.runs, solved.joint, now)
        now, largest = fitted.effects, float(np.max(np.abs(step) * size, initial=0.0))
        if largest < MAX_FINAL_CHANGE:
            break
        tables = tables_of(machine, solved.joint.unknowns, solved.joint.solution)
        whole = [
            replace(r, pose=s.pose, places=s.run.places, fitted=c.fitted)
            for r, s, c in zip(runs, solved.joint.runs, solved.runs, strict=True)
        ]
        clean = correct_runs(whole, now, solved.joint.unknowns.knots, tables)
        start = Start.after(clean[0].machine, solved.joint)
        unknowns, choice = solved.joint.unknowns, solved.choice
        del solved  # as large as the next
        if k < MAX_CHOICES and largest > MAX_CHANGE_FOR_SAME_MODEL:
            solved = solve_with_reversal(clean, nodes, config, progress, first).without_plain()
            continue
        again = solve_robustly(clean, unknowns, config, progress, start)
        solved = ReversalSolution(*again, choice, clean, again)
    return solved, fitted


def calibrate_without_effects(
    examined: ExaminedRecordings,
    effects: Sequence[RemovableEffect],
    config: CalibrationConfig,
    progress: Progress = silent,
) -> CorrectedCalibration:
    """Calibrate on the fly with effects taken off and their parameters estimated.

    Parameters
    ----------
    effects : sequence of RemovableEffect
        At least one.
    progress : callable(stage, fraction), optional
    """
    solved, fitted = solve_with_effects(examined.runs, examined.nodes, effects, config, progress)
    result = assemble(solved, config, examined.findings, fitted.taken_off(solved))
    stated = json.dumps([one.to_dict() for one in result.effects], sort_keys=True)
    run_id = hashlib.sha256((result.run_id + stated).encode()).hexdigest()
    result = replace(result, run_id=run_id[: len(result.run_id)])
    runs = range(len(examined.runs))
    parameters = tuple(tuple(e.applied(k).parameters for e in fitted.effects) for k in runs)
    return CorrectedCalibration(result, parameters)


def pair_with_plain(
    plain: CalibrationResult,
    corrected: CorrectedCalibration | None,
    taking: Sequence[RemovableEffect],
    words: str,
    warnings: Sequence[str] = (),
) -> CalibrationResult:
    """Put a calibration with effects taken off beside the one without.

    Parameters
    ----------
    corrected : CorrectedCalibration, optional
        See ``calibrate_without_effects``; None where nothing was taken off.
    taking : sequence of RemovableEffect
        Effects that were taken off.
    words : str
        What was done, in a sentence.
    warnings : sequence of str
        Put before those of the result.
    """
    if corrected is None:
        return replace(plain, warnings=(*warnings, *plain.warnings), effects_sentence=words)
    result = corrected.result
    of_plain = (f'of the plain calibration: {gate}' for gate in plain.failed_gates)
    applied = tuple(
        tuple(AppliedEffect(one.effect, own) for one, own in zip(taking, run, strict=True))
        for run in corrected.parameters
    )
    return replace(
        result,
        warnings=(*warnings, *of_plain, *result.warnings),
        effects_sentence=words,
        applied=applied,
        uncorrected=plain,
    )


@limit_to_one_thread
def calibrate_with_file(
    recordings: Sequence[Recording],
    file: str,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
    *,
    same_station: bool = False,
) -> CalibrationResult:
    """Calibrate on the fly with the effects of a file taken off.

    Parameters
    ----------
    recordings : sequence of Recording
        Runs of one machine.
    file : str
        An effects.yaml, whose coefficients are estimated anew where the data see them and whose
        shapes (time constant, period) are held.
    progress : callable(stage, fraction), optional
    same_station : bool
        The tracker was not moved between the recordings.

    Raises
    ------
    ConfigError
        If the file names what cannot be taken off.
    InputError
        As ``calibrate_recordings``.
    """
    config = config or CalibrationConfig()
    progress = progress or silent
    named = _named(file, recordings)
    solved = solve_recordings(recordings, config, progress, same_station=same_station)
    taking = [removable_effect([one] * len(solved.runs), FILE) for one in named]
    own = config
    if any(one.effect.belongs_to is BelongsTo.REVERSAL for one in taking):
        own = replace(config, reversal='none')
    words = f'Effects of {file} removed: {effect_names(taking)}.'
    plain = assemble(solved.solution, config, solved.findings)
    corrected = calibrate_without_effects(solved, taking, own, progress)
    return pair_with_plain(plain, corrected, taking, words)


def _named(file: str, recordings: Sequence[Recording]) -> list[AppliedEffect]:
    """Effects of a file that can be removed; ConfigError states why one cannot."""
    stated = read_effects(file, recordings[0].machine)
    for one in stated:
        if one.effect.belongs_to is BelongsTo.NOISE:
            raise ConfigError(
                f'{file}: {one.effect.name}: noise is not a displacement that could be removed; '
                f'every calibration determines its size from the data; leave it out of the file'
            )
        if one.effect.belongs_to is BelongsTo.TABLES:
            raise ConfigError(
                f'{file}: {one.effect.name}: belongs to the tables and is not removed; the '
                f'tables follow the data as finely as needed; leave it out of the file'
            )
    if not stated:
        raise ConfigError(f'{file}: names no effect; leave --effects out for plain tables')
    return list(stated)


def effect_names(taking: Sequence[RemovableEffect]) -> str:
    """Names of the effects, each once."""
    return ', '.join(dict.fromkeys(one.effect.name for one in taking))
