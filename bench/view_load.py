# SPDX-License-Identifier: Apache-2.0
"""What the live view costs: processor time of viewer and page while samples stream.

Planner, simulated tracker, calibrator and viewers as processes over DDS: the demo cell at 1000
samples per second in real time. Measured from the first look at the run on, when the place of the
tracker is known and deviations are drawn: processor time of each process over wall time, and how
often pictures came; then again with as many arrows as a picture can have.

Usage: eval "$(./otf env)"; python bench/view_load.py
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from geometry_msgs.msg import TransformStamped
from visualization_msgs.msg import MarkerArray

from otf_bringup.domain import free_domain
from otf_ros import qos

ROOT = Path(__file__).resolve().parents[1]
MACHINE = ROOT / 'src/otf_bringup/config/machine.yaml'
SEED = 20_260_014
RATE = 1000.0
"""Hz"""
OVER, OVER_MANY = 60.0, 20.0
"""s that are measured: from the first look on, and with the most arrows."""
MANY = 350
"""Arrows from which on that is; the whole run makes some 400."""


def processor_time(pid: int) -> float:
    """User and system time of a process so far, s."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def arrows(pictures: list[MarkerArray]) -> int:
    """Deviations that the latest picture draws."""
    found = [m for m in pictures[-1].markers if m.ns == 'deviations'] if pictures else []
    return sum(len(m.points) // 2 for m in found)


def measure(graph: Any, pictures: list[MarkerArray], seconds: float) -> None:
    """Print what every process takes for some time."""
    began, count, samples = time.monotonic(), len(pictures), graph.state().samples
    before = {node.name: processor_time(node.process.pid) for node in graph.nodes}
    first = arrows(pictures)
    graph.wait(lambda: time.monotonic() - began > seconds, 'the end', 2 * seconds)
    wall = time.monotonic() - began
    print(f'{(graph.state().samples - samples) / wall:.0f} samples per second')
    print(f'{(len(pictures) - count) / wall:.1f} pictures per second')
    print(f'{first} to {arrows(pictures)} arrows')
    print('| process | share of a core % |\n|---|---:|')
    for node in graph.nodes:
        used = processor_time(node.process.pid) - before[node.name]
        print(f'| {node.name.rpartition("-")[0]} | {100 * used / wall:.1f} |', flush=True)


def main() -> None:
    """Print a line for every process."""
    sys.path.insert(0, str(ROOT / 'tests'))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    from graph import Graph  # that of the tests

    with tempfile.TemporaryDirectory() as scratch, free_domain() as domain:
        graph = Graph(domain, Path(scratch))
        machine = {'machine_file': MACHINE}
        for name in ('viewer', 'page'):
            graph.start(name, **({'port': 0} if name == 'page' else {}))
        graph.start('path_planner', **machine)
        graph.start('calibrator', **machine, output_directory=Path(scratch) / 'out')
        simulated = {'simulated.rate': RATE, 'simulated.seed': SEED}
        graph.start('tracker_driver', **machine, **simulated)
        graph.state()
        early = graph.listen(TransformStamped, 'calibrator/alignment', qos.RESULT)
        pictures = graph.listen(MarkerArray, 'view/live', qos.PICTURE)
        graph.wait(lambda: early, 'a first look', 300.0)
        measure(graph, pictures, OVER)
        graph.wait(lambda: arrows(pictures) > MANY, 'many arrows', 600.0)
        measure(graph, pictures, OVER_MANY)
        graph.close()


if __name__ == '__main__':
    main()
