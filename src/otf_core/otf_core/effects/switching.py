# SPDX-License-Identifier: Apache-2.0
"""Time as what switches feels it: on at a first moment, off at the next, followed with a lag.

The input ``switched:58@0,146,283`` is time with the functions

    f_1 = r_1 - r_2 + r_3 - ...,    f_k = r_k for k > 1,    r_k(t) = 1 - exp(-(t - t_k) / lag)

after t_k, 0 before: the response of first order to something that is on and off in turn, and to
the later moments one by one, where it is not the same each time. A lag of 0 stands for jumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array

SWITCHED = 'switched:'
"""Head of the name of such an input; lag and moments in s follow."""


@dataclass(frozen=True)
class Switching:
    """Moments at which something switches, and the lag with which it is followed.

    Attributes
    ----------
    lag : float, s
    moments : tuple of float, s
        Ascending, since the start of the recording.
    """

    lag: float
    moments: tuple[float, ...]

    @classmethod
    def of(cls, name: str) -> Switching | None:
        """Read the name of an input; None if it is no such name."""
        if not name.startswith(SWITCHED):
            return None
        lag, _, moments = name.removeprefix(SWITCHED).partition('@')
        try:
            switching = cls(float(lag), tuple(float(m) for m in moments.split(',')))
        except ValueError:
            return None
        steps = np.diff((0.0, *switching.moments))
        sound = 0.0 <= switching.lag < np.inf and steps[0] >= 0.0 and np.all(steps[1:] > 0.0)
        return switching if sound and switching.moments[-1] < np.inf else None

    @property
    def name(self) -> str:
        """Name as an input."""
        return f'{SWITCHED}{self.lag:.4g}@{",".join(f"{m:.5g}" for m in self.moments)}'

    @property
    def words(self) -> str:
        """What happens, for the report."""
        *first, last = (f'{m:.3g} s' for m in self.moments)
        when = f'{", ".join(first)} and {last}' if first else last
        return f'something switches at {when}, which it follows with a lag of {self.lag:.3g} s'

    def responses(self, time: Array) -> Array:
        """Responses r_k at times (n,), shape (n, k)."""
        return responses(time, np.array(self.moments), np.array(self.lag))

    def functions(self, time: Array, order: int) -> Array:
        """One and the functions up to an order at times (n,), shape (n, order + 1)."""
        single = self.responses(time)
        signs = (-1.0) ** np.arange(len(self.moments))
        whole = np.column_stack([np.ones(len(time)), single @ signs, single[:, 1:]])
        return whole[:, : order + 1]


def responses(time: Array, moments: Array, lags: Array) -> Array:
    """Responses of first order to switches at moments (k,), at times (n,), shape (n, k).

    Lags (k,) or () of 0 are those of jumps.
    """
    since = np.maximum(time[:, None] - moments, 0.0)
    jumps = lags == 0.0
    slow = -np.expm1(-since / np.where(jumps, 1.0, lags))
    return np.asarray(np.where(jumps, since > 0.0, slow))
