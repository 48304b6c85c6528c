# SPDX-License-Identifier: Apache-2.0
"""Compensator node: answers positions with their error, its uncertainty and what to command."""

from __future__ import annotations

from geometry_msgs.msg import Point, PointStamped, Vector3
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_msgs.msg import Header

from otf_compensator.params import CompensatorConfig
from otf_compensator.tables import Corrected, Tables
from otf_core.bags.cdr import frame_shown
from otf_core.errors import InputError, OtfError
from otf_core.threads import one_thread
from otf_msgs.msg import Compensation
from otf_msgs.srv import Compensate
from otf_ros import app, frames, qos, services
from otf_ros.diagnostics import PERIOD as DIAGNOSED_EVERY
from otf_ros.diagnostics import Diagnostics, Finding, Level, memory
from otf_ros.drain import Drain
from otf_ros.lifecycle import SteadyLifecycleNode
from otf_ros.params import NodeParameters

PERIOD = 0.002
"""s; how long a position waits at most: evaluating some together costs little more than one."""
QUIET = 5.0
"""s between two warnings about positions that are not answered."""
WHEN = 'counts at the next compensator/reload or configure'
INACTIVE = 'the compensator is not active; configure and activate it'
SUCCESS = TransitionCallbackReturn.SUCCESS


class Compensator(SteadyLifecycleNode):
    """``compensator/wanted`` in, ``compensator/compensation`` out; service for many at once.

    configure = read the tables, activate = answer, deactivate = answer no more, cleanup = forget.

    Raises
    ------
    OtfError
        If the tables cannot be read at start and ``auto_start`` is set. Later
        ``compensator/reload`` says so, and the tables that were read last stay.
    """

    def __init__(self) -> None:
        super().__init__('compensator')
        self._settings = NodeParameters(self, CompensatorConfig, read_only=['auto_start'])
        self._settings.tell_when(lambda names: WHEN if 'tables_file' in names else '')
        self._tables: Tables | None = None
        self._active = False
        self._answered = self._answered_before = 0
        self._error: OtfError | None = None
        self._publisher = self.create_publisher(
            Compensation, 'compensator/compensation', qos.COMMAND
        )
        self.create_service(Compensate, 'compensator/compensate', self._on_request)
        services.offer(self, 'compensator/reload', self._reload)
        Diagnostics(self, self._machine, {'tables': self._look_at_tables, 'memory': memory})
        if self._settings.read(CompensatorConfig).auto_start:
            self.trigger_configure()
            if self._error:
                raise self._error
            self.trigger_activate()
        # last: positions may come at once
        Drain(self, PointStamped, 'compensator/wanted', self._on_wanted, qos.COMMAND, PERIOD)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the tables that the parameters name."""
        try:
            self._tables = self._read()
        except OtfError as error:
            self._error = error
            self.get_logger().error(f'{error}; correct it and configure again')
            return TransitionCallbackReturn.FAILURE
        self._error = None
        self.get_logger().info(self._tables.words)
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer from now on."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer no more."""
        self._active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the tables; the next configure reads the parameters anew."""
        self._tables = None
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End for good."""
        self._tables, self._active = None, False
        return SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything after a transition that failed unexpectedly."""
        return self.on_shutdown(state)

    def _machine(self) -> str:
        return self._tables.machine if self._tables else ''

    def _look_at_tables(self) -> Finding:
        """Which tables are in use, and how much they are asked."""
        rate = (self._answered - self._answered_before) / DIAGNOSED_EVERY
        self._answered_before = self._answered
        values = {'state': self.lifecycle_state, 'answers [1/s]': rate}
        if self._tables is None or not self._active:
            return Finding(Level.WARN, f'nothing is answered: {INACTIVE}', values)
        return Finding(Level.OK, self._tables.words, values)

    def _read(self) -> Tables:
        return Tables(self._settings.read(CompensatorConfig).tables_file)

    def _reload(self) -> tuple[bool, str]:
        if self._tables is None:
            return False, 'not configured; configure reads the tables'
        try:
            self._tables = self._read()
        except OtfError as error:
            return False, f'{error}; the tables read before stay'
        return True, self._tables.words

    def _in_use(self) -> Tables:
        """Return the tables; InputError if the node is not active."""
        if self._tables is None or not self._active:
            raise InputError(INACTIVE)
        return self._tables

    def _on_wanted(self, messages: list[PointStamped], numbers: list[int | None]) -> None:
        own = [m for m in messages if m.header.frame_id == frames.machine()]
        if len(own) < len(messages):
            others = {m.header.frame_id for m in messages} - {frames.machine()}
            named = ', '.join(map(frame_shown, sorted(others)))
            self._refused(f'frame_id is {named}, expected {frames.machine()!r}')
        if not own:
            return
        try:
            points, tables = [_tuple(m.point) for m in own], self._in_use()
            tables.notes(points)
            for message, found in zip(own, tables.ask(points), strict=True):
                self._answered += 1
                self._publisher.publish(_message(found, message.header))
        except OtfError as error:
            self._refused(str(error))

    def _refused(self, why: str) -> None:
        self.get_logger().warning(
            f'compensator/wanted not answered: {why}', throttle_duration_sec=QUIET
        )

    def _on_request(
        self, request: Compensate.Request, response: Compensate.Response
    ) -> Compensate.Response:
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=frames.machine())
        points = [_tuple(p) for p in request.wanted]
        try:
            tables = self._in_use()
            response.message = '; '.join(tables.notes(points))
            response.compensations = [_message(f, header) for f in tables.ask(points)]
            response.success = True
        except OtfError as error:
            response.message = str(error)
        return response


def _tuple(point: Point) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def _message(found: Corrected, header: Header) -> Compensation:
    (x, y, z), (a, b, c) = found.wanted, found.corrected
    (ex, ey, ez), (ux, uy, uz) = found.error, found.uncertainty
    return Compensation(
        header=header,
        wanted=Point(x=x, y=y, z=z),
        error=Vector3(x=ex, y=ey, z=ez),
        uncertainty=Vector3(x=ux, y=uy, z=uz),
        corrected=Point(x=a, y=b, z=c),
        inside=found.inside,
    )


def main(args: list[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    with one_thread():
        return app.run(Compensator, args)


if __name__ == '__main__':
    raise SystemExit(main())
