# SPDX-License-Identifier: Apache-2.0
"""Numbers that come in many small parts and become one array, without a second copy of it all."""

from __future__ import annotations

from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar('T', np.int64, np.float64)

BLOCK = 1 << 18
"""Rows; arrays of this size go back to the system one by one when they are let go, small ones
stay with the process."""


class Column(Generic[T]):
    """Parts of one array.

    Parameters
    ----------
    none : ndarray, shape (0,) or (0, k)
        An empty part, which tells type and width.
    """

    def __init__(self, none: NDArray[T]) -> None:
        self._none: NDArray[T] = none
        self._blocks: list[NDArray[T]] = []
        self._loose: list[NDArray[T]] = []
        self._rows_loose = 0

    def add(self, part: NDArray[T]) -> None:
        """Take rows after those that are there."""
        self._loose.append(part)
        self._rows_loose += len(part)
        if self._rows_loose >= BLOCK:
            self._blocks.append(np.concatenate(self._loose))
            self._loose, self._rows_loose = [], 0

    def joined(self) -> NDArray[T]:
        """Return all rows; the column is empty then."""
        parts = [*self._blocks, *self._loose]
        self._blocks, self._loose, self._rows_loose = [], [], 0
        at = sum(map(len, parts))
        whole = np.empty((at, *self._none.shape[1:]), self._none.dtype)
        while parts:
            part = parts.pop()
            whole[at - len(part) : at] = part
            at -= len(part)
        return whole
