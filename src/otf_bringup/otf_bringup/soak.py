# SPDX-License-Identifier: Apache-2.0
"""Command line: ``./otf soak``. The whole graph over an emulated tracker, one fault after another.

Planner, driver and calibrator run as processes of their own; the tracker's faults change, nodes
are killed and started again. A table tells for each fault what was said, how long samples paused
at most, and what was lost.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from rclpy.executors import SingleThreadedExecutor

from otf_bringup.domain import free_domain
from otf_bringup.processes import NodeProcess, end_together, module_of
from otf_bringup.soak_ear import FaultRecord, SoakListener
from otf_bringup.soak_tracker import SoakTracker
from otf_core.cli.parser import Parser
from otf_core.config import PlannerConfig
from otf_core.errors import OtfError
from otf_core.model.machine import load_machine
from otf_ros.app import EndRequest, running_ros

FAULTS = {
    'none': '',
    'beam lost': 'beam_loss=0.05',
    'packets split and merged': 'split,merge',
    'server announces that it closes': 'close_after=9',
    'connection cut': 'cut_after=9',
    'stream falls silent': 'silent=0.04',
    'clock jumps ahead': 'clock_jump=0.04',
    'another program sets millimetres': 'foreign=0.04',
    'busy': 'busy=0.5,cut_after=12',
    'packets late': 'jitter=0.005,late=0.2',
    'speed, unknown codes': 'speed_warning=0.1,speed_exceeded=0.1,unknown=0.1',
    'all of these': 'beam_loss=0.01,split=0.5,merge=0.5,close_after=31,busy=0.1,late=0.02,'
    'speed_warning=0.02,speed_exceeded=0.02,unknown=0.02,clock_jump=0.002,silent=0.002,'
    'foreign=0.003',
}
"""Faults of the emulated tracker."""
STOPPED = (3.0, 20.0)
"""s; for so long the process of the driver stands still."""
OFF = 5.0
"""s; for so long nobody listens at the tracker's port."""
SETTLES = 8.0
"""s; what has piled up is read, published and heard."""
KILLED = (
    ('tracker_driver',),
    ('calibrator',),
    ('path_planner',),
    ('tracker_driver', 'calibrator'),
)
FOREIGN = ('path in millimetres', 'second planner')
"""What others do in the graph."""
START = 60.0
"""s; until the first samples come."""
LAP = 280.0
"""s; of a lap of the default path of the default machine, about."""
UNDER_WAY = 2.0
"""s; for samples that were announced before they are heard."""
RESPAWN = 0.3
"""s; as the launch files do."""


class Soak:
    """The graph and its tracker.

    Parameters
    ----------
    folder : Path
        For logs and results.
    """

    def __init__(
        self, folder: Path, machine: Path, planning: PlannerConfig, seed: int, domain: int
    ) -> None:
        self.tracker = SoakTracker(load_machine(str(machine)), planning, seed)
        self._folder, self._environment = (
            folder,
            {'ROS_DOMAIN_ID': str(domain), 'ROS_HOME': str(folder / 'ros')},
        )
        files = {'machine_file': machine}
        self._given: dict[str, dict[str, object]] = {
            'path_planner': {**files, 'passes': planning.passes, 'levels': planning.levels},
            'calibrator': {**files, 'output_directory': folder / 'calibrations'},
            'tracker_driver': {
                'backend': 'emscon',
                'emscon.port': self.tracker.port,
                'wait_for_subscribers': 1,
            },
        }
        self.nodes: list[NodeProcess] = []
        self._started = 0
        for name in self._given:
            self.start(name)

    def start(self, name: str) -> None:
        """Start a node."""
        label = f'{self._started:02}-{name}'
        self._started += 1
        module, given = module_of(name), self._given[name]
        self.nodes.append(NodeProcess(label, module, given, self._folder, self._environment))

    def stop(self, name: str, lasting: float, spin: Callable[[float], None]) -> None:
        """Have the process of a node stand still."""
        (node,) = (node for node in self.nodes if node.name.endswith(name))
        node.interrupt(signal.SIGSTOP)
        spin(lasting)
        node.interrupt(signal.SIGCONT)

    def kill(self, *names: str) -> None:
        """End nodes in the middle of whatever they do, and start them again."""
        killed = [node for node in self.nodes if node.name.endswith(names)]
        for node in killed:
            node.interrupt(signal.SIGKILL)
        for node in killed:
            node.wait()
            self.nodes.remove(node)
        time.sleep(RESPAWN)
        for name in names:
            self.start(name)

    def start_second_planner(self) -> None:
        """Start a planner that somebody has started by mistake: another path on the same topic."""
        given = {**self._given['path_planner'], 'levels': 1, 'passes': 1}
        words = ['-r', '__node:=second_planner']
        label, module = 'second-planner', module_of('path_planner')
        self.nodes.append(
            NodeProcess(label, module, given, self._folder, self._environment, words)
        )


