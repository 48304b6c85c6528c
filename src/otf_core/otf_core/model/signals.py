# SPDX-License-Identifier: Apache-2.0
"""Signals beside the samples: temperatures, states, pressures over the time of a recording.

What warms up follows its temperature with a lag. A lag is that of first order,
tau dy/dt = x - y, from rest at the first value, exact for a signal that stays between its samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array

LAGS = (15.0, 30.0, 60.0, 120.0, 240.0, 480.0)
"""s; time constants that are tried beside none: one is always within a factor of 1.4, which leaves
a few percent of what follows the signal; wider steps leave enough to prefer functions of time."""


@dataclass(frozen=True, eq=False)
class Signal:
    """Values of one signal.

    Attributes
    ----------
    stamp_ns : ndarray of int64, shape (n,), ns
        Increasing; clock of the samples.
    value : ndarray, shape (n,)
        In the unit of its topic.
    """

    stamp_ns: NDArray[np.int64]
    value: Array

    def at(self, stamp_ns: int, time: Array, lag: float = 0.0) -> Array:
        """Values at times after a stamp, constant before the first and after the last one.

        Parameters
        ----------
        time : ndarray, shape (n,), s
        lag : float, s
            Time constant; 0 for none.
        """
        own = np.asarray((self.stamp_ns - stamp_ns) * 1e-9, dtype=np.float64)
        if not lag:
            return np.interp(time, own, self.value)
        followed = first_order_response(own, self.value, lag)
        place = np.clip(np.searchsorted(own, time, side='right') - 1, 0, len(own) - 1)
        after = np.maximum(time - own[place], 0.0)
        rest = followed[place] - self.value[place]
        return np.asarray(self.value[place] + rest * np.exp(-after / lag))


def first_order_response(time: Array, value: Array, lag: float) -> Array:
    """Response of first order to a signal that stays between its samples, shape (n,)."""
    filtered = np.empty_like(value)
    filtered[0] = value[0]
    keep = np.exp(-np.diff(time) / lag)
    for k in range(1, len(value)):
        filtered[k] = value[k - 1] + (filtered[k - 1] - value[k - 1]) * keep[k - 1]
    return filtered
