# SPDX-License-Identifier: Apache-2.0
"""Products with lower triangular matrices, strip by strip: what is zero above is left out."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from otf_core.arrays import Array

STRIP = 32
"""Rows of a matrix, about, that are multiplied at a time."""


def _strips(size: int) -> Iterator[slice]:
    ends = np.linspace(0, size, max(1, round(size / STRIP)) + 1).astype(int).tolist()
    return map(slice, ends[:-1], ends[1:])


def lower_times(lower: Array, values: Array, out: Array) -> None:
    """Multiply values (c, m, k) by lower triangular matrices (c, m, m), into another array."""
    for strip in _strips(lower.shape[1]):
        np.matmul(lower[:, strip, : strip.stop], values[:, : strip.stop], out=out[:, strip])


def turned_times(lower: Array, values: Array) -> None:
    """Multiply values (c, m, k) by the transposes of such matrices, in place."""
    upper = np.swapaxes(lower, 1, 2)
    for strip in _strips(lower.shape[1]):
        values[:, strip] = upper[:, strip, strip.start :] @ values[:, strip.start :]
