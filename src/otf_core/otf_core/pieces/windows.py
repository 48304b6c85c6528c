# SPDX-License-Identifier: Apache-2.0
"""Values combined over every window of some length, in few passes over all of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def over_windows(combine: np.ufunc, values: NDArray[Any], size: int) -> NDArray[Any]:
    """Combine the values of every window.

    Two windows that overlap or meet make a longer one, so their length doubles from pass to pass.

    Parameters
    ----------
    combine : ufunc
        Of two values, which may be taken in repeatedly: maximum, minimum, logical_or.
    values : ndarray, shape (..., n)
    size : int
        Values in a window.

    Returns
    -------
    ndarray, shape (..., n - size + 1)
    """
    width = 1
    while width < size:
        step = min(width, size - width)
        values = combine(values[..., :-step], values[..., step:])
        width += step
    return values
