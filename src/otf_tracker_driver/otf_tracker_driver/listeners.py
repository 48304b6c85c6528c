# SPDX-License-Identifier: Apache-2.0
"""Who listens to the samples: calibrators count, recorders and viewers do not.

A calibrator is a node that subscribes to the samples and publishes an
``otf_msgs/msg/CalibratorState``, on whatever topic: names, namespaces, remappings do not matter.
"""

from __future__ import annotations

from rclpy.node import Node, NodeNameNonExistentError

CALIBRATOR = 'otf_msgs/msg/CalibratorState'


def calibrators(node: Node, topic: str) -> int:
    """Count the calibrators that subscribe to a topic, as far as the graph is known.

    Parameters
    ----------
    topic : str
        Its full name.
    """
    subscribers = {
        (info.node_namespace, info.node_name)
        for info in node.get_subscriptions_info_by_topic(topic)
        if info.node_namespace.startswith('/')  # else its node is not discovered yet
    }
    return sum(_publishes_state(node, *place) for place in subscribers)


def _publishes_state(node: Node, namespace: str, name: str) -> bool:
    try:
        offered = node.get_publisher_names_and_types_by_node(name, namespace)
    except NodeNameNonExistentError:  # not discovered yet, or gone
        return False
    return any(CALIBRATOR in types for _, types in offered)
