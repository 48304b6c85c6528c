# SPDX-License-Identifier: Apache-2.0
"""Who publishes on topics that a node reads, and why nothing comes from some of them."""

from __future__ import annotations

import time
from collections.abc import Mapping

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo

PERIOD = 1.0
"""s; the graph is looked at so often."""


UNKNOWN = 'an unknown node'


def senders(node: Node, topic: str) -> str:
    """Name the nodes that publish on a topic; which of them sent a message rclpy does not say."""
    publishers = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    return ' or '.join(sorted(set(map(name_of, publishers)))) or UNKNOWN


def name_of(publisher: TopicEndpointInfo) -> str:
    """Name the node of a publisher; a publisher can be discovered before its node is."""
    return publisher.node_name if publisher.node_namespace.startswith('/') else UNKNOWN


class TopicWatch:
    """Looks at the graph now and then.

    Parameters
    ----------
    read : mapping of str to rclpy.qos.QoSProfile
        Topics, and the quality of service that the node asks of them.
    single : str
        The one of them that only one node may publish.

    Attributes
    ----------
    publishers : int
        Of ``single``.
    troubles : list of str
        What is wrong, in words.
    """

    def __init__(self, node: Node, read: Mapping[str, QoSProfile], single: str) -> None:
        self._node, self._read, self._single = node, read, single
        self._at = 0.0
        self._first = ''
        self.publishers = 0
        self.troubles: list[str] = []

    def look(self) -> None:
        """Look again, if it is time."""
        if time.monotonic() - self._at < PERIOD:
            return
        self._at, self.troubles = time.monotonic(), []
        for topic, asked in self._read.items():
            name = self._node.resolve_topic_name(topic)
            publishers = self._node.get_publishers_info_by_topic(name)
            for publisher in publishers:
                fits, why = qos_check_compatible(publisher.qos_profile, asked)
                if fits == QoSCompatibility.ERROR:
                    self.troubles.append(
                        f'nothing comes from {name_of(publisher)} on {topic}: its quality of '
                        f'service does not fit ({why.strip("; ")})'
                    )
            if topic == self._single:
                self.publishers = len(publishers)
                if len(publishers) > 1:
                    names = ', '.join(sorted(map(name_of, publishers)))
                    self.troubles.append(
                        f'{len(publishers)} publishers on {topic} ({names}): only samples of the '
                        f'first belong to the run; end the others'
                    )
                elif publishers:
                    self._first = name_of(publishers[0])

    def second(self) -> str:
        """Name who publishes on ``single`` besides the node that was there first."""
        topic = self._node.resolve_topic_name(self._single)
        names = set(map(name_of, self._node.get_publishers_info_by_topic(topic)))
        return ' or '.join(sorted(names - {self._first} or names)) or UNKNOWN
