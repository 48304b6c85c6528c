# SPDX-License-Identifier: Apache-2.0
"""Samples far from the running median of their leg."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.pieces.windows import over_windows

MEDIAN_HALF = 5
"""samples on either side that a sample is compared with to tell an outlier."""
GROSS = 3e-5
"""m; smaller deviations are never called outliers: they may be kinks of steep error tables, and
as bad samples they average out."""
RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector of two independent normal components of unit variance."""


def outlying(
    offset_of: Callable[[slice], Array], bounds: Sequence[tuple[int, int]], limit: float
) -> NDArray[np.bool_]:
    """Samples far from the running median of their leg, by robust standard deviation.

    No sample is further from its median than the samples around it are apart, so where these
    are all within ``GROSS`` there is nothing to look for. The ends of a leg are continued by
    point reflection, which keeps the slope; the end sample, about which it is reflected, is
    compared with the extrapolated median instead.

    Parameters
    ----------
    offset_of : callable
        Offsets (3, m), m, of a slice of the samples; so that not all are held at once.
    bounds : sequence of (int, int)
        First sample and one past the last of every leg.
    limit : float
    """
    if all(_apart(offset_of(slice(*leg))) < GROSS for leg in bounds):
        return np.zeros(bounds[-1][1], dtype=bool)
    distance = np.empty(bounds[-1][1])
    for leg in bounds:
        distance[slice(*leg)] = np.linalg.norm(_from_median(offset_of(slice(*leg))), axis=0)
    sigma = float(np.median(distance)) / RAYLEIGH_MEDIAN
    return np.asarray(distance > max(limit * sigma, GROSS))


def _from_median(offset: Array) -> Array:
    """Offsets of a leg (3, n) less their running median."""
    from scipy.ndimage import median_filter  # 25 ms; most runs do without

    if offset.shape[1] <= MEDIAN_HALF:
        return np.asarray(offset - np.median(offset, axis=1, keepdims=True))
    reach = ((0, 0), (MEDIAN_HALF, MEDIAN_HALF))
    padded = np.pad(offset, reach, mode='reflect', reflect_type='odd')
    # of one dimension at a time: SciPy then moves the window, five times as fast
    smooth = np.stack([median_filter(own, 2 * MEDIAN_HALF + 1) for own in padded])
    smooth = smooth[:, MEDIAN_HALF:-MEDIAN_HALF]
    rest = offset - smooth
    rest[:, 0] = offset[:, 0] - (2 * smooth[:, 1] - smooth[:, 2])
    rest[:, -1] = offset[:, -1] - (2 * smooth[:, -2] - smooth[:, -3])
    return np.asarray(rest)


def _apart(offset: Array) -> float:
    """Bound on the distance of the samples of a leg (3, n), m, from their running median."""
    size, count = 2 * MEDIAN_HALF + 1, offset.shape[1]
    if count <= size:
        return float(np.linalg.norm(np.ptp(offset, axis=1))) * (3.0 if count > 1 else 1.0)
    spread = over_windows(np.maximum, offset, size) - over_windows(np.minimum, offset, size)
    reach = np.maximum(spread[:, 0], spread[:, -1])
    return float(np.linalg.norm(np.maximum(spread.max(axis=1), 3.0 * reach)))
