# SPDX-License-Identifier: Apache-2.0
"""Samples over DDS for long: how many are lost, what the nodes need of processor and memory.

Planner, simulated tracker and calibrator as processes: the demo cell at 1000 samples per second of
measurement time, given out ``times`` times as fast, until the path is driven and its tables are
there. Run it while the computer is otherwise busy; its mean load is printed.

Usage: eval "$(./otf env)"; python bench/dds_load.py [MINUTES [TIMES]]
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from view_load import MACHINE, RATE, processor_time

from otf_bringup.domain import free_domain

ROOT = Path(__file__).resolve().parents[1]
SEED = 20_260_082
LAP = 240.0
"""s; of a lap of the default path of the default machine, about."""
EVERY = 1.0
"""s; between looks at memory and load."""


def memory(pid: int) -> float:
    """Resident memory of a process, MB."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def main(minutes: float = 30.0, times: float = 1.0) -> None:
    """Run, and print what was lost and a line for every process."""
    sys.path.insert(0, str(ROOT / 'tests'))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    from graph import Graph  # that of the tests

    with tempfile.TemporaryDirectory() as scratch, free_domain() as domain:
        graph = Graph(domain, Path(scratch))
        machine = {'machine_file': MACHINE}
        passes = math.ceil(60 * minutes * times / LAP)
        graph.start('path_planner', **machine, passes=passes)
        graph.start('calibrator', **machine, output_directory=Path(scratch) / 'out')
        simulated = {'simulated.rate': RATE, 'simulated.seed': SEED, 'time_scale': times}
        graph.start('tracker_driver', **machine, **simulated)
        graph.status()
        graph.state()
        graph.wait_for_status('STREAMING')
        began, rows, loads = time.monotonic(), [], []
        before = [processor_time(node.process.pid) for node in graph.nodes]

        def driven() -> bool:
            if time.monotonic() - began > EVERY * len(rows):
                rows.append([memory(node.process.pid) for node in graph.nodes])
                loads.append(os.getloadavg()[0])
            return graph.status().name == 'FINISHED'

        graph.wait(driven, 'the end of the stream', 60 * minutes * 3 + 600)
        wall, streamed = time.monotonic() - began, len(rows)
        after = [processor_time(node.process.pid) for node in graph.nodes]
        graph.wait(lambda: driven() and graph.state().name in ('DONE', 'FAILED'), 'tables', 1200.0)
        result, _ = graph.wait_for_result()
        sent, state = graph.status().samples_published, graph.state()
        print(f'{sent / wall:.0f} samples per second for {wall / 60:.1f} min; mean load of '
              f'{os.cpu_count()} cores: {np.mean(loads):.1f} processes')  # fmt: skip
        print(f'published {sent}, arrived {state.samples}, lost {result.samples_lost}')
        print(f'result: status {result.status}: {result.message}')
        print('| node | share of a core % | memory, MB: median of every tenth of it; most |')
        print('|---|---:|---:|')
        used = np.array(rows)
        for node, first, last, mb in zip(graph.nodes, before, after, used.T, strict=True):
            streaming = mb[:streamed]
            tenths = [np.median(part) for part in np.array_split(streaming, 10)]
            sizes = ' '.join(f'{size:.0f}' for size in tenths) + f'; {mb.max():.0f}'
            name = node.name.rpartition('-')[0]
            print(f'| {name} | {100 * (last - first) / wall:.1f} | {sizes} |', flush=True)
        graph.close()


if __name__ == '__main__':
    main(*map(float, sys.argv[1:3]))