def soak(
    graph: Soak, ear: SoakListener, spin: Callable[[float], None], seconds: float
) -> list[tuple[str, FaultRecord, int]]:
    """Let every fault happen for so many seconds; returns its name, what was heard, lost."""
    rows = []
    for name, faults in FAULTS.items():
        ear.begin()
        graph.tracker.change(faults)
        spin(seconds)
        rows.append((name, ear.end(), _lost(ear, spin)))
    graph.tracker.change('')
    for lasting in STOPPED:
        spin(SETTLES)
        ear.begin()
        graph.stop('tracker_driver', lasting, spin)
        spin(max(SETTLES, seconds - lasting))
        rows.append(
            (f'tracker_driver stands still for {lasting:.0f} s', ear.end(), _lost(ear, spin))
        )
    ear.begin()
    graph.tracker.switch(False)
    spin(OFF)
    graph.tracker.switch(True)
    spin(max(SETTLES, seconds - OFF))
    rows.append((f'tracker off for {OFF:.0f} s', ear.end(), _lost(ear, spin)))
    for names in KILLED:
        spin(5.0)
        ear.begin()
        graph.kill(*names)
        spin(seconds)
        rows.append((f'kill -9 of {" and ".join(names)}', ear.end(), _lost(ear, spin)))
    for name, begin in zip(FOREIGN, (ear.stray_path, graph.start_second_planner), strict=True):
        ear.begin()
        begin()
        spin(seconds)
        rows.append((name, ear.end(), _lost(ear, spin)))
    return rows


def _lost(ear: SoakListener, spin: Callable[[float], None]) -> int:
    """Samples lost so far, once what is still under way has come."""
    until = time.monotonic() + UNDER_WAY
    while ear.lost and time.monotonic() < until:
        spin(0.1)
    return ear.lost


def table(rows: list[tuple[str, FaultRecord, int]]) -> str:
    """Markdown."""
    head = (
        '| fault | messages | gaps published | longest pause, s | samples | going back | lost |\n'
    )
    lines = [head + '|---|---|---|---|---|---|---|']
    before = 0
    for name, heard, lost in rows:
        said = '; '.join(list(heard.said)[:3]) or '-'
        lines.append(
            f'| {name} | {said} | {heard.gaps} | {heard.longest:.1f} | {heard.samples} | '
            f'{heard.backwards} | {max(0, lost - before)} |'
        )
        before = lost
    return '\n'.join(lines)


def run(given: argparse.Namespace, folder: Path) -> int:
    """Soak and print the table; returns the exit code: 0, or 4 if anything was lost."""
    machine = Path(given.machine).absolute()
    count = len(FAULTS) + len(STOPPED) + 1 + len(KILLED) + len(FOREIGN)
    seconds = 60.0 * given.minutes / count
    planning = PlannerConfig(passes=min(20, max(1, round(60 * given.minutes / LAP))))
    with EndRequest() as end, free_domain() as domain, running_ros([], domain):
        ear, executor = SoakListener(), SingleThreadedExecutor()
        executor.add_node(ear)

        def spin(lasting: float) -> None:
            until = time.monotonic() + lasting
            while time.monotonic() < until and not end.came:
                executor.spin_once(timeout_sec=0.05)

        graph = Soak(folder, machine, planning, given.seed, domain)
        try:
            with end_together(graph.nodes):
                until = time.monotonic() + START
                while not ear.streaming and time.monotonic() < until and not end.came:
                    spin(0.2)
                rows = soak(graph, ear, spin, seconds)
        finally:
            graph.tracker.close()
            executor.shutdown()
            ear.destroy_node()
    sys.stdout.write(table(rows) + '\n')
    for result in ear.results[-1:]:
        sys.stdout.write(f'calibration: {result.message}\n')
    sys.stdout.write(f'logs: {folder}\n')
    heard = [row[1] for row in rows]
    return 4 if ear.lost or any(h.backwards or not h.samples for h in heard) else 0


def main() -> int:
    """Run; returns the exit code."""
    default = Path(__file__).resolve().parents[1] / 'config' / 'machine.yaml'
    example = 'Example: ./otf soak --minutes 2 --out soak'
    parser = Parser('otf soak', description=__doc__, epilog=example)
    parser.add_argument('--minutes', type=float, default=10.0, help='total duration of all faults')
    parser.add_argument('--machine', default=str(default), help='machine.yaml')
    parser.add_argument('--seed', type=int, default=1, help='seed of cell and faults')
    parser.add_argument('--out', default='', help='folder of logs and results (a new one)')
    given = parser.parse_args()
    try:
        folder = Path(given.out).absolute() if given.out else Path(tempfile.mkdtemp('-soak'))
        folder.mkdir(parents=True, exist_ok=True)
        return run(given, folder)
    except OtfError as error:
        sys.stderr.write(f'error: {error}\n')
        return error.exit_code


if __name__ == '__main__':
    sys.exit(main())
