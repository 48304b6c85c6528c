# SPDX-License-Identifier: Apache-2.0
"""How stamps that repeat were made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MOST = 0.5
"""Share of repeated stamps from which on they tell how the stamps are made."""


def stamp_words(stamp_ns: NDArray[np.int64]) -> str:
    """Say how stamps that repeat were made, as far as they show it.

    Parameters
    ----------
    stamp_ns : ndarray of int64, shape (n,), ns
        Ascending.

    Returns
    -------
    str
        Begins with a verb; empty if they do not repeat.
    """
    count = len(stamp_ns)
    different, size = np.unique(stamp_ns, return_counts=True)
    if len(different) == count:
        return ''
    if len(different) == 1:
        return (
            'are all equal: the driver stamps the whole stream once; it has to give every '
            'sample its own time of measurement'
        )
    block = float(np.median(size))
    if count - len(different) > MOST * count:
        return (
            f'repeat in blocks of about {block:.0f} samples: the driver stamps packets, not '
            f'samples; it has to give every sample its own time of measurement'
        )
    return (
        'are given to different points: their resolution is too coarse, or two trackers publish '
        'on one topic'
    )
