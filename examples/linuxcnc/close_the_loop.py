# SPDX-License-Identifier: Apache-2.0
"""Close the loop on a real control: drive, measure, calibrate, compensate, drive again.

LinuxCNC executes the NC program of the planner without a screen and without hardware, at 1 kHz,
with its own acceleration, stops and compensation. A simulated machine with errors follows its
motors, and a simulated tracker with its own clock and noise measures it. The tables of the
calibration go into the control as exported, and both programs are driven once more: the path that
was measured, and lines that were not.

python examples/linuxcnc/close_the_loop.py --out DIR [--seed N] [--most-left SHARE]

Needed: Linux and LinuxCNC 2.9 (Debian 12 or later: sudo apt-get install -y
--no-install-recommends linuxcnc-uspace). It takes five minutes, most of it motion. Exit code 1:
more than the stated share of the error is left on the lines that were not measured.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from configparser import ConfigParser
from dataclasses import dataclass, replace
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray

import otf_core

Array = NDArray[np.float64]

HERE = Path(__file__).resolve().parent
FEED, ACCELERATION = 0.4, 5.0
"""m/s and m/s^2."""
SERVO_PERIOD = 1e-3
"""s"""
MARGIN = 0.01
"""m; the soft limits of the control lie this far beyond the axis ranges."""
RATE, DRIFT = 500.0, 1.8e-5
"""Samples of the tracker per second of its clock, and by how much this clock runs fast."""
SCREWS = {'EXX': 150e-6, 'EYY': -120e-6, 'EZZ': 100e-6}
"""m/m; the ball screws have another pitch than the control believes."""
OTHER_ERRORS = 3e-6
"""m; mean volumetric error from everything else; compensation of axes takes little of it off."""


# 1. The control: its configuration, its run, and what it did.

LOCK = Path('/tmp/linuxcnc.lock')
OTHER_USER = 'nobody'
"""LinuxCNC refuses to run as root; this user then runs it."""


class ControlError(Exception):
    """LinuxCNC is missing, or did not do what was asked."""


@dataclass(frozen=True)
class Drive:
    """What the control did in a program, a row per servo period.

    Attributes
    ----------
    motor : ndarray, shape (n, 3), m
        Positions of the motors, compensation in them.
    believed : ndarray, shape (n, 3), m
        Where the control believes the axes to be.
    """

    motor: Array
    believed: Array


def configuration(machine: otf_core.Machine, compensation: Mapping[str, str]) -> str:
    """INI file of the control.

    Parameters
    ----------
    compensation : mapping of file name to text
        As exported: an .ini piece that names a .comp file per joint; empty without compensation.
    """
    piece = ConfigParser()
    piece.optionxform = str.upper  # type: ignore[assignment, method-assign]
    for name, text in compensation.items():
        if name.endswith('.ini'):
            piece.read_string(text)
    numbers = {
        'velocity': f'{1e3 * 2 * FEED:.3f}',
        'acceleration': f'{1e3 * ACCELERATION:.3f}',
    }
    parts = [Template((HERE / 'otf.ini').read_text()).substitute(numbers)]
    axis = Template((HERE / 'axis.ini').read_text())
    for joint, letter in enumerate('XYZ'):
        section = f'JOINT_{joint}'
        own = piece.items(section) if piece.has_section(section) else []
        low, high = min(machine.lower[joint], 0.0), max(machine.upper[joint], 0.0)  # home is at 0
        parts.append(
            axis.substitute(
                numbers,
                axis=letter,
                joint=joint,
                low=f'{1e3 * (low - MARGIN):.3f}',
                high=f'{1e3 * (high + MARGIN):.3f}',
                compensation='\n'.join(f'{key} = {value}' for key, value in own),
            )
        )
    return ''.join(parts)


def find_control() -> str:
    """Path of LinuxCNC; ControlError says how to get it, or that it runs already."""
    program = shutil.which('linuxcnc')
    if program is None:
        raise ControlError(
            'LinuxCNC is not installed; on Debian 12 or later: sudo apt-get update && '
            'sudo apt-get install -y --no-install-recommends linuxcnc-uspace'
        )
    if LOCK.exists():
        raise ControlError(
            f'{LOCK}: LinuxCNC runs on this computer already, and two would end each other; '
            f'stop it, or remove the file if none is running'
        )
    return program


def drive(files: Mapping[str, str], seconds: float) -> dict[str, Drive]:
    """Run LinuxCNC: it drives every program, and ends.

    Parameters
    ----------
    files : mapping of file name to text
        INI, HAL, compensation, operator and programs (NAME.ngc).
    seconds : float
        LinuxCNC is ended if it takes longer.

    Returns
    -------
    dict of NAME to Drive
    """
    user = OTHER_USER if os.geteuid() == 0 else None
    with tempfile.TemporaryDirectory(prefix='otf-linuxcnc-') as name:
        folder = Path(name)
        for file, text in files.items():
            (folder / file).write_text(text)
            (folder / file).chmod(0o755 if file.endswith('.py') else 0o644)
        if user:
            for path in (folder, *folder.iterdir()):
                shutil.chown(path, user)
        log, outcome = folder / 'linuxcnc.log', folder / 'outcome.txt'
        with open(log, 'wb') as out:
            control = subprocess.Popen(
                [find_control(), '-r', folder / 'otf.ini'], cwd=folder, user=user,
                stdin=subprocess.DEVNULL, stdout=out, stderr=out, start_new_session=True,
                env={'PATH': os.environ['PATH'], 'HOME': name},
            )  # fmt: skip
            try:
                control.wait(seconds)
            except subprocess.TimeoutExpired:
                pass  # outcome.txt is missing then
            finally:
                end(control)
        if not outcome.exists():
            said = log.read_text(errors='replace')[-1000:]
            raise ControlError(f'LinuxCNC did not start, or not end in time; it said:\n{said}')
        if outcome.read_text() != 'done':
            raise ControlError(f'LinuxCNC: {outcome.read_text()}')
        return {file.stem: read_samples(file.with_suffix('.txt')) for file in folder.glob('*.ngc')}


def end(control: subprocess.Popen[bytes]) -> None:
    """End LinuxCNC by its own clean-up, or by force where that takes long."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if control.poll() is None:
            os.killpg(control.pid, number)
            try:
                control.wait(30)
            except subprocess.TimeoutExpired:
                continue


