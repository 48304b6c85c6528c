# SPDX-License-Identifier: Apache-2.0
"""Records the bags of this folder from the live nodes: planner and simulated tracker.

In a terminal set up by eval "$(./otf env)": python3 bags/record.py [NAME ...]
Beside every bag lie the machine.yaml and the true errors that the tracker was simulated with.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from otf_bringup.domain import free_domain
from otf_bringup.processes import NodeProcess, end_together, module_of
from otf_core.bags.bag import BagContent, write_bag
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.machine import load_machine
from otf_core.model.observation import SampleBuffer
from otf_core.prediction.calibration_document import tables_to_dict
from otf_core.sim.cell import random_tables
from otf_msgs.msg import TrackerStatus
from otf_ros import convert, qos
from otf_ros.app import running_ros
from otf_ros.drain import Drain

HERE = Path(__file__).resolve().parent
PATIENCE = 60.0
"""s without a single new sample"""


@dataclass(frozen=True)
class Cell:
    """One machine and how it is driven and measured."""

    chain: str
    ranges: dict[str, tuple[float, float]]
    target_offset: tuple[float, float, float]
    planner: dict[str, Any]
    simulation: dict[str, Any]
    error_size: float

    def machine(self) -> dict[str, Any]:
        """Content of its machine.yaml."""
        return {
            'name': self.chain.replace('-', ''),
            'chain': self.chain,
            'axes': {
                axis: {'min': low, 'max': high, 'table_pitch': 0.05}
                for axis, (low, high) in self.ranges.items()
            },
            'target_offset': list(self.target_offset),
            'tracker': {'u_range': 0.5e-6, 'u_angle': 2.0e-6},
        }


CELLS = {
    'all-axes-carry-the-target': Cell(
        'w-b-X-Y-Z-t',
        {'X': (0.0, 0.3), 'Y': (0.0, 0.25), 'Z': (-0.2, 0.0)},
        (0.0, 0.0, -0.15),
        {'passes': 2, 'levels': 2, 'feed': 0.25},
        {'rate': 150.0, 'seed': 11, 'correlated_share': 0.5},
        1e-4,
    ),
    'y-carries-the-table': Cell(
        'w-Y-b-X-Z-t',
        {'X': (-0.15, 0.15), 'Y': (-0.1, 0.15), 'Z': (-0.25, 0.0)},
        (0.02, -0.01, -0.12),
        {'passes': 2, 'levels': 2, 'feed': 0.3, 'feed_ratio': 0.5},
        {'rate': 150.0, 'seed': 12, 'correlated_share': 0.5},
        5e-5,
    ),
    'x-and-y-carry-the-table': Cell(
        'w-X-Y-b-Z-t',
        {'X': (0.1, 0.4), 'Y': (0.0, 0.3), 'Z': (0.0, 0.2)},
        (0.0, 0.03, -0.2),
        {'passes': 2, 'levels': 2, 'feed': 0.25, 'corner_dwell': 0.5},
        {'rate': 120.0, 'seed': 13, 'correlated_share': 0.2},
        3e-5,
    ),
}


class Recorder(Node):
    """Listens to path, samples and status."""

    def __init__(self) -> None:
        super().__init__('recorder')
        self.path = None
        self.status = TrackerStatus()
        self.buffer = SampleBuffer()
        self.create_subscription(PathMessage, 'planner/path', self._on_path, qos.PATH)
        self.create_subscription(TrackerStatus, 'tracker/status', self._on_status, qos.STATUS)
        Drain(self, PointStamped, 'tracker/point', self._on_points, qos.MEASUREMENT)

    @property
    def complete(self) -> bool:
        """True once the path and all samples are here."""
        ended = self.status.state == TrackerStatus.FINISHED
        all_here = len(self.buffer) >= self.status.samples_published
        return ended and all_here and self.path is not None

    def _on_path(self, message: PathMessage) -> None:
        self.path = convert.path_from_message(message)

    def _on_status(self, message: TrackerStatus) -> None:
        self.status = message

    def _on_points(self, messages: list[PointStamped]) -> None:
        for point in convert.points_from_messages(messages):
            self.buffer.append(*point)


def listen(domain: int, nodes: list[NodeProcess]) -> BagContent:
    """Take everything that the nodes publish until the stream has ended."""
    with running_ros([], domain):
        recorder, executor = Recorder(), SingleThreadedExecutor()
        executor.add_node(recorder)
        count, moved = 0, time.monotonic()
        while not recorder.complete:
            executor.spin_once(timeout_sec=0.1)
            if len(recorder.buffer) > count:
                count, moved = len(recorder.buffer), time.monotonic()
            dead = [node for node in nodes if node.exit_code is not None]
            if dead or time.monotonic() - moved > PATIENCE:
                raise SystemExit('\n'.join(node.last_lines() for node in dead or nodes))
        return BagContent(recorder.buffer.snapshot(), recorder.path)


def record(name: str, cell: Cell) -> None:
    """Record one bag and write what belongs to it."""
    folder = ensure_folder(HERE / name)
    machine_file, truth_file = folder / 'machine.yaml', folder / 'truth.json'
    write_text(machine_file, yaml.safe_dump(cell.machine(), sort_keys=False))
    rng = np.random.default_rng(cell.simulation['seed'])
    truth = random_tables(load_machine(machine_file), cell.error_size, rng)
    write_text(truth_file, json.dumps(tables_to_dict(truth), indent=1) + '\n')
    machine = {'machine_file': machine_file}
    simulation = {**cell.simulation, 'truth_tables': truth_file}
    simulated = {f'simulated.{name}': value for name, value in simulation.items()}
    driver = {**machine, **simulated, 'time_scale': 20.0}
    with free_domain() as domain, tempfile.TemporaryDirectory() as logs:
        environment = {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        nodes = [
            NodeProcess(node, module_of(node), parameters, Path(logs), environment)
            for node, parameters in (
                ('path_planner', {**machine, **cell.planner}),
                ('tracker_driver', driver),
            )
        ]
        with end_together(nodes):
            content = listen(domain, nodes)
    write_bag(folder / 'bag', content, overwrite=True)
    print(f'{name}: {len(content.samples)} samples, {content.path.length:.1f} m')


def main() -> None:
    """Record the bags that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('names', nargs='*', metavar='NAME', help=', '.join(CELLS))
    names = parser.parse_args().names or list(CELLS)
    if unknown := set(names) - set(CELLS):
        parser.error(f'unknown: {", ".join(unknown)}; possible: {", ".join(CELLS)}')
    for name in names:
        record(name, CELLS[name])


if __name__ == '__main__':
    main()
