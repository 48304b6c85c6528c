# SPDX-License-Identifier: Apache-2.0
"""From the last motion of a machine to its published tables, in the live node graph.

Planner, simulated tracker and calibrator as processes over DDS; laps of the demo cell at 500
samples per second, as fast as they would be driven. Measured in a listener: time from the last
sample that moved (by a millimetre since the one before that did) to the arrival of the result;
that the machine stands is known after ``path_watch.SOON``. Beside it how long ``otf calibrate``
takes for the bag that the calibrator has saved, and by how much its tables differ, in parts of u.
A larger time scale drives faster than the machine would: four laps take 19 minutes otherwise.

Usage: eval "$(./otf env)"; python bench/live_delay.py [--laps 1] [--time-scale 1]
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PointStamped
from markdown import heading, row

from otf_bringup.domain import free_domain
from otf_core.prediction.calibration_document import load_tables
from otf_msgs.msg import CalibrationResult
from otf_ros import qos

ROOT = Path(__file__).resolve().parents[1]
MACHINE = ROOT / 'src/otf_bringup/config/machine.yaml'
SEED = 20_260_013
MOVED = 1e-3
"""m"""


class Motion:
    """When the target last moved, s, monotonic."""

    def __init__(self) -> None:
        self.last = 0.0
        self._at = (0.0, 0.0, 0.0)

    def hear(self, message: PointStamped) -> None:
        """Take a sample."""
        p = message.point
        if math.dist(here := (p.x, p.y, p.z), self._at) > MOVED:
            self._at, self.last = here, time.monotonic()


def live(laps: int, scale: float, folder: Path) -> tuple[int, float, Path]:
    """Samples of a run, s from its last motion to its result, and the bag."""
    from graph import Graph  # that of the tests

    with free_domain() as domain:
        graph = Graph(domain, folder)
        heard: list[float] = []
        motion, ear = Motion(), graph.ear()
        ear.create_subscription(
            CalibrationResult, 'calibrator/result', lambda _: heard.append(time.monotonic()), 1
        )
        ear.create_subscription(PointStamped, 'tracker/point', motion.hear, qos.MEASUREMENT)
        graph.start('path_planner', machine_file=MACHINE, passes=laps)
        graph.start('calibrator', machine_file=MACHINE, output_directory=folder / 'out')
        simulated = {'simulated.rate': 500.0, 'simulated.seed': SEED, 'time_scale': scale}
        graph.start('tracker_driver', machine_file=MACHINE, **simulated)
        graph.wait(lambda: heard, 'result', 3600.0)
        result, _ = graph.wait_for_result()
        bag = Path(result.output_directory) / 'samples'
        graph.wait(bag.exists, 'the bag')
        graph.close()
    return result.samples, heard[0] - motion.last, bag


def difference(first: Path, second: Path) -> float:
    """Largest difference of two error_tables.json at a node, over u."""
    files = (folder / 'error_tables.json' for folder in (first, second))
    one, other = (load_tables(file).tables.motions for file in files)
    pairs = [(own, other[name]) for name, own in one.items() if own.identifiable]
    return max(float(np.max(np.abs(a.value - b.value) / np.maximum(a.u, 1e-12))) for a, b in pairs)


def offline(bag: Path, folder: Path) -> float:
    """Wall time of the command, s."""
    words = ['calibrate', str(bag), '--machine', str(MACHINE), '--out', str(folder / 'offline')]
    start = time.monotonic()
    subprocess.run(
        [sys.executable, '-m', 'otf_core.cli', *words], check=True, stdout=subprocess.DEVNULL
    )
    return time.monotonic() - start


def main() -> None:
    """Print one row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--laps', type=int, default=1)
    parser.add_argument('--time-scale', type=float, default=1.0)
    given = parser.parse_args()
    sys.path.insert(0, str(ROOT / 'tests'))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    print(f'{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}')
    titles = ('laps', 'time scale', 'samples', 'last motion to result s', 'otf calibrate s',
              'difference / u')  # fmt: skip
    print(heading(titles), flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        samples, delay, bag = live(given.laps, given.time_scale, Path(scratch))
        command = offline(bag, Path(scratch))
        apart = difference(bag.parent, Path(scratch) / 'offline')
        print(row((given.laps, f'{given.time_scale:g}', samples, f'{delay:.2f}',
                   f'{command:.2f}', f'{apart:.2g}')))  # fmt: skip


if __name__ == '__main__':
    main()
