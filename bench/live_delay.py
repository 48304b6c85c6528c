# SPDX-License-Identifier: Apache-2.0
"""From the end of a run to its published tables, in the live node graph.

Planner, simulated tracker and calibrator as processes over DDS; one lap and four laps of the demo
cell at 500 samples per second, ten times as fast as they would be driven. Measured in a listener:
time from the driver's word that the stream has ended to the arrival of the result; beside it how
long ``otf calibrate`` takes for the bag that the calibrator has saved.

Usage: eval "$(./otf env)"; python bench/live_delay.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from otf_bringup.domain import free_domain
from otf_msgs.msg import CalibrationResult

ROOT = Path(__file__).resolve().parents[1]
MACHINE = ROOT / 'src/otf_bringup/config/machine.yaml'
SEED = 20_260_013
LAPS = (1, 4)


def live(laps: int, folder: Path) -> tuple[int, float, Path]:
    """Samples of a run, s from its end to its result, and the bag."""
    from graph import Graph  # that of the tests

    with free_domain() as domain:
        graph = Graph(domain, folder)
        heard: list[float] = []
        graph.ear().create_subscription(
            CalibrationResult, 'calibrator/result', lambda _: heard.append(time.monotonic()), 1
        )
        graph.start('path_planner', machine_file=MACHINE, passes=laps)
        graph.start('calibrator', machine_file=MACHINE, output_directory=folder / 'out')
        simulated = {'simulated.rate': 500.0, 'simulated.seed': SEED, 'time_scale': 10.0}
        graph.start('tracker_driver', machine_file=MACHINE, **simulated)
        graph.status()
        graph.wait(lambda: graph.status() and graph.status().name == 'FINISHED', 'end', 600.0)
        ended = time.monotonic()
        result, _ = graph.wait_for_result()
        bag = Path(result.output_directory) / 'samples'
        graph.wait(bag.exists, 'the bag')
        graph.close()
    return result.samples, heard[0] - ended, bag


def offline(bag: Path, folder: Path) -> float:
    """Wall time of the command, s."""
    words = ['calibrate', str(bag), '--machine', str(MACHINE), '--out', str(folder / 'offline')]
    start = time.monotonic()
    subprocess.run(
        [sys.executable, '-m', 'otf_core.cli', *words], check=True, stdout=subprocess.DEVNULL
    )
    return time.monotonic() - start


def main() -> None:
    """Print one row for every number of laps."""
    sys.path.insert(0, str(ROOT / 'tests'))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    print(f'{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}')
    print('| laps | samples | end to result s | otf calibrate s |\n|---:|---:|---:|---:|')
    for laps in LAPS:
        with tempfile.TemporaryDirectory() as scratch:
            samples, delay, bag = live(laps, Path(scratch))
            print(f'| {laps} | {samples} | {delay:.2f} | {offline(bag, Path(scratch)):.2f} |')


if __name__ == '__main__':
    main()
