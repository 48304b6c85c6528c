# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tracker driver, besides those of a simulated cell (SimulationConfig)."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.config import Parameters, parameter
from otf_tracker_driver.backends.names import BACKENDS


@dataclass(frozen=True)
class DriverConfig(Parameters):
    """What the driver streams and how; read whenever the node is configured."""

    auto_start: bool = parameter(
        True, 'configure and activate at start; false: wait for lifecycle transitions'
    )
    backend: str = parameter('simulated', 'source of the samples', choices=tuple(BACKENDS))
    machine_file: str = parameter(
        '', 'machine description (machine.yaml); required by the backend simulated'
    )
    truth_tables: str = parameter(
        '', 'errors of the simulated machine (error_tables.json); empty: drawn from the seed'
    )
    effects: str = parameter(
        '', 'what else is wrong in the simulated cell (effects.yaml); empty: nothing'
    )
    bag: str = parameter(
        '', 'rosbag2 folder or .mcap file with /tracker/point; required by the backend replay'
    )
    publish_path: bool = parameter(
        True, 'the backend replay also publishes the path in the bag as planner/path'
    )
    time_scale: float = parameter(
        1.0, 'simulated and replayed time runs this many times as fast as real time', '', 0.1, 50.0
    )
    max_rate: float = parameter(
        5000.0, 'most samples published per second; limits time_scale so that subscribers '
        'keep up', 'Hz', 10.0, 50000.0,
    )  # fmt: skip
    wait_for_subscribers: int = parameter(
        1, 'the stream starts once this many subscriptions of tracker/point are matched', '', 0, 20
    )
