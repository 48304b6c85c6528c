# SPDX-License-Identifier: Apache-2.0
"""Values at points by name: what is given, and signals as they are or with the lag of their name.

``signal:/spindle/temperature@43.2`` is that signal followed with a time constant of 43.2 s. Values
are made when they are asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.model.signals import LAGS, Signal


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
