# SPDX-License-Identifier: Apache-2.0
"""From recordings of a machine with rotary axes to error tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import Budget
from otf_core.budget.typical import TypicalSystematic, typical_warnings, with_typical
from otf_core.calibration.axis_budget import budget_of_axes, observed_parts, typical_of_axes
from otf_core.calibration.calibration_result import Headline, expanded_of, headline_of
from otf_core.config import OTF, STANDSTILL, CalibrationConfig
from otf_core.errors import InputError
from otf_core.live.stages import Progress
from otf_core.model.axis_path import driven_length
from otf_core.model.frames import RigidTransform
from otf_core.model.joints import Sight
from otf_core.model.kinematics import displacement
from otf_core.model.machine import SPINDLE, TABLE, TOOL, Machine
from otf_core.model.nodes import table_nodes
from otf_core.model.provenance import Origin, origins
from otf_core.model.tables import ErrorTables, LocationError, MotionTable, Squareness
from otf_core.model.volume import VolumeErrors
from otf_core.noise.noise_model import NoiseModel
from otf_core.noise.standstill import noise_model, standstill_noise
from otf_core.pieces.finding import failed_gates_of_data
from otf_core.pieces.runs import Recording, check_same_machine, errors_of, run_id
from otf_core.prediction.uncertainty import prediction_uncertainty
from otf_core.prediction.volumetric import AxesVolumetricError
from otf_core.rotary.axis_reversal import AxisLag, choose_reversal, lags
from otf_core.rotary.axis_solution import (
    AxisSolution,
    UnsettledError,
    choose_functions,
    solve_jointly,
    solve_robustly,
    tables_of,
)
from otf_core.rotary.axis_unknowns import layout, linear_bases, place_block, smooth_bases
from otf_core.rotary.curve_matching import MatchedRun, match
from otf_core.rotary.mismatch import check_matched, wrong_lines
from otf_core.rotary.part_steps import LEAST, find_steps
from otf_core.rotary.reduction import at_stops, reduce_to_pieces, reduce_to_stops
from otf_core.rotary.rows import AxisRun
from otf_core.rotary.tabulation import AxisTables, tabulate
from otf_core.solving.model_choice import FINER, SMOOTH, STRAIGHT, Choice
from otf_core.solving.reversal import Reversal, reversal_tables
from otf_core.solving.unknowns import Basis, Unknowns
from otf_core.threads import one_thread

FIRST_REPETITIONS = 2
"""Of the solution that positions on the curves, functions and reversal are taken from."""


@dataclass(frozen=True)
class AxisFit:
    """Size and quality of a fit; see ``calibration_result.Fit``."""

    samples: int
    used: int
    outliers: int
    pieces: int
    unknowns: int
    rank: int
    coverage: float
    path_mae_before: float
    path_mae_after: float
    residual_rms: float
    variance_ratio: float
    inflation: float
    iterations: int


@dataclass(frozen=True)
class AxisCalibration:
    """What a calibration of a machine with rotary axes found.

    Attributes
    ----------
    budget : Budget
        Uncertainty by source, of the nodes of the tables.
    typical : TypicalSystematic, optional
        What typical systematic contributions would add; None if all are declared.
    matched : tuple of MatchedRun
        Of every recording.
    targets : mapping of target to (ndarray, ndarray), each of shape (3,), m
        Place and its standard uncertainty, of those that were seen.
    driven : tuple of ndarray, shape (k,)
        Lowest and highest positions of the axes.
    corners : ndarray, shape (n, 3), m
        Linear axes where pieces lie, for the hull of what was driven.
    reversal : Reversal
        Of the motions that differ between both senses of travel; the tables hold the mean.
    lags : tuple of AxisLag
        Axes that are late behind the others.
    advice : mapping of name to str
        What would show an error that the data do not show.
    """

    run_id: str
    machine: Machine
    made: AxisTables
    budget: Budget
    typical: TypicalSystematic | None
    solution: AxisSolution
    matched: tuple[MatchedRun, ...]
    targets: Mapping[str, tuple[Array, Array]]
    driven: tuple[Array, Array]
    corners: Array
    fit: AxisFit
    warnings: tuple[str, ...]
    failed_gates: tuple[str, ...]
    reversal: Reversal
    lags: tuple[AxisLag, ...]
    advice: Mapping[str, str]
    method: str
    config: CalibrationConfig
    origin: tuple[Origin, ...]

    @property
    def tables(self) -> ErrorTables:
        """Error tables with their standard uncertainties."""
        return self.made.tables

    @cached_property
    def budget_with_typical(self) -> Budget:
        """The budget with typical values where nothing is declared."""
        return with_typical(self.budget, self.typical)

    @cached_property
    def covariance_with_typical(self) -> Array:
        """Covariance of squareness and location errors and nodes with them, (m, m)."""
        if self.typical is None:
            return self.made.covariance
        change = self.made.rows @ self.typical.change
        return np.asarray(self.made.covariance + change @ change.T)

    @cached_property
    def volume(self) -> AxesVolumetricError:
        """Errors over the driven ranges, with the uncertainty of the headline."""
        return AxesVolumetricError(self.tables, self.covariance_with_typical)

    @cached_property
    def headline(self) -> Headline:
        """What is stated first: volumetric error and its expanded uncertainty."""
        return headline_of(self.volume, self.budget_with_typical, self.typical)

    @cached_property
    def expanded(self) -> dict[str, Array]:
        """Expanded uncertainty of scalars (1,) and nodes (k,), m and rad, typical ones included.

        Zero where a value is not identifiable.
        """
        covariance, budget = self.covariance_with_typical, self.budget_with_typical
        return expanded_of(self.tables, covariance, budget, self.made.hidden)

    @property
    def needs(self) -> list[str]:
        """What would show the errors that the data do not show, one line for those of one need."""
        by_need: dict[str, list[str]] = {}
        for name, need in self.advice.items():
            by_need.setdefault(need, []).append(name)
        return [f'{", ".join(names)}: needs {need}' for need, names in by_need.items()]


def calibrate_axes(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress,
    method: str = OTF,
    *,
    same_station: bool = False,
) -> AxisCalibration:
    """Calibrate.

    Parameters
    ----------
    recordings : sequence of Recording
        Of one machine with rotary axes.
    progress : callable(stage, fraction)
    method : str
        'otf', or 'standstill': only the stops at the corners.
    same_station : bool
        The tracker was not moved between the recordings.

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.
    """
    with one_thread():
        return _calibrated(recordings, config, progress, method, same_station)


def _calibrated(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress,
    method: str,
    same_station: bool,
) -> AxisCalibration:
    check_same_machine(recordings)
    machine = recordings[0].machine
    matched, notes = _match_all(recordings, progress, same_station)
    low, high = driven_ranges(machine, matched)
    nodes = table_nodes(machine, low, high)
    places = common_places(machine, matched)
    stations = [0 if same_station else k for k in range(len(recordings))]
    seen = {p.path.target for m in matched for p in m.parts}
    free = tuple(n for n, t in machine.targets.items() if n in seen and t.u > 0.0)
    progress('solving', 0.0)
    job = _Job(recordings, config, progress, method, nodes, tuple(stations), free)
    failed: list[str] = []
    joint, matched, choice, before = job.solve(matched, places, failed)
    result = _assembled(recordings, matched, joint, choice, config, method, (low, high), before)
    gates = (*failed, *result.failed_gates)
    return replace(result, warnings=(*notes, *result.warnings), failed_gates=gates)


@dataclass(frozen=True)
class _Job:
    """What is the same in every step of a solution.

    Attributes
    ----------
    recordings, config, progress, method
        See ``calibrate_axes``.
    nodes : mapping of axis to ndarray, m and rad
    stations : tuple of int
        Place of the tracker of every recording.
    free : tuple of str
        Targets whose places are not known.
    """

    recordings: Sequence[Recording]
    config: CalibrationConfig
    progress: Progress
    method: str
    nodes: Mapping[str, Array]
    stations: tuple[int, ...]
    free: tuple[str, ...]

    def solve(
        self, matched: Sequence[MatchedRun], places: Mapping[str, Array], failed: list[str]
    ) -> tuple[AxisSolution, list[MatchedRun], Choice, float]:
        """Solve twice: the second time at places that the first tables give.

        ``failed`` takes words on reflectors that were re-seated.

        Returns
        -------
        done : AxisSolution
        matched : list of MatchedRun
            With its poses and places.
        choice : Choice
            Of the reversal model.
        before : float
            m; mean distance of the pieces from the curves at the first poses.
        """
        machine, matched = self.recordings[0].machine, list(matched)
        noises = [self._noise(r) for r in self.recordings]
        tables = _located(machine, self.nodes, matched[0].location)
        runs = self._runs(matched, places, tables)
        before = _mean_distance(runs)
        solve = partial(solve_jointly, noises=noises, config=self.config, progress=self.progress)
        improve = partial(
            solve_robustly, noises=noises, config=self.config, progress=self.progress
        )
        shapes = {
            SMOOTH: smooth_bases(machine, self.nodes),
            FINER: smooth_bases(machine, self.nodes, finer=2),
            STRAIGHT: linear_bases(machine, self.nodes),
        }
        layouts = {name: self._layout(bases) for name, bases in shapes.items()}
        unknown = [None] * len(runs)
        try:
            joint = solve(runs, fitted=unknown, unknowns=layouts[SMOOTH], tables=tables)
        except UnsettledError as error:
            steps = find_steps(error.joint, LEAST)
            raise InputError(steps[0] if steps else str(error)) from None
        joint = choose_functions(joint, layouts, self.config.unidentifiable_above)
        joint, fitted = improve(joint, fitted=unknown, repetitions=FIRST_REPETITIONS)
        layout = partial(self._layout, joint.unknowns.bases)
        choice, unknowns = choose_reversal(joint, layout, self.config)
        tables = tables_of(machine, joint.unknowns, joint.solution.value)
        matched = self._moved(matched, joint)
        runs = self._runs(matched, joint.places, tables)
        logs = joint.roughness.logs
        joint = solve(runs, fitted=fitted, unknowns=unknowns, tables=tables, logs=logs)
        joint, _ = improve(joint, fitted=fitted)
        # not before: places that are 0.1 mm off along the path look like a step
        failed.extend(find_steps(joint))
        return joint, self._moved(matched, joint), choice, before

    def _layout(
        self, bases: Mapping[str, Basis], reversal: Sequence[str] = (), lags: Sequence[str] = ()
    ) -> Unknowns:
        machine = self.recordings[0].machine
        return layout(machine, bases, max(self.stations) + 1, self.free, reversal, lags)

    def _noise(self, recording: Recording) -> NoiseModel:
        samples, spec = recording.samples, self.recordings[0].machine.tracker
        with errors_of(recording.name):
            if self.method == STANDSTILL:
                seen = standstill_noise(samples, at_stops(samples, self.config))
                if seen is not None:
                    return seen.noise
            return noise_model(samples, spec, self.config.rest_speed)

    def _moved(self, matched: Sequence[MatchedRun], joint: AxisSolution) -> list[MatchedRun]:
        pairs = zip(matched, self.stations, strict=True)
        return [replace(m, pose=joint.poses[k], places=joint.places) for m, k in pairs]

    def _runs(
        self, matched: Sequence[MatchedRun], places: Mapping[str, Array], tables: ErrorTables
    ) -> list[AxisRun]:
        """Recordings reduced to pieces or stops."""
        runs = []
        for recording, one, station in zip(self.recordings, matched, self.stations, strict=True):
            with errors_of(recording.name):
                pieces = (
                    reduce_to_stops(recording.samples, one, self.config)
                    if self.method == STANDSTILL
                    else reduce_to_pieces(recording.samples, one, self.nodes, self.config, tables)
                )
            machine, name = self.recordings[0].machine, recording.name
            runs.append(
                AxisRun(
                    machine, one.parts, pieces, one.pose, places, one.places, station, name,
                    self.free,
                )
            )  # fmt: skip
        return runs


def _match_all(
    recordings: Sequence[Recording], progress: Progress, same_station: bool
) -> tuple[list[MatchedRun], list[str]]:
    """Match all recordings; also what is to be noted of them."""
    matched: list[MatchedRun] = []
    notes: list[str] = []
    progress('aligning', 0.0)
    for k, recording in enumerate(recordings):
        with errors_of(recording.name):
            known = matched[0] if same_station and matched else None
            match_of_run = match(
                recording.samples,
                recording.machine,
                recording.axis_paths,
                known.pose if known else None,
                known.places if known else None,
            )
            notes += check_matched(recording.samples, match_of_run, recording.axis_paths)
            matched.append(match_of_run)
        progress('aligning', (k + 1) / (len(recordings) + 1))
    return matched, notes


def _located(
    machine: Machine, nodes: Mapping[str, Array], location: Mapping[str, float]
) -> ErrorTables:
    """Tables of lines that lie elsewhere, and nothing else: where places are looked for first."""
    motions: dict[str, MotionTable] = {}
    for motion in machine.motions:
        zero = np.zeros(len(nodes[motion.axis]))
        motions[motion] = MotionTable(nodes[motion.axis], zero, zero)
    return ErrorTables(
        machine,
        motions,
        {n: Squareness() for n in machine.squareness},
        {n: LocationError(location[n]) for n in machine.location},
    )


def _mean_distance(runs: Sequence[AxisRun]) -> float:
    """Mean distance of the pieces from the curves at the poses of the runs, m."""
    distances = []
    for run in runs:
        off = run.pose.apply(run.pieces.xyz) - run.pieces.nominal
        along = np.einsum('ij,ij->i', off, run.pieces.direction)
        distances.append(np.linalg.norm(off - along[:, None] * run.pieces.direction, axis=1))
    return float(np.concatenate(distances).mean())


def driven_ranges(machine: Machine, matched: Sequence[MatchedRun]) -> tuple[Array, Array]:
    """Lowest and highest position of every axis where it moves the reflector in view."""
    low = np.full(len(machine.axis_names), np.inf)
    high = -low
    for one in matched:
        for part in one.parts:
            met = {j.name for j in one.sight(part.path.target).joints}
            for k, axis in enumerate(machine.axis_names):
                if axis in met:
                    q = machine.axes[axis].wrapped(part.path.positions[:, k])
                    whole = machine.axes[axis].endless and np.ptp(part.path.positions[:, k]) > 6.0
                    ends = (
                        [machine.axes[axis].min, machine.axes[axis].max]
                        if whole
                        else [q.min(), q.max()]
                    )
                    low[k], high[k] = min(low[k], ends[0]), max(high[k], ends[1])
    missing = ~np.isfinite(low)
    low[missing] = high[missing] = np.clip(0.0, machine.lower, machine.upper)[missing]
    return np.maximum(low, machine.lower), np.minimum(high, machine.upper)


def common_places(machine: Machine, matched: Sequence[MatchedRun]) -> dict[str, Array]:
    """Places of the targets from the first recording that saw them."""
    places = {name: np.array(t.place) for name, t in machine.targets.items()}
    for one in reversed(list(matched)):
        for part in one.parts:
            places[part.path.target] = one.places[part.path.target]
    return places


def _assembled(
    recordings: Sequence[Recording],
    matched: Sequence[MatchedRun],
    joint: AxisSolution,
    choice: Choice,
    config: CalibrationConfig,
    method: str,
    driven: tuple[Array, Array],
    before: float,
) -> AxisCalibration:
    machine, unknowns = joint.machine, joint.unknowns
    whitened = [s.whitener.whiten(s.residual) for s in joint.runs]
    rows = sum(w.size for w in whitened)
    used = effective_unknowns(joint)
    ratio = float(sum(np.sum(w**2) for w in whitened) / max(rows - used, 1.0))
    nodes, runs = table_nodes(machine, *driven), observed_parts(recordings, joint)
    budget = budget_of_axes(runs, joint, nodes, config.rest_speed, used)
    covariance = budget.whole
    tabulated = tabulate(machine, joint, driven, config.unidentifiable_above, covariance)
    budget = replace(budget, rows=tabulated.rows, straight=tabulated.straight)
    typical = typical_of_axes(runs, joint, nodes, tabulated)
    fit = _fit_of(recordings, matched, joint, before, ratio, budget.inflation)
    advice = advice_for(machine, matched, tabulated.hidden)
    return AxisCalibration(
        run_id=run_id(recordings, config),
        machine=machine,
        made=tabulated,
        budget=budget,
        typical=typical,
        solution=joint,
        matched=tuple(matched),
        targets=_target_places(matched, joint, covariance),
        driven=driven,
        corners=_linear_positions(joint),
        fit=fit,
        warnings=(
            *typical_warnings(typical),
            *(r for one in recordings for r in one.remarks),
            *_warnings(tabulated),
        ),
        failed_gates=(
            *_failed(fit),
            *wrong_lines(
                {n: (v.value, v.identifiable) for n, v in tabulated.tables.location.items()},
                machine,
            ),
        ),
        reversal=Reversal(
            choice.model,
            choice.evidence,
            reversal_tables(
                tabulated.tables,
                unknowns,
                joint.solution.value,
                covariance,
                joint.solution.accepted,
            ),
            choice.held,
        ),
        lags=tuple(lags(joint, covariance)),
        advice=advice,
        method=method,
        config=config,
        origin=origins(recordings),
    )


def _target_places(
    matched: Sequence[MatchedRun], joint: AxisSolution, covariance: Array
) -> dict[str, tuple[Array, Array]]:
    """Places of the targets that were seen, m, and their standard uncertainties."""
    places = {}
    for name in sorted({p.path.target for m in matched for p in m.parts}):
        u = np.zeros(3)
        if place_block(name) in joint.unknowns.blocks:
            block = joint.unknowns.blocks[place_block(name)]
            u = np.sqrt(np.maximum(np.diag(covariance[block, block]), 0.0))
        places[name] = (np.asarray(joint.places[name]), u)
    return places


def _linear_positions(joint: AxisSolution) -> Array:
    """Positions (n, 3) of the linear axes at the pieces; of reflectors in the spindle if any."""
    q = np.concatenate([s.system.q for s in joint.runs])
    targets = joint.machine.targets
    links = [np.array([targets[p.path.target].link for p in s.run.parts]) for s in joint.runs]
    of_pieces = [own[s.run.pieces.part] for own, s in zip(links, joint.runs, strict=True)]
    in_spindle = np.concatenate(of_pieces) == SPINDLE
    return q[in_spindle, :3] if in_spindle.any() else q[:, :3]


def _fit_of(
    recordings: Sequence[Recording],
    matched: Sequence[MatchedRun],
    joint: AxisSolution,
    before: float,
    ratio: float,
    inflation: float,
) -> AxisFit:
    after = np.concatenate([np.linalg.norm(s.residual, axis=0) for s in joint.runs])
    driven = [(share, p.path) for m in matched for share, p in zip(m.driven, m.parts, strict=True)]
    driven += [(0.0, path) for m in matched for path in m.missing]
    coverage = float(
        np.average(
            [share for share, _ in driven],
            weights=[driven_length(recordings[0].machine, path.positions) for _, path in driven],
        )
    )
    return AxisFit(
        samples=sum(len(r.samples) for r in recordings),
        used=sum(s.run.pieces.used for s in joint.runs),
        outliers=sum(s.run.pieces.outliers for s in joint.runs),
        pieces=len(after),
        unknowns=joint.unknowns.free,
        rank=joint.solution.rank,
        coverage=coverage,
        path_mae_before=before,
        path_mae_after=float(after.mean()),
        residual_rms=float(np.sqrt(np.mean(after**2))),
        variance_ratio=ratio,
        inflation=inflation,
        iterations=joint.iterations,
    )


def effective_unknowns(joint: AxisSolution) -> float:
    """Number of combinations of the unknowns that the data decide: tr(V N)."""
    free = joint.unknowns.kept
    cover = joint.solution.covariance[np.ix_(free, free)]
    return float(np.sum(cover * joint.normal.matrix[: len(free), : len(free)]))


def _failed(fit: AxisFit) -> tuple[str, ...]:
    failed = failed_gates_of_data(fit.coverage, fit.outliers, fit.samples)
    if fit.path_mae_after >= fit.path_mae_before:
        failed.append('compensation: the tables do not reduce the distance from the path')
    return tuple(failed)


def _warnings(tabulated: AxisTables) -> tuple[str, ...]:
    warnings = []
    for name, table in tabulated.tables.motions.items():
        if table.identifiable and table.node_identifiable is not None:
            loose = table.position[~table.node_identifiable]
            if loose.size:
                warnings.append(
                    f'{name}: not determined by the data at {loose.size} nodes; continued smoothly'
                )
    return tuple(warnings)


def advice_for(
    machine: Machine, matched: Sequence[MatchedRun], hidden: Sequence[str]
) -> dict[str, str]:
    """State for every error that the data do not show which path would show it."""
    advice = {}
    moving = {
        axis
        for one in matched
        for part in one.parts
        for k, axis in enumerate(machine.axis_names)
        if np.ptp(part.path.positions[:, k]) > 0
        and axis in {j.name for j in one.sight(part.path.target).joints}
    }
    tools = {
        tuple(np.round(machine.targets[p.path.target].place, 6))
        for m in matched
        for p in m.parts
        if machine.targets[p.path.target].link == SPINDLE
    }
    nests = {
        p.path.target
        for m in matched
        for p in m.parts
        if machine.targets[p.path.target].link == TABLE
    }
    for name in hidden:
        axis = name[-1]
        if axis not in moving:
            advice[name] = f'a part in which {axis} moves a reflector in view of the tracker'
        elif axis in machine.rotary_names:
            advice[name] = _rotary_advice(machine, name, axis, nests, len(matched))
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


def first_pose(result: AxisCalibration) -> RigidTransform:
    """Pose of the tracker in the first recording, to the link that it stands on."""
    return result.solution.poses[0]


LINEAR, ROTARY = 3, 4
"""Positions of every linear and of every rotary axis."""


def volume_errors(result: AxisCalibration, provisional: bool = False) -> VolumeErrors:
    """Return the errors on a grid over the driven ranges of all axes, frame of the table."""
    machine, (low, high) = result.machine, result.driven
    ends = [_places(result, k, float(low[k]), float(high[k])) for k in range(len(low))]
    q = np.stack([mesh.ravel() for mesh in np.meshgrid(*ends, indexing='ij')], axis=1)
    place = np.array(machine.targets[TOOL].place)
    points = Sight(machine, TABLE, SPINDLE, place).nominal(q)
    nodes: dict[str, Array] = {m: result.tables.motions[m].position for m in machine.motions}
    u = prediction_uncertainty(machine, nodes, result.made.covariance, q)
    errors = displacement(result.tables, q)
    return VolumeErrors(points, errors, u, provisional, machine.axis_names, q)


def _places(result: AxisCalibration, column: int, low: float, high: float) -> Array:
    """Positions of one axis: one if it was not driven, no full turn twice."""
    if high - low <= 0.0:
        return np.array([low])
    axis = result.machine.axes[result.machine.axis_names[column]]
    count = ROTARY if axis.rotary else LINEAR
    return np.linspace(low, high, count, endpoint=not axis.endless)
