# SPDX-License-Identifier: Apache-2.0
"""Timers that run on steady time: neither a simulated clock nor a set time of day stops them."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer


def create_timer(
    node: Node, period: float, callback: Callable[[], None], autostart: bool = True
) -> Timer:
    """Return a timer of a node.

    Parameters
    ----------
    period : float
        s of the computer, whatever the parameter ``use_sim_time`` says.
    autostart : bool
        False: it waits for ``reset``.
    """
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    return node.create_timer(period, callback, clock=steady, autostart=autostart)
