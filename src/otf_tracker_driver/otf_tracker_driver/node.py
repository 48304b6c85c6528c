# SPDX-License-Identifier: Apache-2.0
"""Tracker driver: lifecycle node that publishes every sample of a backend, none lost.

configure = connect, activate = stream from the beginning, deactivate = stop, cleanup = forget.
"""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from otf_core.errors import InputError, OtfError
from otf_msgs.msg import Plan, TrackerStatus
from otf_ros import app, qos, services
from otf_ros.lifecycle import SteadyLifecycleNode
from otf_ros.params import NodeParameters
from otf_tracker_driver.auto_start import AutoStart
from otf_tracker_driver.backends import BACKENDS, CommonConfig
from otf_tracker_driver.backends.base import OPERATIONS, check_common
from otf_tracker_driver.params import DriverConfig, when_they_count
from otf_tracker_driver.status import Status
from otf_tracker_driver.streamer import Streamer

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
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
        services.offer(self, 'tracker/start', self._stream)
        services.offer(self, 'tracker/stop', self._stop)
        for name in OPERATIONS:
            services.offer_lasting(self, f'tracker/{name}', partial(self._operate, name))
        self._start = AutoStart(self, self._status, self._settings.read(DriverConfig))
        self._start.begin()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Connect to the source that the parameters name."""
        config = self._settings.read(DriverConfig)
        self._status.describe(config.backend)
        kind = BACKENDS[config.backend]
        try:
            own = self._settings.read(kind.parameters, config.backend)
            backend = kind(self._settings.read(CommonConfig), own)
            self._streamer = Streamer(self, self._status, config, backend)
        except OtfError as error:
            self._start.refused(error)
            return FAILURE
        self._start.stop()
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
        return self._close(TrackerStatus.IDLE, NOT_CONFIGURED)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End for good."""
        return self._close(TrackerStatus.IDLE, 'shut down')

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up after a transition that failed unexpectedly."""
        return self._close(TrackerStatus.FAULT, 'a transition failed; configure again')

    def _close(self, state: int, text: str) -> TransitionCallbackReturn:
        self.close()
        self._status.report(state, text)
        return SUCCESS

    def close(self) -> None:
        """Stop the stream and release the source."""
        self._start.stop()
        if self._streamer:
            self._streamer.release()
            self._streamer = None

    def _on_plan(self, message: Plan) -> None:
        self._plan = message
        if self._streamer:
            self._streamer.take(message)

    def _stream(self) -> tuple[bool, str]:
        """Configure and activate, as far as that is not done; again where a stream has ended."""
        if self.lifecycle_state == 'active':
            if self._streamer and self._streamer.under_way:
                return False, 'a stream is under way; call tracker/stop first'
            self.trigger_deactivate()
        if self.lifecycle_state == 'unconfigured':
            self.trigger_configure()
        if self.lifecycle_state == 'inactive':
            self.trigger_activate()
        said = f'{self._status.message.name}: {self._status.message.message}'
        return self.lifecycle_state == 'active', said

    def _stop(self) -> tuple[bool, str]:
        if self.lifecycle_state != 'active':
            return False, f'no stream to stop: {self._status.message.message}'
        self.trigger_deactivate()
        return True, 'stopped; tracker/start streams from the beginning'

    def _operate(self, name: str) -> Future[str]:
        """Have the source do what an operator asks for; see docs/why.md."""
        if not self._streamer:
            raise InputError('no source is connected; call tracker/start, or configure')
        backend = self._status.message.backend
        own = self._settings.read(BACKENDS[backend].parameters, backend)
        return self._streamer.backend.operate(name, own)


def main(args: list[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return app.run(TrackerDriver, args)
