# SPDX-License-Identifier: Apache-2.0
"""Scales of pictures: data to 0 ... 1, with marks at round numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ROUND = (1.0, 2.0, 5.0, 10.0)
FINE = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
MOST, FEWEST = 7, 2
"""Marks on a logarithmic scale beyond which only powers of ten are marked, below which
more of them; intervals on a linear one below which there are more."""


@dataclass(frozen=True)
class Scale:
    """A linear or logarithmic scale.

    Attributes
    ----------
    low, high : float
        Ends; ``high`` above ``low``.
    label : str
        What is shown, with its unit.
    logarithmic : bool
    marks : int
        Marks wished for on a linear scale.
    """

    low: float
    high: float
    label: str
    logarithmic: bool = False
    marks: int = 4

    def place(self, values: ArrayLike) -> Array:
        """Share of the scale below values of any shape."""
        given = np.asarray(values, dtype=float)
        if self.logarithmic:
            given = np.log(np.maximum(given, 1e-300))
            low, high = math.log(self.low), math.log(self.high)
        else:
            low, high = self.low, self.high
        return np.asarray((given - low) / (high - low))

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Round values on the scale, and how they are written."""
        if self.logarithmic:
            powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            found = [(m, m * 10.0**k) for k in powers for m in ROUND[:3]]
            inside = [(m, v) for m, v in found if self.low <= v <= self.high]
            if len(inside) < FEWEST:
                fine = [m * 10.0**k for k in powers for m in FINE]
                return [(v, f'{v:g}') for v in fine if self.low <= v <= self.high]
            few = len(inside) <= MOST or self.high < 10.0 * self.low
            return [(v, f'{v:g}') for m, v in inside if few or m == 1.0]
        step = round_step((self.high - self.low) / self.marks)
        few = math.floor(self.high / step + 1e-9) - math.ceil(self.low / step - 1e-9) < FEWEST
        if few and self.marks > FEWEST:
            step = round_step(0.4 * step)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        return [
            (k * step, f'{k * step + 0.0:.{digits}f}'.replace('-', '\N{MINUS SIGN}'))
            for k in range(first, last + 1)
        ]


def round_step(wished: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is not below a wished step."""
    power = 10.0 ** math.floor(math.log10(max(wished, 1e-300)))
    return next(m * power for m in ROUND if m * power >= wished * (1.0 - 1e-9))


def around(values: ArrayLike, label: str, *, zero: bool = False, marks: int = 4) -> Scale:
    """Scale around values (NaN left out) with a little room; ``zero``: begins or ends there."""
    given = np.asarray(values, dtype=float)
    given = given[np.isfinite(given)]
    low, high = (float(given.min()), float(given.max())) if given.size else (0.0, 1.0)
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
    if high - low < 1e-9 * max(abs(high), abs(low), 1.0):
        low, high = low - 0.5, high + 0.5
    room = 0.05 * (high - low)
    below = 0.0 if zero and low == 0.0 else room
    above = 0.0 if zero and high == 0.0 else room
    return Scale(low - below, high + above, label, marks=marks)


def decades(values: ArrayLike, label: str) -> Scale:
    """Logarithmic scale around positive values."""
    given = np.asarray(values, dtype=float)
    given = given[np.isfinite(given) & (given > 0)]
    low, high = (float(given.min()), float(given.max())) if given.size else (0.1, 1.0)
    return Scale(low / 1.15, high * 1.15, label, logarithmic=True)
