# SPDX-License-Identifier: Apache-2.0
"""How well windows of standstill tell the noise: fits with a part of them left out (jackknife).

Colour, tails, and lengths of the windows all enter, as far as the recording shows them.
"""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.noise.colour import fit_colour
from otf_core.noise.model import NoiseModel

GROUPS = 10
"""Groups of windows, each left out once."""
SHORTEST_PART = 0.2
"""s; fewer windows than groups are cut, but not shorter than this."""


def left_out_fits(windows: list[Array], step: float) -> list[NoiseModel]:
    """Noise without one group of windows, group by group; none if there is too little.

    Parameters
    ----------
    windows : list of ndarray, each of shape (n, 3), m, rad, rad
    step : float
        s, between values.
    """
    parts = -(-GROUPS // len(windows))
    cut = [p for w in windows for p in np.array_split(w, parts) if len(p) * step > SHORTEST_PART]
    windows = cut if parts > 1 else windows
    groups = min(GROUPS, len(windows))
    if groups < 2:
        return []
    kept = [[w for k, w in enumerate(windows) if k % groups != g] for g in range(groups)]
    return [NoiseModel(*fit_colour(rest, step)) for rest in kept]


def jackknife_u(values: Array) -> Array:
    """Standard uncertainty from values (g, ...) that each leave out one of g groups."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(np.std(values, axis=0) * np.sqrt(len(values) - 1.0))
