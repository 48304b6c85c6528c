# SPDX-License-Identifier: Apache-2.0
"""The whole loop: drive, measure, calibrate, compensate, drive other lines, verify."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.calibration.calibrate import calibrate_runs
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import CalibrationConfig, SimulationConfig
from otf_core.errors import InputError
from otf_core.exports import export_format
from otf_core.exports.format import Field, Request
from otf_core.loop.control import (
    LATTICE,
    DrivenProgram,
    Program,
    drive,
    ini_text,
    insert_piece,
    written_files,
)
from otf_core.model.evaluation import mean_length, without_rigid_motion
from otf_core.model.frames import RigidTransform
from otf_core.model.kinematics import displacement, exact_position
from otf_core.model.machine import Machine
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables, TablesFile
from otf_core.pieces.runs import Recording, prepare_runs, rigid_pose
from otf_core.planning.forecast import drive_times
from otf_core.planning.nc import DIALECTS
from otf_core.planning.nc.linuxcnc import LinuxCnc
from otf_core.planning.nc.programs import program, round_to_increment
from otf_core.prediction.covariance import pack_covariance
from otf_core.prediction.predict import predict
from otf_core.sim.cell import random_tables
from otf_core.sim.tracker import place_tracker
from otf_core.sim.watched import sample_moving_target

# Lines to prove a compensation on: drawn in the volume, none of them one that was fitted.

POINTS_PER_LINE = 13
SHORTEST_LINE = 0.3
"""Share of the space diagonal; shorter lines are drawn again."""
INNER = 0.03
"""Share of every axis kept free at either end."""
DWELL = 0.3
"""s; at every corner point."""
MOST_TRIES = 10_000


def check_plan(machine: Machine, feed: float, rng: np.random.Generator) -> Plan:
    """Draw lines through the whole volume.

    Parameters
    ----------
    feed : float
        m/s
    """
    size = machine.upper - machine.lower
    low, high = machine.lower + INNER * size, machine.upper - INNER * size
    points = [rng.uniform(low, high)]
    for _ in range(MOST_TRIES):
        point = rng.uniform(low, high)
        if np.linalg.norm(point - points[-1]) > SHORTEST_LINE * np.linalg.norm(size):
            points.append(point)
        if len(points) == POINTS_PER_LINE:
            break
    return Plan(
        NominalPath(np.array(points)), np.full(len(points) - 1, feed), np.full(len(points), DWELL)
    )


# Corrected NC program: for controls that have no table for the volumetric error.
#
# Every line is cut into parts, and the ends of the parts are moved by minus the error there. The
# parts are blended within ``TOLERANCE``; at the corner points of the nominal path the machine
# stops by its dwell as before.

LONGEST_PART = 0.01
"""m; longest part of a line."""
TOLERANCE = 1e-7
"""m; blending between parts (G64 P)."""


class _Corrected(LinuxCnc):
    """Positions of 0.1 um, which the interpreter takes like any number."""

    decimals = 4


INCREMENT = 1e-7
"""m; of these positions."""


def cut_legs(plan: Plan) -> Plan:
    """Cut every leg into parts of at most ``LONGEST_PART``; only corners of the plan dwell."""
    points, feed, dwell = [plan.path.points[0]], [], [plan.dwell[0]]
    for k, length in enumerate(plan.path.leg_lengths):
        count = max(1, int(np.ceil(length / LONGEST_PART)))
        share = np.arange(1, count + 1)[:, None] / count
        start, end = plan.path.points[k], plan.path.points[k + 1]
        points.extend(start + share * (end - start))
        feed.extend([plan.feed[k]] * count)
        dwell.extend([0.0] * (count - 1) + [plan.dwell[k + 1]])
    return Plan(NominalPath(np.array(points)), np.array(feed), np.array(dwell))


def correct_points(parts: Plan, held: Field) -> Plan:
    """Move the points of a plan by minus the error, to the increment of a program.

    Parameters
    ----------
    parts : Plan
        See ``cut_legs``.
    held : callable
        Error at positions, m.
    """
    nominal = parts.path.points
    moved = nominal - held(nominal)
    moved -= (moved - nominal)[0]  # the zero point of the program is that of the nominal path
    points = np.rint(moved / INCREMENT) / round(1 / INCREMENT)
    return Plan(NominalPath(points), parts.feed, parts.dwell)


def corrected_program(plan: Plan, header: Sequence[str]) -> str:
    """Program for LinuxCNC: parts blended, stops by dwell."""
    text = program(_Corrected(), plan, header)
    return text.replace('\nG61.1\n', f'\nG64 P{1e3 * TOLERANCE:.6f}\n', 1)


# Volumetric error along lines that a control drove: true, and as a tracker sees it.
#
# Where the program is the nominal path, the nominal position is where the control believes to be.
# In a corrected program it belongs to the point of the program that the control has reached, found
# by the length driven since the start: the control runs along the points of its program, so equal
# shares of that length are equal places in it, whatever the correction has moved.

POSITION_TOLERANCE = 2e-6
"""m; the control counts as standing at a point that is nearer than this."""
ERROR_STEP = 1e-3
"""m; the error is taken this often along the path."""
DETOUR = 1e-4
"""Largest relative difference of the length driven from that of the program."""


@dataclass(frozen=True)
class CommandedPositions:
    """Moments spread evenly along a path.

    Attributes
    ----------
    row : ndarray of int64, shape (n,)
        Servo periods.
    nominal : ndarray, shape (n, 3), m
        Where the target should be.
    share : ndarray, shape (n,)
        Of the whole path.
    """

    row: NDArray[np.int64]
    nominal: Array
    share: Array


def start_row(driven: DrivenProgram, point: Array) -> int:
    """First servo period in which the control stands at the start of the path."""
    there = np.flatnonzero(np.linalg.norm(driven.believed - point, axis=1) < POSITION_TOLERANCE)
    if not len(there):
        raise InputError('LinuxCNC: never reached the start of the path')
    return int(there[0])


def commanded_positions(
    driven: DrivenProgram, programmed: NominalPath, nominal: NominalPath | None = None
) -> CommandedPositions:
    """Find what the control was to drive at each moment.

    Parameters
    ----------
    programmed : NominalPath
        Points of the program.
    nominal : NominalPath, optional
        Where the target should be at these points, if not there.

    Raises
    ------
    InputError
        If the control drove another length than that of its program.
    """
    first = start_row(driven, programmed.points[0])
    moved = np.linalg.norm(np.diff(driven.believed[first:], axis=0), axis=1)
    reach = np.concatenate([[0.0], np.cumsum(moved)])
    corners = np.concatenate([[0.0], np.cumsum(programmed.leg_lengths)])
    if abs(reach[-1] - corners[-1]) > DETOUR * corners[-1]:
        raise InputError(f'LinuxCNC: drove {reach[-1]:.6f} m of a program of {corners[-1]:.6f} m')
    reach *= corners[-1] / reach[-1]
    wanted = np.arange(ERROR_STEP, corners[-1], ERROR_STEP)
    row = np.minimum(np.searchsorted(reach, wanted), len(reach) - 1)
    if nominal is None:
        return CommandedPositions(first + row, driven.believed[first + row], wanted / corners[-1])
    at = reach[row]
    points = np.stack([np.interp(at, corners, nominal.points[:, k]) for k in range(3)], axis=1)
    return CommandedPositions(first + row, points, wanted / corners[-1])


def by_line(
    error: Array, at: CommandedPositions, path: NominalPath
) -> tuple[tuple[float, float], ...]:
    """Mean and largest length of the errors on each line, best rigid motion of all taken out.

    Parameters
    ----------
    error : ndarray, shape (n, 3), m
    path : NominalPath
        The lines.

    Returns
    -------
    tuple of (mean, largest), m
        One pair a line.
    """
    length = np.linalg.norm(without_rigid_motion(error, at.nominal), axis=1)
    ends = np.cumsum(path.leg_lengths)
    line = np.minimum(np.searchsorted(ends, at.share * ends[-1]), len(ends) - 1)
    own = [length[line == k] for k in range(len(ends))]
    return tuple((float(v.mean()), float(v.max())) for v in own)


def volumetric(error: Array, q: Array) -> float:
    """Mean length of errors (n, 3) at positions (n, 3), best rigid motion removed, m."""
    return mean_length(without_rigid_motion(error, q))


def distance_from_lines(recording: Recording) -> float:
    """Mean distance of tracker samples from the lines, rigidly aligned, m.

    What a real machine shows: without a common clock nothing is seen along the line.
    """
    config = CalibrationConfig()
    (run, *_), _ = prepare_runs([recording], config)
    points = rigid_pose(run.pieces, run.pose, config).apply(run.pieces.xyz)
    away = points - run.pieces.origin
    along = np.einsum('ij,ij->i', away, run.pieces.direction)
    return mean_length(away - along[:, None] * run.pieces.direction)


# The whole circle: drive, measure, calibrate, compensate, drive again on other lines, prove it.
#
# LinuxCNC drives programs with its own acceleration and its own clock; the simulated machine goes
# where its motors are; the simulated tracker measures with another clock. Tables come from the
# fitted path alone; what is judged are lines drawn anew.

AXES_WAY, VOLUME, PROGRAM = 'axes', 'volume', 'program'
WAYS = (AXES_WAY, VOLUME, PROGRAM)
FIT, CHECK, PROOF = 'fit.ngc', 'check.ngc', 'proof.ngc'


@dataclass(frozen=True)
class Proof:
    """What a compensation did on lines that were not fitted.

    Attributes
    ----------
    before, after : float
        m; mean volumetric error, true, best rigid motion removed.
    forecast : float
        m; what the export forecast to remain on these lines, u of the tables in it.
    of_tables, of_export, of_control : float
        m; what is left, by where it comes from: true errors less those of the tables, what the
        export cannot hold of these, and what the control does not bring to the motors of that
        (delay, increments, following, second order). Mean lengths like ``after``.
    seen_before, seen_after : float
        m; mean distance of the tracker's samples from the lines.
    lag_mean, lag_max : float
        m; external offsets: motor correction minus what the tables ask for at that moment.
    lost : int
        Servo periods that were not sampled.
    lines_before, lines_after : tuple of (mean, largest)
        m; length of the errors on each line, as ``before`` and ``after``.
    """

    before: float
    after: float
    forecast: float
    of_tables: float
    of_export: float
    of_control: float
    seen_before: float
    seen_after: float
    lag_mean: float
    lag_max: float
    lost: int
    lines_before: tuple[tuple[float, float], ...]
    lines_after: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Circle:
    """Everything that a round gave.

    Attributes
    ----------
    way : str
        'axes', 'volume' or 'program'.
    recordings : mapping of name to Recording
        'fit', 'check', 'proof'.
    files : mapping of file name to bytes
        Programs, configuration of the control, compensation.
    """

    way: str
    proof: Proof
    result: CalibrationResult
    truth: ErrorTables
    recordings: Mapping[str, Recording]
    files: Mapping[str, bytes]


@dataclass(frozen=True)
class Cell:
    """A simulated machine on the control, with a simulated tracker in front of it."""

    machine: Machine
    truth: ErrorTables
    pose: RigidTransform
    config: SimulationConfig

    @classmethod
    def drawn(cls, machine: Machine, config: SimulationConfig) -> Cell:
        """Draw errors of the machine and place of the tracker from the seed."""
        rngs = [np.random.default_rng([config.seed, part]) for part in range(2)]
        rotation, place = place_tracker(machine, rngs[1])
        truth = random_tables(machine, config.error_size, rngs[0])
        return cls(machine, truth, RigidTransform(rotation.T, place), config)

    def actual(self, driven: DrivenProgram) -> Array:
        """Where the target really is, a row per servo period, m."""
        return exact_position(self.truth, driven.motor)

    def recording(
        self, name: str, driven: DrivenProgram, start: Array, path: NominalPath
    ) -> Recording:
        """What the tracker records of a drive, from the standstill at the start on."""
        first = start_row(driven, start)
        number = (FIT, CHECK, PROOF).index(name)
        rng = np.random.default_rng([self.config.seed, 10 + number])
        samples = sample_moving_target(
            driven.time[first:], self.actual(driven)[first:], self.pose, self.machine,
            self.config, rng,
        )  # fmt: skip
        return Recording(samples, path, self.machine, name.partition('.')[0])


@dataclass(frozen=True)
class Compensation:
    """What is loaded into the control.

    Attributes
    ----------
    held : callable
        Error that it takes off.
    files : mapping of file name to bytes
    ini_piece : str
        Lines for the INI file.
    """

    held: Field
    files: Mapping[str, bytes]
    ini_piece: str = ''


def compensation(way: str, content: TablesFile) -> Compensation:
    """Make the files of one way of compensating from error tables."""
    if way == AXES_WAY:
        export = export_format('linuxcnc').export(Request(content, 'compensation.ini'))
        files = dict(export.files)
        return Compensation(export.held, files, files.pop('compensation.ini').decode())
    export = export_format('lattice-csv').export(Request(content, LATTICE))
    return Compensation(export.held, export.files)


def _program(name: str, plan: Plan, text: str, acceleration: float) -> Program:
    expected = drive_times(plan, acceleration).duration
    return Program.of(name, text, expected)


def _nc(plan: Plan, what: str) -> str:
    return program(DIALECTS['linuxcnc'], plan, [what])


def go_round(
    machine: Machine,
    plan: Plan,
    way: str,
    config: SimulationConfig,
    progress: Callable[[str], None],
) -> Circle:
    """Go round once.

    Parameters
    ----------
    plan : Plan
        What is fitted.
    way : str
        One of ``WAYS``.
    config : SimulationConfig
        Its acceleration is that of the control's axes.

    Raises
    ------
    ControlMissing
        If LinuxCNC is not installed.
    InputError
        If it did not do what was asked, or the calibration is not possible.
    """
    cell, feed = Cell.drawn(machine, config), float(plan.feed.max())
    plan = round_to_increment(plan, machine.lower, machine.upper)
    rng = np.random.default_rng([config.seed, 2])
    check = round_to_increment(check_plan(machine, feed, rng), machine.lower, machine.upper)
    rate = config.acceleration
    texts = {FIT: _nc(plan, 'FITTED PATH'), CHECK: _nc(check, 'LINES NOT FITTED')}
    jobs = [_program(n, p, texts[n], rate) for n, p in ((FIT, plan), (CHECK, check))]
    ini = ini_text(machine, rate, feed)
    progress(f'LinuxCNC drives the path and the check, {_seconds(jobs):.0f} s')
    fit, before = drive(machine, written_files(machine, ini, {}), jobs)
    recordings = {
        'fit': cell.recording(FIT, fit, plan.path.points[0], plan.path),
        'check': cell.recording(CHECK, before, check.path.points[0], check.path),
    }
    progress('calibrates')
    result = calibrate_runs([recordings['fit']])
    content = TablesFile(result.tables, {'run_id': result.run_id})
    loaded = compensation(way, content)
    proof_plan, nominal = check, None
    texts[PROOF] = texts[CHECK]
    if way == PROGRAM:
        parts = cut_legs(check)
        proof_plan, nominal = correct_points(parts, loaded.held), parts.path
        texts[PROOF] = corrected_program(proof_plan, ['LINES NOT FITTED, CORRECTED'])
    files = written_files(
        machine, insert_piece(ini, loaded.ini_piece), loaded.files, volume=way == VOLUME
    )
    job = _program(PROOF, check, texts[PROOF], rate)
    progress(f'LinuxCNC drives the check compensated by {way}, {_seconds([job]):.0f} s')
    (after,) = drive(machine, files, [job])
    recordings['proof'] = cell.recording(PROOF, after, proof_plan.path.points[0], check.path)
    at = (
        commanded_positions(before, check.path),
        commanded_positions(after, proof_plan.path, nominal),
    )
    proof = _proof(cell, (before, after), at, result, loaded.held, recordings, way)
    texts_as_bytes = {name: text.encode() for name, text in texts.items()}
    return Circle(way, proof, result, cell.truth, recordings, {**files, **texts_as_bytes})


def _seconds(jobs: list[Program]) -> float:
    """Time that programs are expected to take, s."""
    return sum(job.expected for job in jobs)


def _proof(
    cell: Cell,
    driven: tuple[DrivenProgram, DrivenProgram],
    at: tuple[CommandedPositions, CommandedPositions],
    result: CalibrationResult,
    held: Field,
    recordings: Mapping[str, Recording],
    way: str,
) -> Proof:
    errors = [cell.actual(d)[p.row] - p.nominal for d, p in zip(driven, at, strict=True)]
    before, after = (volumetric(e, p.nominal) for e, p in zip(errors, at, strict=True))
    q, tables = at[0].nominal, result.tables
    of_export = volumetric(displacement(tables, q) - held(q), q)
    known = {'covariance': pack_covariance(result.covariance)}
    u = predict(TablesFile(tables, known), q).u
    brought = displacement(cell.truth, at[1].nominal) - held(at[1].nominal)
    lag = _lag(driven[1], at[1], held) if way == VOLUME else np.zeros(1)
    path = recordings['check'].path
    return Proof(
        before=before,
        after=after,
        forecast=float(np.hypot(of_export, np.mean(np.linalg.norm(u, axis=1)))),
        of_tables=volumetric(displacement(cell.truth, q) - displacement(tables, q), q),
        of_export=of_export,
        of_control=volumetric(errors[1] - brought, at[1].nominal),
        seen_before=distance_from_lines(recordings['check']),
        seen_after=distance_from_lines(recordings['proof']),
        lag_mean=float(lag.mean()),
        lag_max=float(lag.max()),
        lost=max(d.lost for d in driven),
        lines_before=by_line(errors[0], at[0], path),
        lines_after=by_line(errors[1], at[1], path),
    )


def _lag(driven: DrivenProgram, at: CommandedPositions, held: Field) -> Array:
    """Length of what external offsets miss of the correction wanted, shape (n,), m."""
    believed = driven.believed[at.row]
    lacking = (driven.motor - driven.believed)[at.row] + held(believed)
    if not np.any(driven.offset):
        raise InputError('LinuxCNC: external offsets never moved an axis')
    lacking -= np.median(lacking, axis=0)  # offsets count from where they were switched on
    return np.asarray(np.linalg.norm(lacking, axis=1))
