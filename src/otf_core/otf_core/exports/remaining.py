# SPDX-License-Identifier: Apache-2.0
"""The volumetric error that remains when a control takes off what a format holds."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from otf_core.exports.base import Field
from otf_core.model.evaluation import covered_grid, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.tables import ErrorTables
from otf_core.prediction.driven_volume import table_ranges

GRID = 13
"""Points per axis of the grid; shares few positions with nodes."""


@dataclass(frozen=True)
class Remaining:
    """Volumetric error over the range of the tables, the best rigid motion taken out.

    Attributes
    ----------
    before_mean, before_max : float
        m; length of the error vectors by the tables.
    after_mean, after_max : float
        m; the same less what the file holds.
    """

    before_mean: float
    before_max: float
    after_mean: float
    after_max: float

    @property
    def words(self) -> str:
        """One line."""
        share = 100 * (1 - self.after_mean / self.before_mean) if self.before_mean > 0 else 0.0
        return (
            f'volumetric error by the tables {1e6 * self.before_mean:.2f} um mean, '
            f'{1e6 * self.before_max:.2f} um max; remains with the exported terms '
            f'{1e6 * self.after_mean:.2f} um mean, {1e6 * self.after_max:.2f} um max '
            f'({share:.1f} % less)'
        )

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, um."""
        return {f'{name}_um': 1e6 * value for name, value in asdict(self).items()}


def remaining_error(tables: ErrorTables, held: Field) -> Remaining:
    """Forecast what compensation by a file leaves.

    Parameters
    ----------
    tables : ErrorTables
    held : callable
        Error that the control takes off, m.
    """
    q = covered_grid(tables.machine, np.array(table_ranges(tables)), GRID)
    error = displacement(tables, q)
    lengths = [
        np.linalg.norm(without_rigid_motion(field, q), axis=1)
        for field in (error, error - held(q))
    ]
    (before, after) = lengths
    return Remaining(
        float(before.mean()), float(before.max()), float(after.mean()), float(after.max())
    )
