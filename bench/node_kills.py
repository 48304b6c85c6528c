# SPDX-License-Identifier: Apache-2.0
"""kill -9 of nodes at random moments of one run: recovery, samples lost, the same tables.

Planner, driver and calibrator over an emulated tracker whose machine drives on whatever happens.
A listener of its own writes down every sample and when it came. In the end the tables of the run
are compared, digit by digit, with those that an undisturbed process gives from the same samples,
and the number of lost samples that the result states, with the gaps that it names, with those that
the listener has beyond them: while both nodes are down nobody counts.

Usage: eval "$(./otf env)"; python bench/node_kills.py [KILLS [SEED]]
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'tests'))
from cells import write_machine
from emulated import DRIFT, emulator
from emulator import Cell
from graph import offline

from otf_bringup.domain import free_domain
from otf_bringup.processes import NodeProcess, end_together, module_of
from otf_core.bags.bag import read_points
from otf_core.config import PlannerConfig
from otf_core.model.machine import load_machine
from otf_msgs.msg import CalibrationResult, CalibratorState
from otf_ros import qos
from otf_ros.app import running_ros
from otf_ros.convert import ns_from_time
from otf_ros.drain import Drain

EVERY = (8.0, 14.0)
"""s; from kill to kill."""
LAP = 75.0
"""s; less than a lap of the default path of the small machine takes."""
KILLED = (
    ('tracker_driver',),
    ('calibrator',),
    ('path_planner',),
    ('tracker_driver', 'calibrator'),
)
RESPAWN = 0.3
"""s; as the launch files do."""


class Nodes:
    """Planner, calibrator and driver as processes."""

    def __init__(self, folder: Path, machine: Path, port: int, passes: int, domain: int) -> None:
        self._folder = folder
        self._environment = {'ROS_DOMAIN_ID': str(domain), 'ROS_HOME': str(folder / 'ros')}
        files = {'machine_file': machine}
        self._given = {
            'path_planner': {**files, 'passes': passes, 'levels': 2},
            'calibrator': {**files, 'output_directory': folder / 'calibrations'},
            'tracker_driver': {
                'backend': 'emscon', 'emscon.port': port, 'wait_for_subscribers': 1,
            },
        }  # fmt: skip
        self.running: list[NodeProcess] = []
        self._started = 0
        for name in self._given:
            self._start(name)

    def _start(self, name: str) -> None:
        label, self._started = f'{self._started:02}-{name}', self._started + 1
        given = self._given[name]
        self.running.append(
            NodeProcess(label, module_of(name), given, self._folder, self._environment)
        )

    def kill(self, *names: str) -> None:
        """End nodes in the middle of whatever they do, and start them again."""
        killed = [node for node in self.running if node.name.endswith(names)]
        for node in killed:
            node.interrupt(signal.SIGKILL)
        for node in killed:
            node.wait()
            self.running.remove(node)
        time.sleep(RESPAWN)
        for name in names:
            self._start(name)


class Witness(Node):
    """Writes down when each sample came, when planner and calibrator were heard, and results."""

    def __init__(self) -> None:
        super().__init__('witness')
        self.came: dict[int, float] = {}
        self.results: list[CalibrationResult] = []
        now = time.monotonic
        self.spoken: dict[str, list[float]] = {'calibrator': [], 'path_planner': []}
        for name, kind, topic, profile in (
            ('calibrator', CalibratorState, 'calibrator/state', qos.STATUS),
            ('path_planner', PathMessage, 'planner/path', qos.PATH),
        ):
            told = self.spoken[name]
            self.create_subscription(kind, topic, lambda _, t=told: t.append(now()), profile)
        self.create_subscription(
            CalibrationResult, 'calibrator/result', self.results.append, qos.RESULT
        )
        Drain(self, PointStamped, 'tracker/point', self._on_points, qos.MEASUREMENT)

    def _on_points(self, messages, numbers):
        now = time.monotonic()
        self.came.update((ns_from_time(m.header.stamp), now) for m in messages)


def back(name: str, witness: Witness, killed: float) -> bool:
    """Tell whether a killed node does its work again."""
    if name == 'tracker_driver':
        return max(witness.came.values()) > killed + 0.3
    return witness.spoken[name][-1] > killed + 0.1


def lost_age(came: dict[int, float], found: np.ndarray, since: float, killed: float) -> float:
    """Age at the kill of the oldest sample that is missing because of it, s; 0 if none is.

    ``since`` is when all nodes were at work again after the kill before.
    """
    missing = set(came) - set(found.tolist())
    return max([0.0, *(killed - came[s] for s in missing if since < came[s] < killed)])


def main(kills: int = 10, seed: int = 1) -> int:
    """Kill, print a row for each, compare the tables; 1 if they differ or too much is lost."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    rng = np.random.default_rng(seed)
    planning = PlannerConfig(passes=1 + int(kills * sum(EVERY) / 2 / LAP), levels=2)
    folder = Path(tempfile.mkdtemp('-kills'))
    machine = write_machine(folder)
    cell = Cell(load_machine(str(machine)), planning, seed, DRIFT)
    with (
        emulator(seed=seed, simulated=cell) as tracker,
        free_domain() as domain,
        running_ros([], domain),
    ):
        witness, executor = Witness(), SingleThreadedExecutor()
        executor.add_node(witness)

        def spin(condition, longest: float) -> None:
            until = time.monotonic() + longest
            while time.monotonic() < until and not condition():
                executor.spin_once(timeout_sec=0.02)

        nodes = Nodes(folder, machine, tracker.port, planning.passes, domain)
        rows = []
        with end_together(nodes.running):
            spin(lambda: bool(witness.came), 60.0)
            for names in (KILLED[k] for k in rng.integers(len(KILLED), size=kills)):
                spin(lambda: False, rng.uniform(*EVERY))
                killed = time.monotonic()
                nodes.kill(*names)
                spin(
                    lambda names=names, killed=killed: all(
                        back(name, witness, killed) for name in names
                    ),
                    30.0,
                )
                rows.append((names, killed, time.monotonic()))
            spin(lambda: final(witness), 60.0 * 20)
        executor.shutdown()
    result = final(witness)
    if result is None:
        print(f'no result; logs: {folder}')
        return 1
    (run,) = (p for p in (folder / 'calibrations' / 'journal').iterdir() if p.is_dir())
    points = read_points(run)
    worst = 0.0
    print('| killed | at work again after, s | age of the oldest sample lost, ms |\n|---|---|---|')
    at_work = 0.0
    for names, killed, again in rows:
        age = 0.0
        if 'calibrator' in names:
            age = lost_age(witness.came, points.stamp_ns, at_work, killed)
        at_work = again
        worst = max(worst, age)
        print(f'| {" and ".join(names)} | {again - killed:.1f} | {1e3 * age:.0f} |')
    (folder / 'samples').symlink_to(run)  # results name their bags
    offline(folder / 'samples', machine, folder / 'again')
    same = content(Path(result.output_directory)) == content(folder / 'again')
    heard, used = set(witness.came), set(points.stamp_ns.tolist())
    first, last = min(used), max(used)
    missing = sum(first < stamp < last for stamp in heard - used)
    print(f'{result.message}\n{"; ".join(result.warnings)}')
    print(f'samples of the run: {len(used)}, of which the listener has missed {len(used - heard)}')
    print(f'lost: stated {result.samples_lost}, by the listener {missing}')
    print(f'the same tables: {same}; load {os.getloadavg()[0]:.0f}; {folder}')
    return 0 if same and result.samples_lost <= missing and worst < 0.5 else 1


def content(folder: Path) -> dict[str, object]:
    """Return error_tables.json without its date and warnings: offline no node is killed."""
    found = json.loads((folder / 'error_tables.json').read_text())
    del found['warnings'], found['provenance']['written']
    return found


def final(witness: Witness) -> CalibrationResult | None:
    """Return the result of the whole run, once it is there."""
    whole = [r for r in witness.results if 'interim' not in ' '.join(r.warnings)]
    return whole[-1] if whole else None


if __name__ == '__main__':
    raise SystemExit(main(*map(int, sys.argv[1:])))
