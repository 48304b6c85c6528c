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


MEASUREMENT = _reliable(20000, DurabilityPolicy.VOLATILE)
"""Tracker samples: a lost sample is lost data, so reliable, and deep enough for 20 s at 1000 Hz or
4 s of a replay at 5000 Hz, should a subscriber be held up. Memory is taken only as the queue
fills. Volatile: old samples are no news."""

PATH = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Nominal path and plan: published once; a node that starts later still gets the last one."""

STATUS = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""States: only the latest counts, and a late listener sees it at once."""

EVENTS = _reliable(1000, DurabilityPolicy.TRANSIENT_LOCAL)
"""What happens now and then and must not be missed: gaps of the stream, also by late listeners."""

DIAGNOSTICS = _reliable(10, DurabilityPolicy.VOLATILE)
"""``/diagnostics``: as diagnostic_updater publishes it; told anew every second."""

RESULT = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Tables, result, alignment, gap report: each replaces the one before and stays readable."""
