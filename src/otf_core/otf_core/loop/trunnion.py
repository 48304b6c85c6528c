# SPDX-License-Identifier: Apache-2.0
"""The loop of a trunnion: parts driven, measured, calibrated; pivot and joint files; other poses.

LinuxCNC drives the parts with its axes uncoupled, the simulated machine goes where the motors are,
and the simulated tracker follows the reflector of the part. The exported pins of the trunnion
kinematics and a ``.comp`` file per joint are loaded. The poses that are judged are programmed with
the kinematics switched on, at places of the workpiece and angles drawn anew, once with the pins of
machine.yaml and once compensated: the control itself turns the pivot into positions of the motors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.calibration.axis_calibration import AxisCalibration, calibrate_axes
from otf_core.config import CalibrationConfig, PlannerConfig, SimulationConfig
from otf_core.errors import ConfigError, InputError
from otf_core.exports import export_format
from otf_core.exports.format import Request
from otf_core.exports.pivot import pins_displacement, trunnion_pins
from otf_core.live.stages import silent
from otf_core.loop.control import (
    COUPLED,
    KINEMATICS_OUTPUT,
    UNCOUPLED,
    DrivenProgram,
    Program,
    drive,
    ini_text,
    insert_piece,
    trunnion_module,
    written_files,
)
from otf_core.model.axis_path import AxisPath, nominal_track, seconds_of_legs
from otf_core.model.evaluation import mean_length, without_rigid_motion
from otf_core.model.frames import RigidTransform
from otf_core.model.joints import Sight, exact_position
from otf_core.model.kinematics import displacement, nominal_position
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.tables import ErrorTables, LocationError, TablesFile
from otf_core.pieces.runs import Recording
from otf_core.planning.axis_programs import part_program
from otf_core.planning.nc import DIALECTS
from otf_core.planning.nc.dialect import AxisMove
from otf_core.planning.rotary_paths import PlannedPart
from otf_core.prediction.covariance import pack_covariance
from otf_core.prediction.predict import predict
from otf_core.sim.axis_cell import BROKEN_BEAM
from otf_core.sim.cell import random_tables
from otf_core.sim.tracker import place_tracker
from otf_core.sim.watched import sample_moving_target

POSES = 24
INNER = 0.05
"""Share of every axis kept free at either end by the poses."""
POSE_FEED, POSE_RATE, DWELL = 0.3, np.radians(60.0), 0.3
"""m/s and rad/s of the axes between poses, and s at each of them."""
STANDS, STILL = 1e-9, 150
"""m and rad per servo period below which the axes stand, and the periods of a stop."""
ANGLE_TOLERANCE = 1e-6
"""rad; the rotary axes stand at a pose."""
START, QUICK = 'F3.000', 'F30.000'
"""Inverse times of a move to the start of a part, and that of the simulated machine, 1/min."""
WAIT = 2.0
"""s at the start and the end of a part, in place of the operator."""
PIVOT, JOINTS, POSES_FILE = 'pivot.txt', 'compensation.ini', 'poses.ngc'


@dataclass(frozen=True)
class PoseProof:
    """What the compensation did at poses that were not measured.

    Attributes
    ----------
    before, after : float
        m; mean position error of the tool relative to the workpiece, true, best rigid motion
        (the workpiece zero) removed.
    forecast : float
        m; what pins and joint files are to leave, u of the tables in it.
    of_tables, of_export, of_control : float
        m; what is left, by where it comes from, as in ``circle.Proof``.
    places : ndarray, shape (n, 3), m
        Where the tool was programmed, in the frame of the workpiece.
    angles : ndarray, shape (n, 2), rad
        Of the rotary axes.
    error_before, error_after : ndarray, shape (n,), m
    lost : int
        Servo periods that were not sampled.
    """

    before: float
    after: float
    forecast: float
    of_tables: float
    of_export: float
    of_control: float
    places: Array
    angles: Array
    error_before: Array
    error_after: Array
    lost: int


@dataclass(frozen=True)
class TrunnionCircle:
    """Everything that a round gave; ``pins``: old and new value by pin, mm."""

    proof: PoseProof
    result: AxisCalibration
    truth: ErrorTables
    recording: Recording
    pins: Mapping[str, tuple[float, float]]
    files: Mapping[str, bytes]


def check_trunnion(machine: Machine) -> str:
    """Return the module of LinuxCNC for a machine.

    Raises
    ------
    ConfigError
        If none of its trunnion kinematics holds the machine, or the installed one does not.
    """
    pins = trunnion_pins(machine)
    if pins is None:
        raise ConfigError(
            f'otf loop: the chain {machine.chain} with these directions is not one of '
            f'xyzac-trt-kins and xyzbc-trt-kins of LinuxCNC: C on A or B on the bed, both tables '
            f'turning right-handed (directions -1) or both left-handed (directions 1)'
        )
    module = next(iter(pins)).partition('.')[0]
    trunnion_module(module, conventional=f'{module}.conventional-directions' in pins)
    if np.abs(machine.target_offset[:2]).max() > 0.0:
        raise ConfigError(
            f'target_offset: {machine.target_offset.tolist()}; the trunnion kinematics of '
            f'LinuxCNC know a tool length along Z only: put the reflector on the spindle axis'
        )
    if machine.tracker.link != 'b':
        raise ConfigError('tracker: link: otf loop needs the tracker of a trunnion on the bed: b')
    return module


@dataclass(frozen=True)
class Cell:
    """A simulated trunnion on the control, with a simulated tracker on its bed."""

    machine: Machine
    truth: ErrorTables
    pose: RigidTransform
    places: Mapping[str, Array]
    config: SimulationConfig

    @classmethod
    def drawn(cls, machine: Machine, config: SimulationConfig, centre_error: float) -> Cell:
        """Draw errors, place of the tracker and of the nests from the seed.

        Parameters
        ----------
        centre_error : float
            m; standard deviation of the position errors of the rotary axes, in addition.
        """
        rngs = [np.random.default_rng([config.seed, part]) for part in range(4)]
        truth = random_tables(machine, config.error_size, rngs[0])
        location = {
            n: LocationError(v.value + centre_error * float(rngs[3].standard_normal()))
            if n[0] in 'XYZ'
            else v
            for n, v in truth.location.items()
        }
        rotation, place = place_tracker(machine, rngs[1])
        places = {
            n: np.array(t.place) + t.u * rngs[2].standard_normal(3)
            for n, t in machine.targets.items()
        }
        pose = RigidTransform(rotation.T, place)
        return cls(machine, replace(truth, location=location), pose, places, config)

    def recording(self, parts: Sequence[AxisPath], driven: Sequence[DrivenProgram]) -> Recording:
        """What the tracker records of the parts; between two the beam is broken."""
        stamps, points, start = [], [], 0.0
        for number, (part, done) in enumerate(zip(parts, driven, strict=True)):
            first = _start_row(done, part.positions[0])
            target = self.machine.targets[part.target]
            sight = Sight(self.machine, self.machine.tracker.link, target.link,
                          self.places[part.target])  # fmt: skip
            rng = np.random.default_rng([self.config.seed, 10 + number])
            samples = sample_moving_target(
                done.time[first:], exact_position(self.truth, sight, done.motor[first:]),
                self.pose, self.machine, self.config, rng,
            )  # fmt: skip
            stamps.append(samples.stamp_ns + round(1e9 * start))
            points.append(samples.xyz)
            start += float(done.time[-1] - done.time[first]) + BROKEN_BEAM
        track = nominal_track(self.machine, parts)
        return Recording(
            Samples(np.concatenate(stamps), np.concatenate(points)), track, self.machine, 'fit',
            axis_paths=tuple(parts),
        )  # fmt: skip


def _start_row(driven: DrivenProgram, q: Array) -> int:
    """First servo period in which the control stands at the start of a part."""
    at = np.abs(driven.believed - q).max(axis=1) < 1e-5
    if not at.any():
        raise InputError('LinuxCNC: never reached the start of the part')
    return int(np.flatnonzero(at)[0])


# Parts and poses as programs.


def _part_text(machine: Machine, part: PlannedPart, number: int, feed: float) -> str:
    """Program of a part for a machine without an operator."""
    config = PlannerConfig(feed=feed, corner_dwell=0.0, end_dwell=0.0)
    text = part_program(DIALECTS['linuxcnc'], machine, part, number, config, [])
    approach, stop, path = text.partition('\nM0\n')
    return f'{approach.replace(START, QUICK)}{stop}{path}'.replace('\nM0\n', f'\nG4 P{WAIT}\n')


@dataclass(frozen=True)
class Poses:
    """Poses of the tool, as they are programmed.

    Attributes
    ----------
    q : ndarray, shape (n, k), m and rad
        Axis positions that lead there without errors.
    place : ndarray, shape (n, 3), m
        Of the tool in the frame of the workpiece, on the increment of a program.
    """

    q: Array
    place: Array

    @classmethod
    def drawn(cls, machine: Machine, rng: np.random.Generator, count: int = POSES) -> Poses:
        """Draw poses within the ranges of all axes."""
        size = machine.upper - machine.lower
        q = rng.uniform(machine.lower + INNER * size, machine.upper - INNER * size,
                        (count, len(size)))  # fmt: skip
        turning = [machine.column(a) for a in machine.rotary_names]
        q[:, turning] = np.radians(np.degrees(q[:, turning]).round(3))
        return cls(q, nominal_position(machine, q).round(6))


def pose_program(machine: Machine, poses: Poses) -> tuple[str, float]:
    """Program of the poses with the kinematics on, and the time that it takes, s."""
    dialect, turning = DIALECTS['linuxcnc'], machine.rotary_names

    def switch(kinematics: int) -> list[str]:
        # M66 makes the interpreter wait until the positions are those of the new kinematics
        return ['M66 E0 L0', f'M68 E{KINEMATICS_OUTPUT} Q{kinematics}', 'M66 E0 L0']

    first, *modal = dialect.begin_axes(['POSES THAT WERE NOT MEASURED'], 1, True)
    lines = [first, *switch(COUPLED), *modal]
    steps = np.abs(np.diff(poses.q, axis=0, prepend=np.zeros((1, poses.q.shape[1]))))
    fastest = [POSE_RATE if machine.axes[a].rotary else POSE_FEED for a in machine.axis_names]
    seconds = 0.5 + (steps / fastest).max(axis=1)
    for q, place, time in zip(poses.q, poses.place, seconds, strict=True):
        to = dict(zip('XYZ', (1e3 * place).tolist(), strict=True))
        to |= {a: float(np.degrees(q[machine.column(a)])) for a in turning}
        lines += dialect.move_axes(AxisMove(to, {}, (), float(time), 1.0, True), True)
        lines += dialect.dwell(DWELL)
    lines += [*switch(UNCOUPLED), *dialect.end_axes(True)]
    return '\n'.join(lines) + '\n', float(seconds.sum()) + len(seconds) * DWELL


def motors_at_poses(machine: Machine, driven: DrivenProgram, poses: Poses) -> Array:
    """Positions (n, k) of the motors, m and rad, where the control stopped at the poses.

    Raises
    ------
    InputError
        If it did not stop at every pose.
    """
    moving = np.abs(np.diff(driven.believed, axis=0)).max(axis=1) > STANDS
    edges = np.flatnonzero(np.diff(np.concatenate([[True], moving, [True]]).astype(int)))
    stops = [end for start, end in zip(edges[::2], edges[1::2], strict=True)
             if end - start >= STILL][-len(poses.q) :]  # fmt: skip
    turning = [machine.column(a) for a in machine.rotary_names]
    away = np.inf
    if len(stops) == len(poses.q):
        away = np.abs(driven.believed[stops][:, turning] - poses.q[:, turning]).max()
    if away > ANGLE_TOLERANCE:
        raise InputError(
            f'LinuxCNC: stopped {len(stops)} times, not once at each of {len(poses.q)} poses'
        )
    return driven.motor[stops]


def go_round_trunnion(
    machine: Machine,
    parts: Sequence[PlannedPart],
    feed: float,
    config: SimulationConfig,
    centre_error: float,
    progress: Callable[[str], None],
) -> TrunnionCircle:
    """Go round once.

    Parameters
    ----------
    parts : sequence of PlannedPart
        What is measured, on the increment of a program.
    feed : float
        m/s, of the parts.
    config : SimulationConfig
        Its acceleration is that of the control's axes.
    centre_error : float
        m; see ``Cell.drawn``.

    Raises
    ------
    ConfigError
        If LinuxCNC is not installed or has no kinematics for this machine.
    InputError
        If it did not do what was asked, or the calibration is not possible.
    """
    module = check_trunnion(machine)
    cell = Cell.drawn(machine, config, centre_error)
    poses = Poses.drawn(machine, np.random.default_rng([config.seed, 4]))
    text, seconds = pose_program(machine, poses)
    check = Program.of(POSES_FILE, text, seconds)
    jobs = []
    for number, part in enumerate(parts, start=1):
        q = part.path.positions
        time = float(seconds_of_legs(machine, q, feed).sum()) + len(q) * (0.2 + part.dwell)
        program = _part_text(machine, part, number, feed)
        jobs.append(Program.of(f'part_{number}.ngc', program, time))
    total = sum(job.expected for job in (*jobs, check))
    progress(f'LinuxCNC drives {len(jobs)} parts and the poses, {total:.0f} s')
    ini = ini_text(machine, config.acceleration, feed, f'{module} sparm=identityfirst')
    old = trunnion_pins(machine) or {}
    pins = ''.join(f'setp {name} {value:.6f}\n' for name, value in old.items())
    given = written_files(machine, ini, {}, kinematics=module, pins=pins)
    *driven, before = drive(machine, given, [*jobs, check])
    recording = cell.recording([p.path for p in parts], driven)
    progress('calibrates')
    result = calibrate_axes([recording], CalibrationConfig(), silent)
    content = TablesFile(result.tables, {'run_id': result.run_id})
    pivot = export_format('pivot').export(Request(content, PIVOT)).files[PIVOT]
    joints = export_format('linuxcnc').export(Request(content, JOINTS))
    new = pivot_lines(pivot.decode())
    extra = {n: v for n, v in joints.files.items() if n != JOINTS}
    files = written_files(
        machine, insert_piece(ini, joints.files[JOINTS].decode()), extra, kinematics=module,
        pins=new,
    )  # fmt: skip
    progress(f'LinuxCNC drives the poses compensated, {seconds:.0f} s')
    (after,) = drive(machine, files, [check])

    def held(q: Array) -> Array:
        return pins_displacement(result.tables, q) + joints.held(q)

    proof = _proof(cell, poses, (before, after), result, held)
    values = {words[1]: float(words[2]) for words in map(str.split, new.splitlines())}
    changed = {name: (old[name], value) for name, value in values.items()}
    programs = {job.name: job.text.encode() for job in (*jobs, check)}
    return TrunnionCircle(
        proof, result, cell.truth, recording, changed, {**files, PIVOT: pivot, **programs}
    )


def pivot_lines(text: str) -> str:
    """Lines of an exported pivot that go into a HAL file."""
    return ''.join(f'{line}\n' for line in text.splitlines() if line.startswith('setp '))


def _proof(
    cell: Cell,
    poses: Poses,
    driven: tuple[DrivenProgram, DrivenProgram],
    result: AxisCalibration,
    held: Callable[[Array], Array],
) -> PoseProof:
    machine, q, tables = cell.machine, poses.q, result.tables
    sight = Sight.of_tool(machine)
    motors = [motors_at_poses(machine, d, poses) for d in driven]
    errors = [exact_position(cell.truth, sight, m) - poses.place for m in motors]

    def rest(error: Array) -> Array:
        return np.asarray(np.linalg.norm(without_rigid_motion(error, poses.place), axis=1))

    own, truth = displacement(tables, q), displacement(cell.truth, q)
    known = {'covariance': pack_covariance(result.made.covariance, machine)}
    u = predict(TablesFile(tables, known), q).u
    of_export = mean_length(without_rigid_motion(own - held(q), poses.place))
    sizes = [rest(error) for error in errors]
    turning = [machine.column(a) for a in machine.rotary_names]
    return PoseProof(
        before=float(sizes[0].mean()),
        after=float(sizes[1].mean()),
        forecast=float(np.hypot(of_export, np.mean(np.linalg.norm(u, axis=1)))),
        of_tables=float(rest(truth - own).mean()),
        of_export=of_export,
        of_control=float(rest(errors[1] - (truth - held(q))).mean()),
        places=poses.place,
        angles=q[:, turning],
        error_before=sizes[0],
        error_after=sizes[1],
        lost=max(d.lost for d in driven),
    )
