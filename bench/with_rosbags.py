# SPDX-License-Identifier: Apache-2.0
"""A bag read as one reads it without this project: rosbags' AnyReader, message by message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

POINT, PATH = '/tracker/point', '/planner/path'


def read_with_rosbags(bag: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (n,), ns; points (n, 3), m; corner points of the path (k, 3), m."""
    stamp, xyz, corners = [], [], []
    with AnyReader([bag]) as reader:
        wanted = [c for c in reader.connections if c.topic in (POINT, PATH)]
        for connection, _, raw in reader.messages(wanted):
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.topic == POINT:
                p, t = message.point, message.header.stamp
                stamp.append(t.sec * 1_000_000_000 + t.nanosec)
                xyz.append((p.x, p.y, p.z))
            else:
                at = (pose.pose.position for pose in message.poses)
                corners = [(p.x, p.y, p.z) for p in at]
    return np.array(stamp), np.array(xyz), np.array(corners)
