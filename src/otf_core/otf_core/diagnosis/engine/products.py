# SPDX-License-Identifier: Apache-2.0
"""Products of whitened columns of effects, with each other and with those of tables and poses.

What happens for some time only has columns that are zero on most lines: there they are left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.engine.rows import Rows

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TOGETHER = 8
"""Lines on which a column acts or does not."""
MOST = 0.6
"""Share of the columns, mean over the lines, from which all of them are taken everywhere."""


def add_products(
    rows: Rows,
    run: int,
    values: Array,
    places: Sequence[slice],
    cross: Array,
    squares: Sequence[Array],
) -> None:
    """Add the products of columns of one run to those of other runs.

    Parameters
    ----------
    rows : Rows
    run : int
    values : ndarray, shape (c, p, k)
        The columns, not yet whitened; of no use afterwards.
    places : sequence of slice
        Those that belong together.
    cross : ndarray, shape (b, k)
        A'E.
    squares : sequence of ndarray
        E'E of those that belong together.
    """
    bounds, base = rows.whiteners[run].bounds, rows.by_run(rows.base)[run]
    for lines, acting in _acting(values, bounds):
        pieces = slice(bounds[lines[0]][0], bounds[lines[-1]][1])
        white = values[:, pieces]
        if len(acting) < values.shape[2]:
            white = white[:, :, acting]
        rows.whiten_lines(white, run, lines)
        for own, known in zip(white, base[:, pieces], strict=True):
            cross[:, acting] += (own.T @ known).T  # faster than the other way round
            for square, place in zip(squares, places, strict=True):
                low, high = np.searchsorted(acting, [place.start, place.stop]).tolist()
                some, inner = own[:, low:high], acting[low:high] - place.start
                square[np.ix_(inner, inner)] += some.T @ some


def _acting(values: Array, bounds: Sequence[tuple[int, int]]) -> Iterator[tuple[range, Index]]:
    """Yield lines, and the columns of values (c, p, k) that are not zero on all of them."""
    starts = [low for low, _ in bounds[::TOGETHER]]
    acts = np.logical_or.reduceat((values != 0.0).any(axis=0), starts, axis=0)
    if acts.mean() > MOST:
        yield range(len(bounds)), np.arange(values.shape[2])
        return
    for number, own in enumerate(acts):
        if own.any():
            yield range(len(bounds))[number * TOGETHER :][:TOGETHER], np.flatnonzero(own)
