# SPDX-License-Identifier: Apache-2.0
"""Backend that plays a recorded bag; stamps and samples are the recorded ones, bit for bit."""

from __future__ import annotations

from otf_core.bags.bag import read_bag
from otf_core.config import SimulationConfig
from otf_core.errors import ConfigError
from otf_tracker_driver.backends.paced import PacedBackend
from otf_tracker_driver.params import DriverConfig


class Replay(PacedBackend):
    """Streams ``/tracker/point`` of a bag; ``path`` is its ``/planner/path``."""

    def __init__(self, config: DriverConfig, simulation: SimulationConfig) -> None:
        super().__init__(config.time_scale, config.max_rate)
        self._config = config

    def connect(self) -> str:
        """Read the bag."""
        if not self._config.bag:
            raise ConfigError('parameter bag: missing; the backend replay needs a bag to play')
        content = read_bag(self._config.bag)
        self.load(content.samples)
        self.path = content.path if self._config.publish_path else None
        return f'replay of {self._config.bag}: {self.expected} samples at {self.rate:.0f} Hz'
