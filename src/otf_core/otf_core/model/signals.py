# SPDX-License-Identifier: Apache-2.0
"""Signals beside the samples: temperatures, states, pressures over the time of a recording.

What warms up follows its temperature with a lag. A lag is that of first order,
tau dy/dt = x - y, from rest at the first value, exact for a signal that stays between its samples:
``signal:/spindle/temperature@43.2`` is that signal followed with a time constant of 43.2 s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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


def lag_of(name: str) -> float | None:
    """Time constant at the end of a name, s; 0 for none, None if it is not a positive number."""
    _, at, text = name.partition('@')
    try:
        lag = float(text) if at else 0.0
    except ValueError:
        return None
    return lag if not at or 0.0 < lag < np.inf else None


class Courses(Mapping[str, Array]):
    """Values of points by name; of signals at any lag, listed as they are and with ``LAGS``.

    A lag that is longer than the signal lasts says no more than a slope does and is not listed.

    Parameters
    ----------
    stamp_ns : int
        From which ``time`` counts.
    time : ndarray, shape (n,), s
    given : mapping of str to ndarray, shape (n,), optional
        Other values.
    """

    def __init__(
        self,
        signals: Mapping[str, Signal],
        stamp_ns: int,
        time: Array,
        given: Mapping[str, Array] | None = None,
    ) -> None:
        self._signals, self._stamp_ns, self._time = signals, stamp_ns, time
        self._known = dict(given or {})
        self._listed = [*self._known, *(n for name in signals for n in self._usual(name))]

    def beside(self, given: Mapping[str, Array]) -> Courses:
        """The same and other values."""
        return Courses(self._signals, self._stamp_ns, self._time, given)

    def _usual(self, name: str) -> Sequence[str]:
        stamps = self._signals[name].stamp_ns
        lasts = float(stamps[-1] - stamps[0]) * 1e-9
        return name, *(f'{name}@{lag:g}' for lag in LAGS if lag < lasts)

    def __contains__(self, name: object) -> bool:
        """Return whether a name is given, or is that of a signal with or without a lag."""
        if not isinstance(name, str):
            return False
        return name in self._known or (
            name.partition('@')[0] in self._signals and lag_of(name) is not None
        )

    def __getitem__(self, name: str) -> Array:
        """Values of a name, shape (n,)."""
        if name not in self:
            raise KeyError(name)
        if name not in self._known:
            signal = self._signals[name.partition('@')[0]]
            self._known[name] = signal.at(self._stamp_ns, self._time, lag_of(name) or 0.0)
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        """Names that are listed."""
        return iter(self._listed)

    def __len__(self) -> int:
        """Number of names that are listed."""
        return len(self._listed)


class Part(Mapping[str, Array]):
    """Some rows of values by name."""

    def __init__(self, whole: Mapping[str, Array], rows: slice) -> None:
        self._whole, self._rows = whole, rows

    def __contains__(self, name: object) -> bool:
        """As of the whole."""
        return name in self._whole

    def __getitem__(self, name: str) -> Array:
        """Values of a name."""
        return self._whole[name][self._rows]

    def __iter__(self) -> Iterator[str]:
        """As of the whole."""
        return iter(self._whole)

    def __len__(self) -> int:
        """As of the whole."""
        return len(self._whole)
