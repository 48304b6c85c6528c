# SPDX-License-Identifier: Apache-2.0
"""Compensator node: answers positions with their error, its uncertainty and what to command."""

from __future__ import annotations

from geometry_msgs.msg import Point, PointStamped, Vector3
from rclpy.node import Node
from std_msgs.msg import Header

from otf_compensator.params import CompensatorConfig
from otf_compensator.tables import Corrected, Tables
from otf_core.bags.cdr import frame_shown
from otf_core.errors import OtfError
from otf_core.threads import one_thread
from otf_msgs.msg import Compensation
from otf_msgs.srv import Compensate
from otf_ros import app, frames, qos, services
from otf_ros.drain import Drain
from otf_ros.params import NodeParameters

PERIOD = 0.002
"""s; how long a position waits at most: evaluating some together costs little more than one."""
QUIET = 5.0
"""s between two warnings about positions that are not answered."""


class Compensator(Node):
    """``compensator/wanted`` in, ``compensator/compensation`` out; service for many at once.

    Raises
    ------
    OtfError
        If the tables cannot be read at start. Later ``compensator/reload`` says so, and the
        tables that were read last stay.
    """

    def __init__(self) -> None:
        super().__init__('compensator')
        self._settings = NodeParameters(self, CompensatorConfig)
        self._tables = self._read()
        self.get_logger().info(self._tables.words)
        self._publisher = self.create_publisher(
            Compensation, 'compensator/compensation', qos.COMMAND
        )
        self.create_service(Compensate, 'compensator/compensate', self._on_request)
        services.offer(self, 'compensator/reload', self._reload)
        # last: positions may come at once
        Drain(self, PointStamped, 'compensator/wanted', self._on_wanted, qos.COMMAND, PERIOD)

    def _read(self) -> Tables:
        return Tables(self._settings.read(CompensatorConfig).tables_file)

    def _reload(self) -> tuple[bool, str]:
        try:
            self._tables = self._read()
        except OtfError as error:
            return False, f'{error}; the tables read before stay'
        return True, self._tables.words

    def _on_wanted(self, messages: list[PointStamped], numbers: list[int | None]) -> None:
        own = [m for m in messages if m.header.frame_id == frames.machine()]
        if len(own) < len(messages):
            others = {m.header.frame_id for m in messages} - {frames.machine()}
            named = ', '.join(map(frame_shown, sorted(others)))
            self._refused(f'frame_id is {named}, expected {frames.machine()!r}')
        if not own:
            return
        try:
            points = [_tuple(m.point) for m in own]
            self._tables.notes(points)
            for message, found in zip(own, self._tables.ask(points), strict=True):
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
            response.message = '; '.join(self._tables.notes(points))
            response.compensations = [_message(f, header) for f in self._tables.ask(points)]
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