def read_samples(file: Path) -> Drive:
    """Read what halsampler printed: number of the sample, then its values in mm."""
    table = np.loadtxt(file, ndmin=2, comments='overrun')  # before a second program
    lost = int(table[-1, 0] - table[0, 0]) + 1 - len(table) if len(table) else 0
    if len(table) < 2 or lost:
        raise ControlError(
            f'{file.stem}: {len(table)} servo periods were sampled and {lost} lost; '
            f'the computer is too busy'
        )
    return Drive(1e-3 * table[:, 1:4], 1e-3 * table[:, 4:7])


# 2. The machine and the tracker, which are simulated.


@dataclass(frozen=True)
class Cell:
    """A machine with errors, and a tracker in front of it."""

    machine: otf_core.Machine
    truth: otf_core.ErrorTables
    rotation: Array
    place: Array
    rng: np.random.Generator

    @classmethod
    def drawn(cls, machine: otf_core.Machine, seed: int) -> Cell:
        """Draw the errors and the pose of the tracker, and set the pitch of the screws."""
        config = otf_core.SimulationConfig(error_size=OTHER_ERRORS, rate=10.0)
        run = otf_core.simulate(machine, seed=seed, config=config)
        motions = dict(run.truth.motions)
        for name, pitch in SCREWS.items():
            table = motions[name]
            motions[name] = replace(table, value=table.value + pitch * table.position)
        pose = run.T_machine_tracker
        return cls(
            machine, replace(run.truth, motions=motions), pose.rotation, pose.translation,
            np.random.default_rng([seed, 1]),
        )  # fmt: skip

    def actual(self, motor: Array) -> Array:
        """Where the target is when the motors stand at these positions."""
        return motor + otf_core.predict(self.truth, motor).error

    def measured(self, driven: Drive, path: otf_core.NominalPath, name: str) -> otf_core.Recording:
        """What the tracker records of a drive: times of its own clock, noise along and across."""
        step = 1.0 / (RATE * (1.0 + DRIFT))
        time = SERVO_PERIOD * np.arange(len(driven.motor))
        moments = np.arange(step * self.rng.uniform(), time[-1], step)
        motor = np.stack([np.interp(moments, time, driven.motor[:, k]) for k in range(3)], axis=1)
        seen = (self.actual(motor) - self.place) @ self.rotation
        distance = np.linalg.norm(seen, axis=1, keepdims=True)
        beam, spec = seen / distance, self.machine.tracker
        noise = spec.u_angle * distance * self.rng.standard_normal(seen.shape)
        noise -= np.sum(noise * beam, axis=1, keepdims=True) * beam
        noise += spec.u_range * self.rng.standard_normal(distance.shape) * beam
        stamps = 1_000_000_000 + np.rint(1e9 / RATE * np.arange(len(moments))).astype(np.int64)
        return otf_core.Recording(otf_core.Samples(stamps, seen + noise), path, self.machine, name)

    def error(self, driven: Drive) -> float:
        """Mean volumetric error at every millimetre of a drive, best rigid motion removed, m."""
        steps = np.linalg.norm(np.diff(driven.believed, axis=0), axis=1)
        reach = np.concatenate([[0.0], np.cumsum(steps)])
        rows = np.searchsorted(reach, np.arange(1e-3, reach[-1], 1e-3))
        nominal = driven.believed[rows]
        return mean_length(self.actual(driven.motor[rows]) - nominal, nominal)


