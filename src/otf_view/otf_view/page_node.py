# SPDX-License-Identifier: Apache-2.0
"""Page node: serves a page on the run under way to any browser."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node

from otf_core.live.live_run import now, scene
from otf_ros.params import NodeParameters
from otf_ros.timers import create_timer
from otf_view.listening import LiveRunListener
from otf_view.params import PageConfig
from otf_view.server import PageServer

PERIOD = 0.5
"""s between updates."""


class Page(Node):
    """Serves the page at the address of its parameters.

    Raises
    ------
    OtfError
        If a parameter is wrong or the address cannot be taken.
    """

    def __init__(self) -> None:
        super().__init__('page')
        config = NodeParameters(self, PageConfig, read_only=('host', 'port')).read(PageConfig)
        self._ears = LiveRunListener(self)
        self._server = PageServer(config.host, config.port)
        self._shown = -1
        self._offered: Path | None = None
        self._update()
        create_timer(self, PERIOD, self._update)
        self.get_logger().info(f'live view at {self._server.url}')

    def close(self) -> None:
        """Show the latest, and that it is the last."""
        self._update()
        self._server.close()

    def _update(self) -> None:
        run = self._ears.run
        if self._shown != self._ears.news:
            self._shown = self._ears.news
            self._server.put('scene', scene(run))
        self._server.put('now', now(run))
        if self._ears.folder != self._offered and self._server.offer(self._ears.folder):
            self._offered = self._ears.folder  # the report is written after the result is out
