# SPDX-License-Identifier: Apache-2.0
"""Take many messages per wakeup, so that a Python node keeps up with a fast topic.

The executor of rclpy needs 0.3 to 0.5 ms per callback, whatever the callback does: about 3000
messages a second fill a core. Taking everything that is pending in one go costs 0.1 ms each.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile

from otf_ros import qos as qos_profiles
from otf_ros.timers import create_timer

AT_ONCE = 500
"""Messages of one turn, after which the node does its other work, as stating what it has taken: a
publisher that is as fast as they are taken would keep it from that for ever."""


class PolledSubscription(CallbackGroup):
    """Keeps a subscription out of the executor's wait set; a timer reads it instead."""

    def can_execute(self, entity: Any) -> bool:
        """No, never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """No, never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


def _never(message: Any) -> None:
    raise AssertionError('the message is asked for')


class Drain:
    """A subscription that hands over lists of messages.

    Parameters
    ----------
    msg_type : type
        Message class.
    callback : callable
        Called with a list of messages (never empty) in the order of their arrival, and with the
        numbers that their publisher gave them (None where the middleware does not tell).
    qos : rclpy.qos.QoSProfile
        Its depth must hold what arrives within a few periods.
    period : float
        s; how often the reader is emptied.
    """

    def __init__(
        self,
        node: Node,
        msg_type: type,
        topic: str,
        callback: Callable[[list[Any], list[int | None]], None],
        qos: QoSProfile,
        period: float = 0.02,
    ) -> None:
        self._callback = callback
        self._depth = qos.depth
        self.subscription = node.create_subscription(
            msg_type, topic, _never, qos, callback_group=PolledSubscription()
        )
        self._timer = create_timer(node, period, self.take_turn)

    def take_turn(self) -> None:
        """Hand over what is pending, but only so much that other work gets its turn."""
        self._take(AT_ONCE)

    def empty(self) -> None:
        """Hand over all that is pending: at most what the queue holds."""
        self._take(self._depth)

    def _take(self, most: int) -> None:
        messages: list[Any] = []
        numbers: list[int | None] = []
        handle, msg_type = self.subscription.handle, self.subscription.msg_type
        with handle:
            while len(messages) < most:
                received = handle.take_message(msg_type, False)
                if received is None:
                    break
                messages.append(received[0])
                numbers.append(received[1]['publication_sequence_number'])
        if messages:
            self._callback(messages, numbers)


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
            msg_type, topic, _never, qos_profiles.GLANCE, callback_group=group
        )

    def newest(self) -> Any | None:
        """Return the newest message if there is one that was not returned before."""
        handle = self._subscription.handle
        with handle:
            received = handle.take_message(self._subscription.msg_type, False)
        return received[0] if received else None