def mean_length(error: Array, q: Array) -> float:
    """Mean length of errors (n, 3) at positions (n, 3), best rigid motion removed, m."""
    return float(np.linalg.norm(otf_core.without_rigid_motion(error, q), axis=1).mean())


# 3. The loop.


def export(tables: Path, out: Path) -> tuple[dict[str, str], float]:
    """Export tables for LinuxCNC: files by name, and the error that they leave, m."""
    command = [sys.executable, '-m', 'otf_core.cli', 'export', str(tables), '--format', 'linuxcnc',
               '--out', str(out / 'compensation.ini'), '--json']  # fmt: skip
    told = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    files = {Path(name).name: Path(name).read_text() for name in told['files']}
    return files, 1e-6 * told['remaining']['after_mean_um']


def close_the_loop(machine: otf_core.Machine, out: Path, seed: int) -> tuple[float, float]:
    """Go round once; return the true error before and after on lines that were not measured."""
    cell = Cell.drawn(machine, seed)
    planner = otf_core.PlannerConfig(passes=1, feed=FEED, corner_dwell=0.05, end_dwell=2.0)
    size = machine.upper - machine.lower
    corners = machine.lower + size * cell.rng.uniform(0.03, 0.97, (13, 3))
    plans = {
        'measured': otf_core.plan(machine, config=planner),
        'other': otf_core.plan(machine, corners.round(6), config=planner),
    }
    files = {name: (HERE / name).read_text() for name in ('otf.hal', 'operate.py')}
    files['tool.tbl'] = ''
    for name, report in plans.items():
        otf_core.write_plan(report, out / name, dialect='linuxcnc')
        files[f'{name}.ngc'] = (out / name / 'otf_path_1.ngc').read_text()
    path = plans['measured'].plan.path
    seconds = 60.0 + 3.0 * sum(report.forecast.duration for report in plans.values())
    grid = np.stack(np.meshgrid(*np.linspace(machine.lower, machine.upper, 7).T), -1).reshape(
        -1, 3
    )

    compensation: dict[str, str] = {}
    true: list[float] = []
    found: list[float] = []
    for step in ('before', 'after'):
        print(f'LinuxCNC drives, {step} compensation')
        ini = configuration(machine, compensation)
        driven = drive({**files, **compensation, 'otf.ini': ini}, seconds)
        true.append(cell.error(driven['other']))
        bag = out / step / 'bag'
        otf_core.write_bag(cell.measured(driven['measured'], path, step), bag)
        result = otf_core.calibrate(otf_core.read_bag(bag, machine))
        if result.failed_gates:
            raise otf_core.InputError('; '.join(result.failed_gates))
        otf_core.write_calibration(result, out / step / 'tables')
        found.append(mean_length(otf_core.predict(result, grid).error, grid))
        if step == 'before':
            compensation, forecast = export(out / step / 'tables', out)
            print(f'written: {", ".join(compensation)}')

    um = [f'{1e6 * value:8.2f} um' for value in (*found, *true, forecast)]
    print('mean volumetric error, best rigid motion removed         before        after')
    print(f'calibrated, in the whole volume                   {um[0]}  {um[1]}')
    print(f'true, on lines that were not measured             {um[2]}  {um[3]}')
    print(f'forecast of the export, in the whole volume                     {um[4]}')
    return true[0], true[1]


def main() -> int:
    """Read the command line; the exit code."""
    options = argparse.ArgumentParser(description='Close the loop on LinuxCNC.')
    options.add_argument('--out', type=Path, required=True, help='new folder for all that is made')
    options.add_argument('--machine', type=Path, default=HERE / 'machine.yaml')
    options.add_argument('--seed', type=int, default=1, help='of the errors and the tracker')
    options.add_argument('--most-left', type=float, default=0.25, help='share; more: exit code 1')
    given = options.parse_args()
    if given.out.exists():
        options.error(f'--out: {given.out} exists already; name a new folder')
    try:
        find_control()
        given.out.mkdir(parents=True)
        before, after = close_the_loop(otf_core.load_machine(given.machine), given.out, given.seed)
    except (ControlError, otf_core.OtfError, OSError) as error:
        print(f'close_the_loop: {error}', file=sys.stderr)
        return 2
    good = after <= given.most_left * before
    print(f'{100 * after / before:.1f} % left, at most {100 * given.most_left:.0f} %: '
          f'{"good" if good else "NOT GOOD"}')  # fmt: skip
    return 0 if good else 1


if __name__ == '__main__':
    sys.exit(main())
