# SPDX-License-Identifier: Apache-2.0
"""Tracker driver: lifecycle node that publishes every sample of a backend, none lost.

configure = connect, activate = stream from the beginning, deactivate = stop, cleanup = forget.
"""

from __future__ import annotations

from concurrent.futures import Future

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from otf_core.errors import InputError, OtfError
from otf_msgs.msg import Plan, TrackerStatus
from otf_ros import app, qos
from otf_ros.diagnostics import Diagnostics
from otf_ros.lifecycle import SteadyLifecycleNode
from otf_ros.params import NodeParameters
from otf_tracker_driver.backends import BACKENDS, Backend, CommonConfig
from otf_tracker_driver.backends.base import check_common
from otf_tracker_driver.diagnostics import tasks
from otf_tracker_driver.operations import offer_operations
from otf_tracker_driver.params import DriverConfig, when_they_count
from otf_tracker_driver.status import Status
from otf_tracker_driver.streamer import Streamer
from otf_tracker_driver.waiting import Waiting

SUCCESS = TransitionCallbackReturn.SUCCESS
NOT_CONFIGURED = 'not configured; configure, then activate to stream'


class TrackerDriver(SteadyLifecycleNode):
    """Publishes ``tracker/point`` and ``tracker/status``; listens to ``planner/plan``.

    Raises
    ------
    OtfError
        If ``auto_start`` is set and it cannot start as its parameters say; not if the source is
        only not there yet.
    """

    def __init__(self) -> None:
        super().__init__('tracker_driver')
        own = {name: backend.parameters for name, backend in BACKENDS.items()}
        groups = (DriverConfig, CommonConfig)
        self._settings = NodeParameters(
            self, *groups, named=own, read_only=['auto_start', 'longest_retry']
        )
        self._settings.check_also(CommonConfig, check_common)
        self._settings.tell_when(lambda names: when_they_count(names, self.lifecycle_state))
        self._streamer: Streamer | None = None
        self._plan: Plan | None = None
        self._status = Status(self)
        self._status.report(TrackerStatus.IDLE, NOT_CONFIGURED)
        self.create_subscription(Plan, 'planner/plan', self._on_plan, qos.PATH)
        offer_operations(self, self._status, self._operate, self._under_way)
        Diagnostics(self, lambda: self._status.hardware, tasks(self._status))
        self._waiting = Waiting(self, self._status, self._settings.read(DriverConfig))
        self._waiting.start()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Connect to the source that the parameters name."""
        config = self._settings.read(DriverConfig)
        self._status.describe(config.backend)
        try:
            backend = self._make_backend(config.backend)
            self._streamer = Streamer(self, self._status, config, backend)
        except OtfError as error:
            self._waiting.refused(error)
            return TransitionCallbackReturn.FAILURE
        self._waiting.stop()
        self._status.report(TrackerStatus.IDLE, f'{self._streamer.description}; not activated')
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stream from the beginning as soon as source and subscribers are ready."""
        if self._streamer:
            self._status.report(TrackerStatus.IDLE, 'activated; the stream is about to begin')
            self._streamer.begin(self._plan)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the stream."""
        if self._streamer:
            self._streamer.stop()
        self._status.report(TrackerStatus.IDLE, 'stopped; activate to stream from the beginning')
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the source; the next configure reads the parameters anew."""
        self.close()
        self._status.report(TrackerStatus.IDLE, NOT_CONFIGURED)
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End for good."""
        self.close()
        self._status.report(TrackerStatus.IDLE, 'shut down')
        return SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up after a transition that failed unexpectedly."""
        self.close()
        self._status.report(TrackerStatus.FAULT, 'a transition failed; configure again')
        return SUCCESS

    def close(self) -> None:
        """Stop the stream and release the source."""
        self._waiting.stop()
        if self._streamer:
            self._streamer.release()
            self._streamer = None

    def _under_way(self) -> bool:
        return self._streamer is not None and self._streamer.under_way

    def _operate(self, name: str) -> Future[str]:
        backend = self._status.message.backend
        if not self._streamer:
            raise InputError('no source is connected; call tracker/start, or configure')
        own = self._settings.read(BACKENDS[backend].parameters, backend)
        return self._streamer.operate(name, own)

    def _make_backend(self, name: str) -> Backend:
        kind = BACKENDS[name]
        own = self._settings.read(kind.parameters, name)
        return kind(self._settings.read(CommonConfig), own)

    def _on_plan(self, message: Plan) -> None:
        self._plan = message
        if self._streamer:
            self._streamer.take(message)


def main(args: list[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return app.run(TrackerDriver, args)


if __name__ == '__main__':
    raise SystemExit(main())
