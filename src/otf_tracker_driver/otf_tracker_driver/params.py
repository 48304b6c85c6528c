# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tracker driver itself; every backend declares its own in its file."""

from __future__ import annotations

from collections.abc import Collection
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
    longest_retry: float = parameter(
        10.0, 'longest pause between attempts to reach a source that is not there at start; 0: '
        'the node ends with an error instead', 's', 0.0, 600.0,
    )  # fmt: skip
    wait_for_subscribers: int = parameter(
        1, 'number of calibrators subscribed to tracker/point at which the stream starts; '
        'recorders and other subscribers do not count', '', 0, 20,
    )  # fmt: skip


def when_they_count(names: Collection[str], state: str) -> str:
    """State when parameters count that are set now; nothing if at once.

    Parameters
    ----------
    state : str
        Of the lifecycle.
    """
    if state not in ('inactive', 'active') or set(names) == {'use_sim_time'}:
        return ''
    text = f'counts when the driver is configured next; it is {state} now'
    if 'emscon.reflector' in names:
        text += '; tracker/set_reflector sets the reflector before that'
    return text
