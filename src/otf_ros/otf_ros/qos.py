# SPDX-License-Identifier: Apache-2.0
"""Quality of service by name; every profile is chosen here and nowhere else.

All profiles are reliable, so the tools' default (reliable) subscriptions always match.
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        durability=durability,
    )


MEASUREMENT = _reliable(5000, DurabilityPolicy.VOLATILE)
"""Tracker samples: a lost sample is lost data, so reliable, and deep enough for 5 s at 1000 Hz
(trackers deliver bursts; a subscriber may be busy). Volatile: old samples are no news."""

PATH = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Nominal path and plan: published once; a node that starts later still gets the last one."""

STATUS = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""States: only the latest counts, and a late listener sees it at once."""

RESULT = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Error tables, result, alignment: each calibration replaces the one before and stays readable."""
