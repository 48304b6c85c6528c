# SPDX-License-Identifier: Apache-2.0
"""Half a million samples from bag to error tables, against rosbags deserialising the same bag.

One simulated run of four laps, 500 samples per second. Timed, shortest of three, all warm:
``read_bag``; read, calibrate and write all files; the whole command with start-up of Python; and
for comparison rosbags' AnyReader, which only turns the same bag into message objects and arrays.

Usage: PYTHONPATH=src/otf_core python bench/calibrate_speed.py [LAPS]
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from bag_speed import REPEATS, read_with_rosbags, timed

from otf_core.calibrate import CalibrationResult, calibrate
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.io.bag import BagContent, read_bag, write_bag
from otf_core.io.files import write_text
from otf_core.machine import load_machine
from otf_core.planning import plan_path
from otf_core.results import write_calibration
from otf_core.sim.cell import simulate

SEED = 20_260_011
MACHINE = Path(__file__).parent.parent / 'src/otf_bringup/config/machine.yaml'


def bag_to_tables(bag: Path, machine_file: Path, out: Path) -> CalibrationResult:
    """What ``./otf calibrate`` does."""
    content = read_bag(bag)
    result = calibrate(content.samples, content.path, load_machine(machine_file))
    write_calibration(result, out)
    return result


def command(bag: Path, machine_file: Path, out: Path) -> None:
    """Run the command itself."""
    words = ['calibrate', str(bag), '--machine', str(machine_file), '--out', str(out)]
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
        reading, _ = timed(lambda: read_bag(bag), REPEATS)
        whole, result = timed(lambda: bag_to_tables(bag, machine_file, out), REPEATS)
        started, _ = timed(lambda: command(bag, machine_file, out), REPEATS)
        rosbags, count = timed(lambda: read_with_rosbags(bag), REPEATS)
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
    for name, seconds in rows:
        print(f'{name:44}{seconds:8.2f} s{seconds / rosbags:8.3f} of rosbags')


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
