# SPDX-License-Identifier: Apache-2.0
"""A driver whose source is not there yet: it stays unconfigured, says so, and tries again."""

from __future__ import annotations

import time

from otf_core.errors import OtfError
from otf_ros import app
from otf_ros.lifecycle import SteadyLifecycleNode
from otf_ros.timers import create_timer
from otf_tracker_driver.backends.base import Unreachable
from otf_tracker_driver.params import DriverConfig
from otf_tracker_driver.status import Status

FIRST_PAUSE = 1.0
"""s; between attempts, doubled each time."""


class AutoStart:
    """Configures and activates a node, at once if ``auto_start``, or when its source is there.

    Once the node was configured by hand, people decide what happens.

    Parameters
    ----------
    node : SteadyLifecycleNode
        Calls ``refused`` when it cannot be configured.
    """

    def __init__(self, node: SteadyLifecycleNode, status: Status, config: DriverConfig) -> None:
        self._node, self._status, self._longest = node, status, config.longest_retry
        self._timer = create_timer(node, FIRST_PAUSE, self._attempt, autostart=False)
        self._attempts, self._pause = 0, min(FIRST_PAUSE, self._longest)
        self._since, self._going = time.monotonic(), config.auto_start
        self._error: OtfError | None = None

    def begin(self) -> None:
        """Begin, if the node shall start by itself.

        Raises
        ------
        OtfError
            If it cannot be configured, and will not be by waiting; later in the executor.
        """
        if self._going:
            self._attempt()

    def stop(self) -> None:
        """Try no more."""
        self._going = False
        self._timer.cancel()

    def refused(self, error: OtfError) -> None:
        """Say why the node cannot be configured, and what comes next."""
        self._error = error
        if not self._may_pass():
            self._status.fault(f'{error}; correct it and configure again')
            return
        text = (
            f'{error}; {self._attempts} attempt{"s" if self._attempts > 1 else ""} in '
            f'{time.monotonic() - self._since:.0f} s, the next one in {self._pause:.0f} s; '
            f'configure to try at once'
        )
        self._status.wait(text, self._since)

    def _may_pass(self) -> bool:
        return self._going and self._longest > 0 and isinstance(self._error, Unreachable)

    def _attempt(self) -> None:
        """Configure and activate, or get ready to try again."""
        self._timer.cancel()
        if self._node.lifecycle_state != 'unconfigured':
            self._going = False
            return
        self._attempts, self._error = self._attempts + 1, None
        self._node.trigger_configure()
        if app.is_ending():
            return
        if self._error is None:
            self._node.trigger_activate()
        elif self._may_pass():
            self._timer.timer_period_ns = round(self._pause * 1e9)
            self._timer.reset()
            self._pause = min(2 * self._pause, self._longest)
        else:
            raise self._error
