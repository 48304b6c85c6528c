# SPDX-License-Identifier: Apache-2.0
"""Look at the newest message of a fast topic now and then, without being woken by every one."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from otf_ros import qos
from otf_ros.drain import PolledSubscription


class LatestMessage:
    """A subscription of which only the newest message is read, when it is asked for.

    Parameters
    ----------
    msg_type : type
        Message class.
    """

    def __init__(self, node: Node, msg_type: type, topic: str) -> None:
        group = PolledSubscription()
        self._subscription = node.create_subscription(
            msg_type, topic, self._never, qos.GLANCE, callback_group=group
        )

    @staticmethod
    def _never(message: Any) -> None:
        raise AssertionError('the message is asked for')

    def newest(self) -> Any | None:
        """Return the newest message if there is one that was not returned before."""
        handle = self._subscription.handle
        with handle:
            received = handle.take_message(self._subscription.msg_type, False)
        return received[0] if received else None
