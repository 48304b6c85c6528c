# SPDX-License-Identifier: Apache-2.0
"""Axis positions as effects use them: scaled to the range, and measured from the fixed point."""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import State


def scaled_position(state: State) -> Array:
    """Positions scaled to [-1, 1] over the axis ranges, shape (n, 3)."""
    low, high = state.machine.lower, state.machine.upper
    return np.asarray((2.0 * state.q - low - high) / (high - low))


def travel_from_reference(state: State) -> Array:
    """Positions less the reference position of each axis: zero, else its minimum; (n, 3), m."""
    low, high = state.machine.lower, state.machine.upper
    reference = np.where((low <= 0.0) & (high >= 0.0), 0.0, low)
    return np.asarray(state.q - reference)
