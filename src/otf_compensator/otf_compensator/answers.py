# SPDX-License-Identifier: Apache-2.0
"""Answers to positions: any number at once, by a service."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import Point, Vector3
from rclpy.node import Node

from otf_compensator.tables import Tables
from otf_core.errors import OtfError
from otf_msgs.msg import Compensation
from otf_msgs.srv import Compensate
from otf_ros import convert


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
        header = convert.header(convert.now(self._node))
        try:
            tables = self._tables_in_use()
            points = tables.points([(p.x, p.y, p.z) for p in request.wanted], request.turned)
            found, corrected, notes = tables.ask(points)
            response.message = '; '.join(notes)
            response.compensations = [
                Compensation(
                    header=header,
                    wanted=wanted,
                    error=Vector3(**dict(zip('xyz', error, strict=True))),
                    uncertainty=Vector3(**dict(zip('xyz', u, strict=True))),
                    corrected=Point(**dict(zip('xyz', command, strict=True))),
                    inside=inside,
                )
                for wanted, error, u, command, inside in zip(
                    request.wanted,
                    found.error.tolist(),
                    found.u.tolist(),
                    corrected.tolist(),
                    found.inside.tolist(),
                    strict=True,
                )
            ]
            response.success = True
            self.count += len(points)
        except OtfError as error:
            response.message = str(error)
        return response
