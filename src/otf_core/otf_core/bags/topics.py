# SPDX-License-Identifier: Apache-2.0
"""The topics of a bag: name, message type, frame and quality of service."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Topic:
    """A topic as other tools know it.

    Attributes
    ----------
    name, type, frame : str
        An empty frame stands for any.
    depth : int
        Messages a publisher keeps for a reliable reader.
    durability : str
        ``transient_local`` where a late reader gets the last message.
    """

    name: str
    type: str
    frame: str
    depth: int
    durability: str


POINT = Topic('/tracker/point', 'geometry_msgs/msg/PointStamped', 'tracker', 1000, 'volatile')
PATH = Topic('/planner/path', 'nav_msgs/msg/Path', 'machine', 1, 'transient_local')
AXES = Topic('/planner/axes', 'trajectory_msgs/msg/JointTrajectory', '', 1, 'transient_local')
"""In place of a path, of machines with rotary axes: a message for every part of a run; its frame
names the target."""
STATUS = Topic('/tracker/status', 'otf_msgs/msg/TrackerStatus', 'tracker', 1, 'transient_local')
"""Only in journals; nothing depends on it offline."""
GAP = Topic('/tracker/gap', 'otf_msgs/msg/TrackerGap', 'tracker', 1000, 'transient_local')
"""The same: breaks of the stream as the driver states them."""
OTHER_POINT = Topic('/tracker/point_other', POINT.type, POINT.frame, POINT.depth, POINT.durability)
"""Only in journals: samples of a second publisher, which are no part of the run."""


def called(topic: Topic, name: str | None) -> Topic:
    """Return a topic under another name, whose frame is then as it comes; None: as it is."""
    if name is None:
        return topic
    return replace(topic, name='/' + name.removeprefix('/'), frame='')
