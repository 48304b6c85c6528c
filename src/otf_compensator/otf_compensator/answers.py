# SPDX-License-Identifier: Apache-2.0
"""Answers to positions: one by one on a topic, many at once by a service."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import Point, PointStamped, Vector3
from rclpy.node import Node
from std_msgs.msg import Header

from otf_compensator.tables import CompensatedPosition, Tables
from otf_core.bags.cdr import frame_shown
from otf_core.errors import OtfError
from otf_msgs.msg import Compensation
from otf_msgs.srv import Compensate
from otf_ros import frames, qos
from otf_ros.drain import Drain

PERIOD = 0.002
"""s; how long a position waits at most: evaluating some together costs little more than one."""
WARNING_INTERVAL = 5.0
"""s between two warnings about positions that are not answered."""


class CompensationServer:
    """``compensator/wanted`` to ``compensator/compensation``, and ``compensator/compensate``.

    Parameters
    ----------
    tables_in_use : callable
        Return the tables; InputError if nothing is to be answered now.
    """

    def __init__(self, node: Node, tables_in_use: Callable[[], Tables]) -> None:
        self._node, self._tables_in_use = node, tables_in_use
        self.count = 0
        """Positions answered on the topic so far."""
        self._publisher = node.create_publisher(
            Compensation, 'compensator/compensation', qos.COMMAND
        )
        node.create_service(Compensate, 'compensator/compensate', self._on_request)

    def listen(self) -> None:
        """Take positions from now on."""
        topic = 'compensator/wanted'
        Drain(self._node, PointStamped, topic, self._on_wanted, qos.COMMAND, PERIOD)

    def _on_wanted(self, messages: list[PointStamped], numbers: list[int | None]) -> None:
        own = [m for m in messages if m.header.frame_id == frames.machine()]
        if len(own) < len(messages):
            others = {m.header.frame_id for m in messages} - {frames.machine()}
            named = ', '.join(map(frame_shown, sorted(others)))
            self._warn(f'frame_id is {named}, expected {frames.machine()!r}')
        if not own:
            return
        try:
            points, tables = [_tuple(m.point) for m in own], self._tables_in_use()
            tables.notes(points)
            for message, answer in zip(own, tables.ask(points), strict=True):
                self.count += 1
                self._publisher.publish(_message(answer, message.header))
        except OtfError as error:
            self._warn(str(error))

    def _warn(self, why: str) -> None:
        self._node.get_logger().warning(
            f'compensator/wanted not answered: {why}', throttle_duration_sec=WARNING_INTERVAL
        )

    def _on_request(
        self, request: Compensate.Request, response: Compensate.Response
    ) -> Compensate.Response:
        stamp = self._node.get_clock().now().to_msg()
        header = Header(stamp=stamp, frame_id=frames.machine())
        points = [_tuple(p) for p in request.wanted]
        try:
            tables = self._tables_in_use()
            response.message = '; '.join(tables.notes(points))
            response.compensations = [_message(f, header) for f in tables.ask(points)]
            response.success = True
        except OtfError as error:
            response.message = str(error)
        return response


def _tuple(point: Point) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def _message(answer: CompensatedPosition, header: Header) -> Compensation:
    (x, y, z), (a, b, c) = answer.wanted, answer.corrected
    (ex, ey, ez), (ux, uy, uz) = answer.error, answer.uncertainty
    return Compensation(
        header=header,
        wanted=Point(x=x, y=y, z=z),
        error=Vector3(x=ex, y=ey, z=ez),
        uncertainty=Vector3(x=ux, y=uy, z=uz),
        corrected=Point(x=a, y=b, z=c),
        inside=answer.inside,
    )
