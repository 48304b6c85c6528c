# SPDX-License-Identifier: Apache-2.0
"""The quick model of runs that the checks ask: pose, tables, reversal and slow drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.contradictions.fit import Fit, solve
from otf_core.contradictions.rows import (
    Array,
    Rows,
    build_rows,
    drift_columns,
    poses_by_run,
    reversal_columns,
    table_columns,
)
from otf_core.machine import Chain
from otf_core.runs import Run


@dataclass(frozen=True)
class Model:
    """Runs, their rows and the fit of everything usual.

    Attributes
    ----------
    runs : tuple of Run
    rows : Rows
    fit : Fit
        Pose of every run, tables, a constant reversal of every motion and a slow drift of every
        pose: what these explain is no contradiction.
    """

    runs: tuple[Run, ...]
    rows: Rows
    fit: Fit

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Model:
        """Set up and solve."""
        rows = build_rows(runs)
        return cls(tuple(runs), rows, solve(rows, nuisance(rows), table_columns(rows)))

    def with_other(self, chain: Chain | None = None, offset: Array | None = None) -> Fit:
        """Fit with another chain or other target offsets (p, 3), on the same pieces."""
        columns = table_columns(self.rows, chain, offset)
        return solve(self.rows, nuisance(self.rows), columns, weight=self.fit.weight)

    @property
    def noise(self) -> float:
        """Noise expected of a row, m, root mean square."""
        used = self.fit.weight > 0
        return float(np.sqrt(np.mean(self.rows.sigma.ravel()[used] ** 2)))


def nuisance(rows: Rows) -> Array:
    """Columns of what is usual and no matter here, shape (c p, k)."""
    parts = (poses_by_run(rows), reversal_columns(rows), drift_columns(rows))
    return np.concatenate(parts, axis=1)
