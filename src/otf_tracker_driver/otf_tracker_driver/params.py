# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tracker driver itself; every backend declares its own in its file."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.config import Parameters, parameter
from otf_tracker_driver.backends import BACKENDS


@dataclass(frozen=True)
class DriverConfig(Parameters):
    """Where samples come from and when they start; read whenever the node is configured."""

    auto_start: bool = parameter(
        True, 'configure and activate at start; false: wait for lifecycle transitions'
    )
    backend: str = parameter('simulated', 'source of the samples', choices=tuple(BACKENDS))
    wait_for_subscribers: int = parameter(
        1, 'the stream starts once this many subscriptions of tracker/point are matched', '', 0, 20
    )
