# SPDX-License-Identifier: Apache-2.0
"""By how much errors are enlarged in a picture, in steps that a reader can undo in the head."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

STEPS = (1.0, 2.0, 5.0, 10.0)
SHARE = 0.08
"""Share of the size of the scene that the longest arrow takes at most."""


def enlargement(vectors: NDArray[np.float64], size: float) -> float:
    """Factor 1, 2 or 5 times a power of ten that makes errors visible.

    Parameters
    ----------
    vectors : ndarray, shape (n, 3), m
        Errors; the longest but for five in a hundred counts.
    size : float
        m; of the scene.

    Returns
    -------
    float
        1 if there is nothing to enlarge.
    """
    lengths = np.linalg.norm(vectors, axis=1) if len(vectors) else np.zeros(1)
    longest = float(np.quantile(lengths, 0.95))
    if not longest > 0.0 or not size > 0.0:
        return 1.0
    wanted = SHARE * size / longest
    decade = 10.0 ** math.floor(math.log10(wanted))
    return max(step * decade for step in STEPS if step * decade <= wanted * (1.0 + 1e-9))
