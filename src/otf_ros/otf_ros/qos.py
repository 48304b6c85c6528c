# SPDX-License-Identifier: Apache-2.0
"""Quality of service by name; every profile is chosen here and nowhere else.

All publishers are reliable, so the tools' default (reliable) subscriptions always match.
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _profile(
    depth: int,
    durability: DurabilityPolicy,
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE,
) -> QoSProfile:
    return QoSProfile(
        reliability=reliability,
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        durability=durability,
    )


MEASUREMENT = _profile(20000, DurabilityPolicy.VOLATILE)
"""Tracker samples: a lost sample is lost data, so reliable, and deep enough for 20 s at 1000 Hz or
4 s of a replay at 5000 Hz, should a subscriber be held up. Memory is taken only as the queue
fills. Volatile: old samples are no news."""

PATH = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Nominal path and plan: published once; a node that starts later still gets the last one."""

PARTS = _profile(100, DurabilityPolicy.TRANSIENT_LOCAL)
"""Parts of a run of a machine with rotary axes, one message each: a node that starts later gets
all of them, in their order."""

STATUS = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""States: only the latest counts, and a late listener sees it at once."""

EVENTS = _profile(1000, DurabilityPolicy.TRANSIENT_LOCAL)
"""What happens now and then and must not be missed: gaps of the stream, also by late listeners."""

DIAGNOSTICS = _profile(10, DurabilityPolicy.VOLATILE)
"""``/diagnostics``: as diagnostic_updater publishes it; told anew every second."""

RESULT = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Tables, result, alignment, gap report: each replaces the one before and stays readable."""

GLANCE = _profile(1, DurabilityPolicy.VOLATILE, ReliabilityPolicy.BEST_EFFORT)
"""For subscriptions only: the newest sample, looked at now and then. What is missed is not wanted,
and the publisher neither waits for it nor keeps anything."""

PICTURE = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Markers: every message is the whole picture, and a viewer that starts later sees it at once."""

SCALAR = _profile(10, DurabilityPolicy.VOLATILE)
"""A number for plots, a few per second: ten hold what a busy plotter has not taken yet."""

SIGNAL = _profile(1000, DurabilityPolicy.VOLATILE, ReliabilityPolicy.BEST_EFFORT)
"""For subscriptions only: temperatures and states of the machine, which sensors publish reliably
or not; a value that is missed is bridged by its neighbours."""
