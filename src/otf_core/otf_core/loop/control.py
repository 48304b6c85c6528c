# SPDX-License-Identifier: Apache-2.0
"""Runs LinuxCNC without a screen and returns the motor positions of every servo period."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError, InputError
from otf_core.model.axis_path import LEVER
from otf_core.model.machine import Machine

# Configuration of LinuxCNC for a machine without a screen: INI, HAL, tool table.
#
# Source: LinuxCNC 2.9, ``docs/src/config/ini-config.adoc``, ``docs/src/man/man9/motion.9``,
# ``sampler.9`` and ``docs/src/motion/external-offsets.adoc``. Lengths are in mm there.
#
# The motors follow their commands at once: ``motor-pos-cmd`` is fed back and sampled every servo
# period, with what the control believes (``pos-cmd``) and the external offsets in it.
#
# A trunnion starts with its axes uncoupled; the analog output ``KINEMATICS_OUTPUT`` of a program
# (M68) switches its kinematics (``switchkins.adoc``), tool length from the tool table.

SERVO_PERIOD = 1e-3
"""s"""
SAMPLER_DEPTH = 20_000
"""Rows that wait for the reader; 20 s."""
MARGIN = 0.01
"""m; soft limits lie this far beyond the axis ranges, and hold the home position 0."""
OFFSET_SHARE = 0.1
"""Share of speed and acceleration that external offsets may take (OFFSET_AV_RATIO)."""
COUNT = 1e-8
"""m; one count of an external offset."""
FREE_TRAVEL = 1.0
"""m; more of soft limits where the linear axes follow turning tables."""
ENDLESS = 1e5
"""Degrees; soft limits of endless axes."""
KINEMATICS_OUTPUT, UNCOUPLED, COUPLED = 3, 0, 1
"""Analog output that switches the kinematics of a trunnion, and its values."""
TOOL_TABLE = 'tool.tbl'
INI, HAL, OPERATOR, VOLUME = 'otf.ini', 'otf.hal', 'operate.py', 'offsets.py'
LATTICE, SAMPLES = 'lattice.csv', 'samples.txt'


def axis_units(machine: Machine) -> Array:
    """Units of the control per unit of every axis, shape (k,): mm per m, degrees per rad."""
    rotary = [machine.axes[a].rotary for a in machine.axis_names]
    return np.where(rotary, np.degrees(1.0), 1e3)


def ini_text(
    machine: Machine, acceleration: float, feed: float, kinematics: str = 'trivkins'
) -> str:
    """INI file.

    Parameters
    ----------
    acceleration : float
        m/s^2, of every axis; of rotary axes on the radius that they count as.
    feed : float
        m/s, largest of the programs; the same.
    kinematics : str
        Module, with its parameters but the axes.
    """
    speed, rate = 1e3 * 2.0 * feed, 1e3 * acceleration
    letters = machine.axis_names
    lines = [
        '[EMC]', 'VERSION = 1.1', 'MACHINE = otf', 'DEBUG = 0',
        '[DISPLAY]', f'DISPLAY = ./{OPERATOR}',
        '[TASK]', 'TASK = milltask', 'CYCLE_TIME = 0.005',
        '[RS274NGC]', 'PARAMETER_FILE = sim.var',
        '[EMCMOT]', 'EMCMOT = motmod', 'COMM_TIMEOUT = 1.0',
        f'SERVO_PERIOD = {1e9 * SERVO_PERIOD:.0f}',
        '[EMCIO]', 'EMCIO = io', 'CYCLE_TIME = 0.1', f'TOOL_TABLE = {TOOL_TABLE}',
        '[HAL]', f'HALFILE = {HAL}',
        '[TRAJ]', f'COORDINATES = {" ".join(letters)}',
        'LINEAR_UNITS = mm', 'ANGULAR_UNITS = degree',
        f'DEFAULT_LINEAR_VELOCITY = {speed:.3f}', f'MAX_LINEAR_VELOCITY = {speed:.3f}',
        f'DEFAULT_LINEAR_ACCELERATION = {rate:.3f}', f'MAX_LINEAR_ACCELERATION = {rate:.3f}',
        '[KINS]', f'KINEMATICS = {kinematics} coordinates={"".join(letters).lower()}',
        f'JOINTS = {len(letters)}',
    ]  # fmt: skip
    for k, axis in enumerate(letters):
        rotary = machine.axes[axis].rotary
        unit = np.degrees(1.0) / LEVER if rotary else 1e3
        margin = FREE_TRAVEL if machine.rotary_names else MARGIN
        low, high = axis_units(machine)[k] * np.array([machine.lower[k], machine.upper[k]])
        low, high = min(float(low), 0.0) - 1e3 * margin, max(float(high), 0.0) + 1e3 * margin
        if machine.axes[axis].endless:
            low, high = -ENDLESS, ENDLESS
        limits = [
            f'MIN_LIMIT = {low:.3f}', f'MAX_LIMIT = {high:.3f}',
            f'MAX_VELOCITY = {2.0 * feed * unit / (1 - OFFSET_SHARE):.3f}',
            f'MAX_ACCELERATION = {acceleration * unit / (1 - OFFSET_SHARE):.3f}',
        ]  # fmt: skip
        lines += [f'[AXIS_{axis}]', *limits]
        lines += [] if machine.rotary_names else [f'OFFSET_AV_RATIO = {OFFSET_SHARE}']
        lines += [
            f'[JOINT_{k}]', f'TYPE = {"ANGULAR" if rotary else "LINEAR"}', *limits,
            'HOME = 0', 'HOME_OFFSET = 0',
            'HOME_SEARCH_VEL = 0', 'HOME_LATCH_VEL = 0', 'HOME_SEQUENCE = 0',
            'FERROR = 1000', 'MIN_FERROR = 1000',
        ]  # fmt: skip
    return '\n'.join(lines) + '\n'


def insert_piece(ini: str, piece: str) -> str:
    """Put the lines of an INI piece into its sections: a section that comes twice counts once."""
    lines, at = ini.splitlines(), 0
    for line in piece.splitlines():
        if line.startswith('['):
            at = lines.index(line) + 1
        elif line and not line.startswith('#'):
            lines.insert(at, line)
    return '\n'.join(lines) + '\n'


def hal_text(machine: Machine, volume: bool, kinematics: str = '') -> str:
    """HAL file: motors that follow at once, the sampler, and the component of the volume.

    Parameters
    ----------
    kinematics : str
        Module of a trunnion, if it is one.
    """
    letters = [a.lower() for a in machine.axis_names]
    count = len(letters)
    lines = [
        'loadrt [KINS]KINEMATICS',
        'loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS',
        f'loadrt sampler depth={SAMPLER_DEPTH} cfg={"f" * 3 * count}',
        'addf motion-command-handler servo-thread',
        'addf motion-controller servo-thread',
        'addf sampler.0 servo-thread',
        'net enable iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in',
        'net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared',
        'net change iocontrol.0.tool-change => iocontrol.0.tool-changed',
    ]
    if kinematics:
        lines += [
            f'net kinematics motion.analog-out-{KINEMATICS_OUTPUT:02d} => motion.switchkins-type',
            f'net length motion.tooloffset.z => {kinematics}.tool-offset',
        ]
    if volume:
        lines.append(f'loadusr -Wn otf-volume /usr/bin/python3 ./{VOLUME} {LATTICE}')
        lines.append('net fault otf-volume.fault => motion.feed-hold')
    for k, letter in enumerate(letters):
        ends = (f' otf-volume.believed-{letter}', f' otf-volume.offset-{letter}')
        believed, offset = ends if volume else ('', '')
        pins = [f'sampler.0.pin.{k + row * count}' for row in range(3)]
        lines += [
            f'net motor{k} joint.{k}.motor-pos-cmd => joint.{k}.motor-pos-fb {pins[0]}',
            f'net believed{k} joint.{k}.pos-cmd => {pins[1]}{believed}',
            f'net offset{k} axis.{letter}.eoffset => {pins[2]}{offset}',
        ]
        if volume:
            lines += [
                f'setp axis.{letter}.eoffset-scale {1e3 * COUNT:.9f}',
                f'net wanted{k} otf-volume.counts-{letter} => axis.{letter}.eoffset-counts',
                f'net on{k} otf-volume.on-{letter} => axis.{letter}.eoffset-enable',
            ]
    return '\n'.join(lines) + '\n'


def believed_positions(samples: np.ndarray, units: Array) -> tuple[Array, Array, Array]:
    """Take sampled rows apart.

    Parameters
    ----------
    samples : ndarray, shape (n, 3 k), mm and degrees
        Motor positions, commanded positions, external offsets.
    units : ndarray, shape (k,)
        See ``axis_units``.

    Returns
    -------
    motor, believed, offset : ndarray, shape (n, k), m and rad
        Where the motors are, where the control believes the axes to be, offset in the motors.
    """
    motor, commanded, offset = np.moveaxis(samples.reshape(len(samples), 3, -1) / units, 1, 0)
    return motor, commanded - offset, offset


def written_files(
    machine: Machine,
    ini: str,
    extra: Mapping[str, bytes],
    volume: bool = False,
    kinematics: str = '',
    pins: str = '',
) -> dict[str, bytes]:
    """All files of a run of the control but programs and scripts, by name.

    Parameters
    ----------
    pins : str
        Lines for the end of the HAL file.
    """
    length = -1e3 * float(machine.target_offset[2])
    tool = f'T1 P1 Z{length:.6f}\n' if kinematics else ''
    hal = hal_text(machine, volume, kinematics) + pins
    texts = {INI: ini, HAL: hal, TOOL_TABLE: tool}
    return {name: text.encode() for name, text in texts.items()} | dict(extra)


# Runs LinuxCNC for a few programs and returns the motor positions of every servo period.
#
# It refuses to run as root: then it runs as the user nobody, in a folder of its own that is gone
# afterwards. Two at a time on one computer would end each other: the second is refused.

COMMAND = 'linuxcnc'
LOCK = Path('/tmp/linuxcnc.lock')
OTHER_USER = 'nobody'
SHEBANG = b'#!/usr/bin/python3\n'
"""Python of the system, where the modules of LinuxCNC are."""
START_TIME, END_TIME = 40.0, 30.0
"""s; start and end of LinuxCNC on a busy computer."""


class ControlMissing(ConfigError):
    """LinuxCNC is not installed."""


SPARE, APPROACH = 3.0, 20.0
"""A program counts as stuck after so many times the time it takes, and s for what lies before."""


@dataclass(frozen=True)
class Program:
    """A program to drive: file name, text, and the longest time it may take, s."""

    name: str
    text: str
    seconds: float

    @classmethod
    def of(cls, name: str, text: str, expected: float) -> Program:
        """A program that takes about ``expected`` s."""
        return cls(name, text, SPARE * expected + APPROACH)

    @property
    def expected(self) -> float:
        """Time that it is expected to take, s."""
        return (self.seconds - APPROACH) / SPARE


@dataclass(frozen=True)
class DrivenProgram:
    """What the control did in one program, a row per servo period.

    Attributes
    ----------
    time : ndarray, shape (n,), s
        In servo periods of the control; no other clock knows it.
    motor : ndarray, shape (n, k), m and rad
        Positions of the motors, compensation in them.
    believed : ndarray, shape (n, k), m and rad
        Where the control believes the axes to be.
    offset : ndarray, shape (n, k), m and rad
        External offsets in the motor positions.
    lost : int
        Servo periods that the sampler lost.
    """

    time: Array
    motor: Array
    believed: Array
    offset: Array
    lost: int


def _account(name: str) -> Any:
    """Entry of a user in the password database."""
    import pwd  # no other system has it, and find_control refuses there

    return pwd.getpwnam(name)


def find_control() -> str:
    """Return the path of LinuxCNC.

    Raises
    ------
    ControlMissing
        Says how to get it.
    """
    program = shutil.which(COMMAND)
    if program is None or shutil.which('halsampler') is None:
        raise ControlMissing(
            'LinuxCNC is not installed; on Debian 12 or later: sudo apt-get update && '
            'sudo apt-get install -y --no-install-recommends linuxcnc-uspace '
            '(other systems: linuxcnc.org/downloads), then run this again'
        )
    if LOCK.exists():
        raise ConfigError(
            f'{LOCK}: LinuxCNC runs on this computer already, and two would terminate each '
            f'other; stop it, or remove the file if none is running'
        )
    return program


def trunnion_module(name: str, *, conventional: bool) -> None:
    """Check that a kinematics module can do what a machine needs.

    Parameters
    ----------
    conventional : bool
        It needs the pin that turns the tables left-handed.

    Raises
    ------
    ConfigError
        If the installed module has no such pin.
    """
    module = Path(find_control()).parent.parent / 'lib' / 'linuxcnc' / 'modules' / f'{name}.so'
    if not module.exists():
        return  # installed elsewhere: LinuxCNC itself says what it lacks
    if conventional and b'conventional-directions' not in module.read_bytes():
        raise ConfigError(
            f'{module}: this LinuxCNC turns tables right-handed only; install a later one, or '
            f'give the rotary axes the directions (0, 0, -1) and (-1, 0, 0) or (0, -1, 0)'
        )


@contextmanager
def _workplace() -> Iterator[tuple[Path, str | None]]:
    """A folder that the user of LinuxCNC owns, and that user if it is another one."""
    other = OTHER_USER if os.geteuid() == 0 else None
    with tempfile.TemporaryDirectory(prefix='otf-loop-') as name:
        folder = Path(name)
        if other is not None:
            user = _account(other)
            os.chown(folder, user.pw_uid, user.pw_gid)
        yield folder, other


def _place_files(folder: Path, files: Mapping[str, bytes], user: str | None) -> None:
    here = Path(__file__).parent
    scripts = {name: SHEBANG + (here / name).read_bytes() for name in (OPERATOR, VOLUME)}
    for name, content in {**files, **scripts}.items():
        path = folder / name
        path.write_bytes(content)
        path.chmod(0o755 if name in scripts else 0o644)
        if user is not None:
            entry = _account(user)
            os.chown(path, entry.pw_uid, entry.pw_gid)


def drive(
    machine: Machine, files: Mapping[str, bytes], programs: Sequence[Program]
) -> list[DrivenProgram]:
    """Start LinuxCNC, drive programs one after the other, end it.

    Parameters
    ----------
    files : mapping of file name to bytes
        INI, HAL and what they name.

    Raises
    ------
    ControlMissing
        If LinuxCNC is not installed.
    InputError
        If it did not do what was asked; holds what it said.
    """
    command = find_control()
    order = [
        {'program': p.name, 'samples': f'{Path(p.name).stem}.txt', 'seconds': p.seconds}
        for p in programs
    ]
    with _workplace() as (folder, user):
        content = {p.name: p.text.encode() for p in programs}
        content['order.json'] = json.dumps(order).encode()
        _place_files(folder, {**files, **content}, user)
        assert INI in files and HAL in files
        limit = START_TIME + END_TIME + sum(p.seconds for p in programs)
        output = _run([command, str(folder / INI)], folder, user, limit)
        _check(folder, output)
        units = axis_units(machine)
        return [_read_samples(folder / str(item['samples']), units) for item in order]


def _run(command: list[str], folder: Path, user: str | None, limit: float) -> str:
    """Run LinuxCNC to its end in a process group of its own; return what it printed."""
    environment = {k: v for k, v in os.environ.items() if k in ('PATH', 'LANG', 'LC_ALL')}
    log = folder / 'linuxcnc.log'
    with open(log, 'wb') as out:
        process = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=out,
            env={**environment, 'HOME': str(folder)}, user=user,
            group=None if user is None else _account(user).pw_gid,
            extra_groups=None if user is None else [], start_new_session=True,
        )  # fmt: skip
        try:
            process.wait(limit)
        except subprocess.TimeoutExpired:
            pass
        finally:
            _end(process, user)
    return log.read_text(errors='replace')


def _end(process: subprocess.Popen[bytes], user: str | None) -> None:
    """End LinuxCNC by its own clean-up; by force, its real-time part too, if that takes long."""
    if process.poll() is not None:
        return
    os.killpg(process.pid, signal.SIGTERM)
    try:
        process.wait(END_TIME)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        subprocess.run(['halrun', '-U'], user=user, check=False, capture_output=True)
        LOCK.unlink(missing_ok=True)


def _check(folder: Path, said: str) -> None:
    """InputError if the operator did not come to a good end."""
    report = folder / 'told.json'
    problem = 'did not start or did not end in time'
    if report.exists():
        problem = json.loads(report.read_text())['error']
    if problem:
        last = ' | '.join(line for line in said.splitlines() if line.strip())[-1500:]
        raise InputError(f'LinuxCNC: {problem}; its last output: {last}')


def _read_samples(path: Path, units: Array) -> DrivenProgram:
    """Read what halsampler printed: number of the sample and its values, mm and degrees."""
    columns = 1 + 3 * len(units)
    lines = [line.split() for line in path.read_text().splitlines()]
    table = np.array([words for words in lines if len(words) == columns], dtype=float)
    if len(table) < 2:
        raise InputError('LinuxCNC: the sampler returned nothing')
    gaps = np.flatnonzero(np.diff(table[:, 0]) != 1)
    if len(gaps) and gaps[0] <= SAMPLER_DEPTH:
        table = table[gaps[0] + 1 :]  # what stood in the queue since before the program
    number = table[:, 0] - table[0, 0]
    motor, believed, offset = believed_positions(table[:, 1:], units)
    return DrivenProgram(
        SERVO_PERIOD * number, motor, believed, offset, int(number[-1]) + 1 - len(number)
    )
