# SPDX-License-Identifier: Apache-2.0
"""Half a million samples from bag to error tables, against rosbags deserialising the same bag.

One simulated run of four laps, 500 samples per second. Timed, shortest of three, all warm:
``read_bag``; read, calibrate and write all files; the whole command with start-up of Python; and
for comparison rosbags' AnyReader, which only turns the same bag into message objects and arrays.
Wall time, and processor time, which depends less on what else the machine does.

Usage: PYTHONPATH=src/otf_core python bench/calibrate_speed.py [LAPS]
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bag_speed import REPEATS, read_with_rosbags

from otf_core.bags.bag import BagContent, read_bag, write_bag
from otf_core.calibration.calibrate import calibrate
from otf_core.calibration.result import CalibrationResult
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.files.writing import write_text
from otf_core.model.machine import load_machine
from otf_core.planning.creator import plan_path
from otf_core.reports.calibration import write_calibration
from otf_core.sim.cell import simulate

SEED = 20_260_011
MACHINE = Path(__file__).parent.parent / 'src/otf_bringup/config/machine.yaml'


def processor_time() -> float:
    """Seconds of this process and of those it has waited for."""
    t = os.times()
    return t.user + t.system + t.children_user + t.children_system


def timed(work: Callable[[], Any]) -> tuple[float, float, Any]:
    """Shortest wall time and processor time of some repeats in s, and the last result."""
    wall, processor, result = float('inf'), float('inf'), None
    for _ in range(REPEATS):
        start, start_processor = time.perf_counter(), processor_time()
        result = work()
        wall = min(wall, time.perf_counter() - start)
        processor = min(processor, processor_time() - start_processor)
    return wall, processor, result


def bag_to_tables(bag: Path, machine_file: Path, out: Path) -> CalibrationResult:
    """What ``./otf calibrate`` does."""
    content = read_bag(bag)
    result = calibrate(content.samples, content.path, load_machine(machine_file))
    write_calibration(result, out)
    return result


def command(bag: Path, machine_file: Path, out: Path) -> None:
    """Run the command itself."""
    words = ['calibrate', str(bag), '--machine', str(machine_file), '--out', str(out)]
    words += ['--overwrite']
    subprocess.run([sys.executable, '-m', 'otf_core.cli', *words], check=True, capture_output=True)


def main(laps: int = 4) -> None:
    machine = load_machine(MACHINE)
    plan = plan_path(machine, PlannerConfig(passes=laps))
    run = simulate(machine, plan, SimulationConfig(seed=SEED))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        bag, out, machine_file = folder / 'bag', folder / 'out', folder / 'machine.yaml'
        write_text(machine_file, MACHINE.read_text(encoding='utf-8'))
        write_bag(bag, BagContent(run.samples, plan.path))
        *rosbags, count = timed(lambda: read_with_rosbags(bag))
        *reading, _ = timed(lambda: read_bag(bag))
        *whole, result = timed(lambda: bag_to_tables(bag, machine_file, out))
        *started, _ = timed(lambda: command(bag, machine_file, folder / 'command'))
    assert count == len(run.samples)
    fit = result.fit
    print(f'{fit.samples} samples, {fit.pieces} pieces, {fit.unknowns} unknowns, '
          f'{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}')  # fmt: skip
    rows = (
        ('rosbags AnyReader, deserialise only', rosbags),
        ('read_bag', reading),
        ('bag to tables: read, calibrate, write', whole),
        ('./otf calibrate, start of Python included', started),
    )
    print(f'{"":42}{"wall s":>9}{"ratio":>7}{"processor s":>13}{"ratio":>7}')
    for name, seconds in rows:
        print(f'{name:42}{seconds[0]:9.2f}{seconds[0] / rosbags[0]:7.3f}'
              f'{seconds[1]:13.2f}{seconds[1] / rosbags[1]:7.3f}')  # fmt: skip


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
