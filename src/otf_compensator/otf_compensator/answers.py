# SPDX-License-Identifier: Apache-2.0
"""Answers to positions: any number at once, by a service."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import Point, Vector3
from rclpy.node import Node
from std_msgs.msg import Header

from otf_compensator.tables import CompensatedPosition, Tables
from otf_core.errors import OtfError
from otf_msgs.msg import Compensation
from otf_msgs.srv import Compensate
from otf_ros import frames


class CompensationServer:
    """``compensator/compensate``.

    Parameters
    ----------
    tables_in_use : callable
        Return the tables; InputError if nothing is to be answered now.

    Attributes
    ----------
    count : int
        Positions answered so far.
    """

    def __init__(self, node: Node, tables_in_use: Callable[[], Tables]) -> None:
        self._node, self._tables_in_use = node, tables_in_use
        self.count = 0
        node.create_service(Compensate, 'compensator/compensate', self._on_request)

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
            self.count += len(points)
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
