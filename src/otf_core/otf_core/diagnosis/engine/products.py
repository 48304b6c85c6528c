# SPDX-License-Identifier: Apache-2.0
"""Products of whitened columns of effects, with each other and with those of tables and poses.

What happens for some time only has columns that are zero on most lines: there they are left out,
as are unknowns that a line does not touch.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.diagnosis.engine.line_groups import Touched, acts_on_lines
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.solving.whitener import Whitener

MOST = 0.6
"""Share of the columns, mean over the lines, from which all of them are taken everywhere."""


def add_products(rows: Rows, run: int, values: Array, cross: Array, square: Array) -> None:
    """Add the products of columns of one run to those of other runs.

    Parameters
    ----------
    values : ndarray, shape (c, p, k)
        The columns, not yet whitened.
    cross : ndarray, shape (b, k)
        A'E.
    square : ndarray, shape (k, k)
        E'E.
    """
    whitener = rows.whiteners[run]
    for some, acting in _acting(rows, run, values):
        white = _whitened(whitener, values, some.lines, acting)
        cross[np.ix_(some.unknowns, acting)] += (white.T @ some.base).T  # faster than reversed
        square[np.ix_(acting, acting)] += white.T @ white


def _acting(rows: Rows, run: int, values: Array) -> Iterator[tuple[Touched, Index]]:
    """Yield lines, and the columns of values (c, p, k) that are not zero on all of them."""
    acts = acts_on_lines(values, rows.whiteners[run].bounds)
    acts |= acts.mean() > MOST
    for some in rows.touched[run]:
        acting = np.flatnonzero(acts[some.lines].any(axis=0))
        if acting.size:
            yield some, acting


def _whitened(whitener: Whitener, values: Array, lines: Sequence[int], take: Index) -> Array:
    """Whiten some of the columns (c, p, k) on the m pieces of some lines, shape (c m, k)."""
    parts = [values[:, slice(*whitener.bounds[line])] for line in lines]
    if len(take) < values.shape[2]:
        parts = [part[:, :, take] for part in parts]
    found = np.empty((len(values), sum(part.shape[1] for part in parts), len(take)))
    start = 0
    for line, part in zip(lines, parts, strict=True):
        np.matmul(whitener.inverses[line], part, out=found[:, start : start + part.shape[1]])
        start += part.shape[1]
    return found.reshape(-1, len(take))
