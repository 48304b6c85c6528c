# SPDX-License-Identifier: Apache-2.0
"""Services of type Trigger: an action that tells whether it was done (docs/decisions/0008)."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_srvs.srv import Trigger


def offer(node: Node, name: str, action: Callable[[], tuple[bool, str]]) -> None:
    """Offer a service; what it answers is logged as well.

    Parameters
    ----------
    node : rclpy.node.Node
    name : str
    action : callable
        Returns at once: success, and one sentence on what was done or what to do first.
    """

    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = action()
        if response.success:  # rclpy wants one severity per line of code
            node.get_logger().info(f'{name}: {response.message}')
        else:
            node.get_logger().warning(f'{name}: {response.message}')
        return response

    node.create_service(Trigger, name, answer)
