# SPDX-License-Identifier: Apache-2.0
"""Which view of a gap separates most: along the path, in the volume, over time or over the beam.

Every leg is cut into blocks of a few pieces; y is the mean square residual of a block beyond
noise. Of every grouping of the blocks the share of the variance of y between its groups is taken,
less what k groups of N blocks have by chance (the adjusted coefficient of determination):

    share = 1 - (1 - R^2) (N - 1) / (N - k)

The grouping with the largest share is the view in which the gap has a place. One of a single
quantity is preferred to one of two positions that has little more, and one in the terms of the
machine to one over the beam: a reader looks for the cause at the machine first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from otf_core.arrays import Array
from otf_core.diagnosis.place import groupings as by
from otf_core.diagnosis.place.groupings import Grouping
from otf_core.diagnosis.place.views import RunView

PATH, VOLUME, TIME, BEAM = 'path', 'volume', 'time', 'beam'
VIEWS = (PATH, VOLUME, TIME, BEAM)
BLOCK = 6
"""Pieces of a block."""
LEAST_SHARE = 0.08
"""Share from which a grouping separates anything that is worth a word."""
CHANCE = 1e-4
"""Probability below which groups do not differ by chance, of some twenty groupings looked at."""
SLICES, CELLS, RANGES = 6, 4, 10
"""Groups along an axis, along either axis of a plane, and over the beam."""

SIMPLER = 0.85
"""A grouping by one quantity is preferred to one by two if it has this part of its share."""
AT_THE_MACHINE = 0.9
"""A grouping by one quantity of the machine is preferred to one over the beam if it has this part
of its share."""


@dataclass(frozen=True)
class Separation:
    """How well one grouping separates a gap.

    Attributes
    ----------
    view : str
        One of ``VIEWS``.
    share : float
        See the head of this file; at most 1, about 0 by chance.
    probability : float
        Of so large a share by chance (F test).
    """

    view: str
    grouping: Grouping
    share: float
    probability: float

    @property
    def counts(self) -> bool:
        """True if it is worth a word."""
        return self.share > LEAST_SHARE and self.probability < CHANCE


def groupings_by_view(views: Sequence[RunView]) -> list[tuple[str, Grouping]]:
    """Every grouping that is weighed, with its view."""
    axes = range(3)
    return [
        (PATH, by.by_moving_axes(views)),
        *((PATH, by.by_sense(views, k)) for k in axes),
        (PATH, by.by_feed(views)),
        (PATH, by.by_corner(views)),
        *((VOLUME, by.by_position(views, (k,), SLICES)) for k in axes),
        *((VOLUME, by.by_position(views, pair, CELLS)) for pair in combinations(axes, 2)),
        (TIME, by.by_time(views)),
        (BEAM, by.by_distance(views, RANGES)),
        (BEAM, by.by_azimuth(views, RANGES)),
        (BEAM, by.by_elevation(views, RANGES)),
    ]


def separations(views: Sequence[RunView], residuals: Sequence[Array]) -> list[Separation]:
    """Separation by every grouping, the one to be shown first; see the head of this file.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (c, p), m
    """
    starts = [_block_starts(v) for v in views]
    excess, weight = [], []
    for view, residual, start in zip(views, residuals, starts, strict=True):
        square = np.sum(residual**2 - view.expected**2, axis=0)
        count = np.diff([*start, len(square)])
        excess.append(np.add.reduceat(square, start) / count)
        weight.append(count)
    y, n = np.concatenate(excess), np.concatenate(weight).astype(float)
    found = []
    for view_name, grouping in groupings_by_view(views):
        middle = (
            own[np.minimum(s + c // 2, len(own) - 1)]
            for own, s, c in zip(grouping.indices, starts, weight, strict=True)
        )
        share, probability = _share(y, n, np.concatenate(list(middle)))
        found.append(Separation(view_name, grouping, share, probability))
    found.sort(key=lambda s: -s.share * (1.0 if s.grouping.second is None else SIMPLER))
    first, *others = found
    if first.view == BEAM:
        direct = [s for s in others if s.view != BEAM and s.grouping.second is None]
        if direct and direct[0].share >= AT_THE_MACHINE * first.share:
            found.remove(direct[0])
            found.insert(0, direct[0])
    return found


def _block_starts(view: RunView) -> NDArray[np.int64]:
    """First piece of every block of a run."""
    found = []
    for low, high in view.bounds:
        count = max(1, round((high - low) / BLOCK))
        found.append(np.linspace(low, high, count, endpoint=False).round().astype(np.int64))
    return np.concatenate(found)


def _share(y: Array, weight: Array, group: NDArray[np.int64]) -> tuple[float, float]:
    """Share of the variance between groups beyond chance, and the probability of it by chance."""
    keys, index = np.unique(group, return_inverse=True)
    k, count = len(keys), len(y)
    mean = np.average(y, weights=weight)
    total = float(np.sum(weight * (y - mean) ** 2))
    if k < 2 or count <= k or total <= 0.0:
        return 0.0, 1.0
    of_group = np.bincount(index, weight)
    means = np.bincount(index, weight * y) / of_group
    between = float(np.sum(of_group * (means - mean) ** 2)) / total
    within = max(1.0 - between, 1e-12)
    share = 1.0 - within * (count - 1) / (count - k)
    ratio = (between / (k - 1)) / (within / (count - k))
    return share, float(fdtrc(k - 1, count - k, ratio))
