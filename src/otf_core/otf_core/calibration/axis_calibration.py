# SPDX-License-Identifier: Apache-2.0
"""From recordings of a machine with rotary axes to error tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.calibration.assembly import Solved, assemble
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import OTF, STANDSTILL, CalibrationConfig
from otf_core.contradictions.part_steps import LEAST, find_steps
from otf_core.errors import InputError
from otf_core.live.stages import Progress
from otf_core.model.machine import Machine
from otf_core.model.nodes import table_nodes
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.noise.noise_model import NoiseModel
from otf_core.noise.standstill import noise_model, standstill_noise
from otf_core.pieces.methods import find_stops
from otf_core.pieces.pieces import reduce_to_pieces
from otf_core.pieces.runs import Observed, Recording, check_same_machine, errors_of
from otf_core.prediction.calibration_document import DrivenPart
from otf_core.rotary.curve_matching import GENTLE, MatchedRun, match
from otf_core.rotary.mismatch import check_matched, wrong_lines
from otf_core.solving.joint import (
    JointSolution,
    Start,
    UnsettledError,
    find_identifiable_blocks,
    solve_robustly,
    tables_of,
    unknowns_of,
)
from otf_core.solving.model_choice import choose_shapes
from otf_core.solving.reversal import Choice, choose_reversal
from otf_core.threads import limit_to_one_thread


def calibrate_axes(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress,
    method: str = OTF,
    *,
    same_station: bool = False,
) -> CalibrationResult:
    """Calibrate from recordings in parts; see ``calibrate.calibrate_recordings``."""
    solved = solve_axes(recordings, config, progress, method, same_station=same_station)
    return assemble_axes(solved, config)


@dataclass(frozen=True)
class SolvedAxes:
    """Recordings that are matched and solved.

    Attributes
    ----------
    matched : list of MatchedRun
        Of every recording, with its pose and places.
    choice : Choice
        Of the reversal model.
    driven : tuple of ndarray, shape (k,)
        Lowest and highest positions of the axes.
    notes, failed : list of str
        Warnings, and quality gates that failed.
    """

    recordings: Sequence[Recording]
    matched: list[MatchedRun]
    joint: JointSolution
    choice: Choice
    driven: tuple[Array, Array]
    notes: list[str]
    failed: list[str]

    @property
    def nodes(self) -> dict[str, Array]:
        """Table nodes, m and rad, by axis."""
        return table_nodes(self.joint.machine, *self.driven)


@limit_to_one_thread
def solve_axes(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress,
    method: str = OTF,
    *,
    same_station: bool = False,
) -> SolvedAxes:
    """Match and solve; see ``calibrate_axes``."""
    check_same_machine(recordings)
    machine = recordings[0].machine
    matched, notes = _match_all(recordings, progress, same_station)
    driven = driven_ranges(machine, matched)
    progress('solving', 0.0)
    nodes = table_nodes(machine, *driven)
    job = _Job(recordings, config, progress, method, nodes, same_station)
    failed: list[str] = []
    joint, matched, choice = job.solve(matched, failed)
    return SolvedAxes(recordings, matched, joint, choice, driven, notes, failed)


@dataclass(frozen=True)
class _Job:
    """What is the same in every step of a solution.

    Attributes
    ----------
    recordings, config, progress, method, same_station
        See ``calibrate_axes``.
    nodes : mapping of axis to ndarray, m and rad
    """

    recordings: Sequence[Recording]
    config: CalibrationConfig
    progress: Progress
    method: str
    nodes: dict[str, Array]
    same_station: bool

    def solve(
        self, matched: Sequence[MatchedRun], failed: list[str]
    ) -> tuple[JointSolution, list[MatchedRun], Choice]:
        """Solve twice: the second time at places that the first tables give.

        ``failed`` takes words on reflectors that were re-seated.

        Returns
        -------
        done : JointSolution
        matched : list of MatchedRun
            With its poses and places.
        choice : Choice
            Of the reversal model.
        """
        machine, config, progress = self.recordings[0].machine, self.config, self.progress
        places = common_places(machine, matched)
        tables = _located(machine, self.nodes, matched[0].location)
        runs = self._runs(matched, places, tables)
        try:
            shapes = choose_shapes(runs, self.nodes, config, progress, tables)
        except UnsettledError as error:
            steps = find_steps(error.joint, LEAST)
            raise InputError(steps[0] if steps else str(error)) from None
        unknowns = unknowns_of(runs, shapes.bases)
        runs, joint = solve_robustly(shapes.improved, unknowns, config, progress, shapes.start)
        choice, unknowns = choose_reversal(runs, joint, config)
        tables = tables_of(machine, joint.unknowns, joint.solution)
        matched, fitted = _moved(matched, joint), [run.fitted for run in runs]
        runs = [
            replace(run, fitted=logs)
            for run, logs in zip(self._runs(matched, joint.places, tables), fitted, strict=True)
        ]
        accepted = joint.solution.accepted
        if further := unknowns.blocks.keys() - joint.unknowns.blocks.keys():
            seen = find_identifiable_blocks(runs, unknowns, config.unidentifiable_above)
            accepted = (*accepted, *(name for name in seen if name in further))
        start = Start(joint.roughness.logs, accepted, tables)
        _, joint = solve_robustly(runs, unknowns, config, progress, start)
        # not before: places that are 0.1 mm off along the path look like a step
        failed.extend(find_steps(joint))
        return joint, _moved(matched, joint), choice

    def _noise(self, recording: Recording) -> NoiseModel:
        samples, spec = recording.samples, self.recordings[0].machine.tracker
        with errors_of(recording.name):
            if self.method == STANDSTILL:
                seen = standstill_noise(samples, find_stops(samples, self.config, GENTLE).span)
                if seen is not None:
                    return seen.noise
            return noise_model(samples, spec, self.config.rest_speed)

    def _runs(
        self, matched: Sequence[MatchedRun], places: Mapping[str, Array], tables: ErrorTables
    ) -> list[Observed]:
        """Recordings reduced to pieces or stops."""
        runs, nodes = [], [self.nodes[a] for a in self.recordings[0].machine.axis_names]
        for recording, one in zip(self.recordings, matched, strict=True):
            with errors_of(recording.name):
                pieces = (
                    one.reduce_to_stops(recording.samples, self.config)
                    if self.method == STANDSTILL
                    else reduce_to_pieces(
                        recording.samples, one.aligned(), nodes, self.config, tables
                    )
                )
            targets = tuple(part.path.target for part in one.parts)
            runs.append(
                Observed(
                    machine=self.recordings[0].machine,
                    pieces=pieces,
                    pose=one.pose,
                    noise=self._noise(recording),
                    name=recording.name,
                    targets=targets,
                    places={name: places[name] for name in targets},
                    base={name: one.places[name] for name in targets},
                    same_station=self.same_station,
                )
            )
        return runs


def _moved(matched: Sequence[MatchedRun], joint: JointSolution) -> list[MatchedRun]:
    """Matched runs with the poses and places of a solution."""
    pairs = zip(matched, joint.runs, strict=True)
    return [replace(m, pose=s.pose, places={**m.places, **joint.places}) for m, s in pairs]


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
        {n: ScalarError() for n in machine.squareness},
        {n: ScalarError(location[n]) for n in machine.location},
    )


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


@limit_to_one_thread
def assemble_axes(solved: SolvedAxes, config: CalibrationConfig) -> CalibrationResult:
    """Work out the result of a solution, see ``assembly.assemble``."""
    recordings, joint = solved.recordings, solved.joint
    result = assemble(
        Solved(
            recordings=recordings,
            parts=[_parts_of(m) for m in solved.matched],
            coverage=[m.coverage for m in solved.matched],
            joint=joint,
            choice=solved.choice,
            rest=config.rest_speed,
        ),
        config,
        notes=(*solved.notes, *(r for one in recordings for r in one.remarks)),
        failed=solved.failed,
    )
    seen = {n: (v.value, v.identifiable) for n, v in result.tables.location.items()}
    gates = (*result.failed_gates, *wrong_lines(seen, joint.machine))
    return replace(result, failed_gates=gates)


def _parts_of(matched: MatchedRun) -> list[DrivenPart]:
    """Parts of a run, those that were not recorded last."""
    names = matched.machine.axis_names
    parts = []
    for share, one in zip(matched.driven, matched.parts, strict=True):
        target, positions = one.path.target, one.path.positions
        met = {j.name for j in matched.sight(target).joints}
        moved = tuple(a for k, a in enumerate(names) if a in met and np.ptp(positions[:, k]) > 0)
        parts.append(DrivenPart(target, len(positions), share, moved))
    return parts + [DrivenPart(p.target, len(p.positions), 0.0, ()) for p in matched.missing]
