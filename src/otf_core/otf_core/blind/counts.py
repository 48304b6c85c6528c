# SPDX-License-Identifier: Apache-2.0
"""Counts with binomial intervals, and what stated confidences come to.

The interval is that of Clopper and Pearson (Biometrika 26 (1934) 404): its ends are quantiles of
beta distributions, and it holds the true share in at least 95 % of all trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from scipy.special import betaincinv

COVERED = 0.95
CLASSES = (0.0, 0.5, 0.9, 0.99, 1.0)
"""Limits of the classes of a stated confidence."""


class Row(NamedTuple):
    """One criterion: in how many cells, causes or sizes of how many.

    Attributes
    ----------
    name : str
        Begins with a comma if it is about the cells of a row before.
    """

    name: str
    hits: int
    of: int

    @property
    def share(self) -> str:
        """As words, in percent too."""
        percent = f' ({100 * self.hits / self.of:.0f} %)' if self.of else ''
        return f'{self.hits} of {self.of}{percent}'

    @property
    def interval(self) -> str:
        """95 % interval of the share, as words; empty where nothing was counted."""
        if not self.of:
            return ''
        low, high = binomial_interval(self.hits, self.of)
        return f'{100 * low:.0f} % to {100 * high:.0f} %'


def binomial_interval(hits: int, of: int) -> tuple[float, float]:
    """Interval of a share of which ``hits`` of ``of`` were seen."""
    tail = 0.5 * (1.0 - COVERED)
    low = float(betaincinv(hits, of - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, of - hits, 1.0 - tail)) if hits < of else 1.0
    return low, high


class Stated(NamedTuple):
    """A class of stated confidences.

    Attributes
    ----------
    row : Row
        How many of the causes are there.
    mean : float
        Confidence stated for them.
    """

    row: Row
    mean: float


def reliability(said: Sequence[tuple[float, bool]]) -> list[Stated]:
    """Share of the causes that are there, by the confidence stated for them.

    Parameters
    ----------
    said : sequence of (confidence, whether it is there)
    """
    classes = []
    for low, high in pairwise(CLASSES):
        own = [(c, there) for c, there in said if low <= c < high or c == high == 1.0]
        if own:
            name = f'{low:.2f} to {high:.2f}'
            row = Row(name, sum(there for _, there in own), len(own))
            classes.append(Stated(row, sum(c for c, _ in own) / len(own)))
    return classes


def expected_calibration_error(classes: Sequence[Stated]) -> float:
    """Mean distance of the stated confidence from the share that is there, over all causes."""
    count = sum(c.row.of for c in classes)
    off = sum(c.row.of * abs(c.mean - c.row.hits / c.row.of) for c in classes)
    return off / count if count else 0.0
