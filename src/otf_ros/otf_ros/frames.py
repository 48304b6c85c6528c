# SPDX-License-Identifier: Apache-2.0
"""What the two frames are called in the messages of this process, which has one node.

Journals and bags keep the names of the contract, whatever the graph calls the frames.
"""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.config import Parameters, parameter
from otf_core.errors import ConfigError

MACHINE, TRACKER = 'machine', 'tracker'
"""Names of the contract."""


@dataclass(frozen=True)
class FramesConfig(Parameters):
    """Names of the frames; several cells in one tf tree need different ones."""

    machine_frame: str = parameter(MACHINE, 'frame_id of path, tables and positions')
    tracker_frame: str = parameter(TRACKER, 'frame_id of the samples')


_used = FramesConfig()


def use(config: FramesConfig) -> None:
    """Call the frames so from now on.

    Raises
    ------
    ConfigError
        If a name is empty or both are the same.
    """
    global _used
    if not config.machine_frame or not config.tracker_frame:
        raise ConfigError('parameter machine_frame or tracker_frame: empty; name the frame')
    if config.machine_frame == config.tracker_frame:
        raise ConfigError(
            f'parameter tracker_frame: {config.tracker_frame!r} is the machine frame'
        )
    _used = config


def machine() -> str:
    """Name of the frame of the machine."""
    return _used.machine_frame


def tracker() -> str:
    """Name of the frame of the samples."""
    return _used.tracker_frame
