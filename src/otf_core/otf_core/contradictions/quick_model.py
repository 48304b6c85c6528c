# SPDX-License-Identifier: Apache-2.0
"""The quick model of runs that the checks ask: pose, tables, reversal, lag and slow drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.contradictions.quick_design import Design
from otf_core.contradictions.quick_fit import Fit, solve
from otf_core.contradictions.quick_rows import (
    Rows,
    build_rows,
    drift_columns,
    lag_columns,
    poses_by_run,
    reversal_columns,
    squareness_columns,
)
from otf_core.model.machine import Chain
from otf_core.pieces.runs import Run

ENOUGH = 10_000
"""Pieces that are looked at: of more, spread evenly, every second, third, ..."""
MAX_PIECES = 4000
"""The same where many models are compared."""


@dataclass(frozen=True)
class Model:
    """Runs, their rows and the fit of everything usual.

    Attributes
    ----------
    runs : tuple of Run
    rows : Rows
    fit : Fit
        Pose of every run, tables, a constant reversal of every axis, a lag of every axis behind
        its speed and a slow drift of every pose: what these explain is no contradiction.
    """

    runs: tuple[Run, ...]
    rows: Rows
    fit: Fit

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Model:
        """Set up and solve."""
        rows = _thinned(build_rows(runs), ENOUGH)
        return cls(tuple(runs), rows, solve(rows, Design.of(rows, usual_columns(rows))))

    def left_with(self, chains: Sequence[Chain], offsets: Sequence[Array]) -> Array:
        """What other chains or target offsets leave, on the same pieces, thinned.

        Parameters
        ----------
        chains : sequence of Chain
        offsets : sequence of ndarray, shape (runs, 3), m
            One for each chain.

        Returns
        -------
        ndarray, shape (k,), m
            Weighted root mean square of the residuals.
        """
        chosen = _spread(len(self.rows), MAX_PIECES)
        rows = self.rows.take(chosen)
        weight = self.fit.weight.reshape(len(rows.axes), -1)[:, chosen].ravel()
        usual = usual_columns(rows)
        found = []
        for chain, offset in zip(chains, offsets, strict=True):
            design = Design.of(rows, usual, chain, offset[rows.run])
            found.append(solve(rows, design, weight).square)
        return np.asarray(np.sqrt(np.array(found) / weight.sum()))

    @cached_property
    def left_by_order(self) -> dict[tuple[str, ...], float]:
        """What every order of axes from workpiece to tool leaves, m, as ``left_with``."""
        orders = list(permutations(self.rows.machine.axis_names))
        left = self.left_with([Chain((), o) for o in orders], [self.offsets] * len(orders))
        return dict(zip(orders, left.tolist(), strict=True))

    @property
    def offsets(self) -> Array:
        """Target offset of every run as stated, shape (runs, 3), m."""
        return np.array([run.machine.target_offset for run in self.runs])


def _spread(count: int, enough: int) -> Index:
    """Places of some of many, spread evenly."""
    return np.arange(0, count, max(1, count // enough))


def _thinned(rows: Rows, enough: int) -> Rows:
    """Some of the rows; all, unless there are twice as many as are enough."""
    chosen = _spread(len(rows), enough)
    return rows if len(chosen) == len(rows) else rows.take(chosen)


def usual_columns(rows: Rows) -> Array:
    """Columns of what is usual and no matter here, and of squareness, shape (c p, k)."""
    usual = (
        poses_by_run(rows),
        reversal_columns(rows),
        lag_columns(rows),
        drift_columns(rows),
    )
    return np.concatenate([*usual, squareness_columns(rows)], axis=1)
