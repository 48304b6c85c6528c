# SPDX-License-Identifier: Apache-2.0
"""Driver against an emulated tracker with every fault at once: stamps, recovery times, tables.

The tracker is a process of its own that goes before all others, where that is allowed: a real one
has a processor to itself, however busy the computer of the driver is. The tables are compared with
those from the points that the machine passed in the same time, with true stamps and no fault.

Usage: python3 bench/tracker_faults.py [MINUTES [SEED]]     (eval "$(./otf env)" before)
"""

import contextlib
import multiprocessing
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'tests'))
from cells import MACHINE
from emulated import DRIFT, emulator
from emulator import Cell

from otf_core.calibration.calibrate import calibrate
from otf_core.config import PlannerConfig
from otf_core.model.chain import displacement, exact_position
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.machine import machine_from_dict
from otf_core.model.observation import Samples
from otf_core.planning.path_creation import plan_path
from otf_tracker_driver.backends import CommonConfig
from otf_tracker_driver.backends.base import join_samples
from otf_tracker_driver.backends.emscon import Emscon, EmsconConfig

FAULTS = (
    'beam_loss=0.01,beam_out=0.5,split=0.5,merge=0.5,close_after=61,busy=0.1,speed_warning=0.02,'
    'speed_exceeded=0.02,unknown=0.02,clock_jump=0.001,silent=0.002,foreign=0.003,late=0.02'
)


def planned(minutes):
    """Machine and path; never standing for long: the points tell when they were measured."""
    return machine_from_dict(MACHINE), PlannerConfig(passes=max(1, round(minutes / 2)))


def track(pipe, minutes, seed):
    """Be the tracker: tell the port, serve until samples come, and say how far they are off."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    with emulator(FAULTS, seed, Cell(*planned(minutes), seed, DRIFT)) as running:
        pipe.send(running.port)
        pipe.send(running.error_ms(pipe.recv()))


@contextlib.contextmanager
def tracker(minutes, seed):
    """Run the tracker; the pipe takes samples, and gives their errors in ms."""
    ours, its = multiprocessing.Pipe()
    process = multiprocessing.Process(target=track, args=(its, minutes, seed))
    process.start()
    try:
        yield ours
    finally:
        process.join()


def left(samples, cell, path):
    """Mean error on a grid without compensation, and what tables from these samples leave, um."""
    machine = cell.truth.machine
    q = lattice(machine)
    before = exact_position(cell.truth, q) - q
    after = before - displacement(calibrate(samples, path, machine).tables, q)
    return [1e6 * mean_length(without_rigid_motion(field, q)) for field in (before, after)]


def tables(samples, minutes, seed):
    """Print the errors that tables leave, with and without faults."""
    machine, planning = planned(minutes)
    cell, path = Cell(machine, planning, seed, DRIFT), plan_path(machine, planning).path
    step = round(1e3 * EmsconConfig().interval)
    tick = np.arange(0, min(cell.ticks, round(60e3 * minutes)), step)
    undisturbed = Samples(10**9 + tick * 10**6, cell.at(tick))
    for name, given in (('with faults', samples), ('without', undisturbed)):
        before, after = left(given, cell, path)
        print(f'{name}, {len(given)} samples: mean error {before:.2f} um, left {after:.3f} um')


def main(minutes=10.0, seed=1):
    """Run and print."""
    with tracker(minutes, seed) as pipe:
        backend = Emscon(CommonConfig(), EmsconConfig(port=pipe.recv()))
        backend.connect()
        backend.start()
        parts, pauses, last, said = [], [], time.monotonic(), set()
        end = last + 60 * minutes
        while time.monotonic() < end:
            part, now = backend.poll(), time.monotonic()
            if backend.trouble:
                said.add(backend.trouble.partition(';')[0])
            if len(part):
                if now - last > 1.0:
                    pauses.append(now - last)
                last = now
                parts.append(part)
            time.sleep(0.005)
        state = backend.health
        backend.stop()
        samples = join_samples(parts)
        backend.disconnect()
        pipe.send(samples)
        off = np.abs(pipe.recv())
    print(f'{len(samples)} samples; increasing: {bool(np.all(np.diff(samples.stamp_ns) > 0))}')
    print('stamps off the truth, ms, median 95 % 99 % worst:',
          np.percentile(off, [50, 95, 99, 100]).round(2))  # fmt: skip
    print(f'within 1 ms: {100 * np.mean(off < 1):.1f} % of {len(off)}')
    print(
        'pauses of the samples above 1 s:',
        len(pauses),
        'longest',
        np.round(max(pauses), 2),
        's;',
        f'load {os.getloadavg()[0]:.0f}',
    )
    print(replace(state, gaps=state.gaps[-1:]))
    print('\n'.join(sorted(said)))
    tables(samples, minutes, seed)


if __name__ == '__main__':
    main(*map(float, sys.argv[1:2]), *map(int, sys.argv[2:3]))
