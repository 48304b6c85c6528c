# SPDX-License-Identifier: Apache-2.0
"""Backend that plays a recorded bag; stamps and samples are the recorded ones, bit for bit."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.bags.bag import read_bag
from otf_core.config import Parameters, parameter
from otf_core.errors import ConfigError
from otf_tracker_driver.backends.paced import PacedBackend


@dataclass(frozen=True)
class ReplayConfig(Parameters):
    """Which bag, and what of it."""

    bag: str = parameter('', 'rosbag2 folder or .mcap file with /tracker/point; required')
    publish_path: bool = parameter(
        True, 'also publish the path in the bag, as planner/path or planner/axes'
    )


class Replay(PacedBackend):
    """Streams ``/tracker/point`` of a bag; its path is published beside it."""

    parameters = ReplayConfig
    brings_path = True
    own: ReplayConfig

    def connect(self) -> str:
        """Read the bag."""
        bag = self.own.bag
        if not bag:
            raise ConfigError('parameter replay.bag: missing; name the bag to play')
        content = read_bag(bag)
        self.load(content.samples)
        if self.own.publish_path:
            self.path, self.parts = content.path, content.axis_paths
        return f'replay of {bag}: {self.expected} samples at {self.rate:.0f} Hz'
