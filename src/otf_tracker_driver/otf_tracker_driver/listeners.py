# SPDX-License-Identifier: Apache-2.0
"""Who listens to the samples: calibrators count, recorders and viewers do not.

A calibrator is a node that subscribes to the samples and publishes an
``otf_msgs/msg/CalibratorState``, on whatever topic: names, namespaces, remappings do not matter.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

from rclpy.node import Node, NodeNameNonExistentError
from rclpy.subscription import Subscription

from otf_msgs.msg import CalibratorState
from otf_ros import qos

CALIBRATOR = 'otf_msgs/msg/CalibratorState'


class Calibrators:
    """The calibrators that subscribe to a topic, as far as the graph is known.

    Parameters
    ----------
    topic : str
        Full name of the topic of the samples.
    hear : callable
        Called with the topic of a calibrator's state, which names it, and every state of it.

    Attributes
    ----------
    count : int
        Of them, as of the last look.
    """

    def __init__(
        self, node: Node, topic: str, hear: Callable[[str, CalibratorState], None]
    ) -> None:
        self._node, self._topic, self._hear = node, topic, hear
        self._states: dict[str, Subscription] = {}
        self._looked = -math.inf
        self.count = 0

    def look(self, after: float) -> bool:
        """Look at the graph again if the last look is so long ago, s; return whether it was."""
        if time.monotonic() - self._looked < after:
            return False
        self._looked = time.monotonic()
        subscribers = {
            (info.node_namespace, info.node_name)
            for info in self._node.get_subscriptions_info_by_topic(self._topic)
            if info.node_namespace.startswith('/')  # else its node is not discovered yet
        }
        found = [topics for place in subscribers if (topics := self._states_of(*place))]
        self.count = len(found)
        names = {name for topics in found for name in topics}
        for gone in self._states.keys() - names:
            self._node.destroy_subscription(self._states.pop(gone))
        for name in names - self._states.keys():
            self._states[name] = self._node.create_subscription(
                CalibratorState, name, partial(self._hear, name), qos.STATUS
            )
        return True

    @property
    def names(self) -> frozenset[str]:
        """Topics of their states, as of the last look."""
        return frozenset(self._states)

    def close(self) -> None:
        """Hear them no more."""
        for state in self._states.values():
            self._node.destroy_subscription(state)
        self._states.clear()

    def _states_of(self, namespace: str, name: str) -> list[str]:
        try:
            offered = self._node.get_publisher_names_and_types_by_node(name, namespace)
        except NodeNameNonExistentError:  # not discovered yet, or gone
            return []
        return [topic for topic, types in offered if CALIBRATOR in types]
