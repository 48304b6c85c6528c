# SPDX-License-Identifier: Apache-2.0
"""The calibrators that take the samples: a source that can wait does not run far ahead of them.

A calibrator is a node that subscribes to the samples and publishes an
``otf_msgs/msg/CalibratorState``, on whatever topic; recorders and viewers do not count. It states
the stamp of the last sample that it has taken. Samples arrive in their order, so all before that
one have arrived or are lost.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from rclpy.node import Node
from rclpy.subscription import Subscription

from otf_msgs.msg import CalibratorState
from otf_ros import qos

CALIBRATOR = 'otf_msgs/msg/CalibratorState'
LOOK = 1.0
"""s; how often it is looked who listens while samples flow."""
AHEAD = 4000
"""Samples on their way: a fifth of what the queues hold, and less than a recorder's 5000."""
UNTAKEN = 10
"""States of a calibrator, one each half second, without a sample taken: what was published before
is lost. It was published before the calibrator could hear it, or to the one before."""
UNHEARD = 10.0
"""s; a calibrator that states nothing for so long after it was seen is not waited for."""


@dataclass
class Place:
    """Where a calibrator is in the stream: samples taken, or lost to it."""

    state: Subscription
    seen: float
    passed: int = 0
    untaken: int = 0
    heard: bool = False

    def hear(self, taken: int, published: int) -> None:
        """Process a state: samples of the stream up to the last one taken, and those published."""
        self.heard = True
        if taken > self.passed:
            self.passed, self.untaken = taken, 0
        elif published > self.passed:
            self.untaken += 1
            if self.untaken >= UNTAKEN:
                self.passed, self.untaken = published, 0


class Calibrators:
    """Those that subscribe to a topic, as far as the graph is known.

    Parameters
    ----------
    topic : str
        Full name of the topic of the samples.
    taken : callable
        Number of samples of the stream up to the last one that a state says is taken.
    """

    def __init__(self, node: Node, topic: str, taken: Callable[[CalibratorState], int]) -> None:
        self._node, self._topic, self._taken = node, topic, taken
        self._places: dict[str, Place] = {}
        self._looked = -math.inf
        self.published = 0

    def begin(self) -> None:
        """Begin a stream: those that listen take its first sample."""
        self.published = 0
        for place in self._places.values():
            place.passed, place.untaken, place.seen = 0, 0, time.monotonic()

    def count(self) -> int:
        """Look at the graph and return how many there are; one that comes later begins there."""
        self._looked, node = time.monotonic(), self._node
        listening = {
            (info.node_namespace, info.node_name)
            for info in node.get_subscriptions_info_by_topic(self._topic)
            if info.node_namespace.startswith('/')  # else its node is not discovered yet
        }
        found = {
            name
            for name, types in node.get_topic_names_and_types()
            if CALIBRATOR in types
            for info in node.get_publishers_info_by_topic(name)
            if (info.node_namespace, info.node_name) in listening
        }
        for gone in self._places.keys() - found:
            node.destroy_subscription(self._places.pop(gone).state)
        for name in found - self._places.keys():
            hear = partial(self._hear, name)
            state = node.create_subscription(CalibratorState, name, hear, qos.STATUS)
            self._places[name] = Place(state, self._looked, self.published)
        return len(found)

    def allowed(self) -> int | None:
        """Samples of the stream that may be published; None if no calibrator is waited for."""
        now = time.monotonic()
        if now - self._looked > LOOK:
            self.count()
        waited_for = [p for p in self._places.values() if p.heard or now - p.seen < UNHEARD]
        return min(p.passed for p in waited_for) + AHEAD if waited_for else None

    def close(self) -> None:
        """Hear them no more."""
        for place in self._places.values():
            self._node.destroy_subscription(place.state)
        self._places.clear()

    def _hear(self, name: str, message: CalibratorState) -> None:
        if name in self._places:
            self._places[name].hear(self._taken(message), self.published)
