# SPDX-License-Identifier: Apache-2.0
"""The volumetric error that remains when a control takes off what a format holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from otf_core.exports.base import Field
from otf_core.model.evaluation import covered_grid, lattice, without_rigid_motion
from otf_core.model.expanded import figure
from otf_core.model.kinematics import displacement
from otf_core.model.tables import ErrorTables
from otf_core.prediction.driven_volume import table_ranges

FINER = 13
"""Points per axis between those of the volumetric error; they share few positions with nodes."""


@dataclass(frozen=True)
class Remaining:
    """Volumetric error on the points on which a calibration states it, rigid motion taken out.

    Attributes
    ----------
    points : int
        Of the grid over the whole volume.
    before_mean, before_max : float
        m; length of the error vectors by the tables: the figures of the calibration.
    after_mean, after_max : float
        m; the same less what the file holds.
    between_max : float
        m; largest remainder on a finer grid over the range of the tables, between the nodes too.
    wide : float
        m; expanded uncertainty that the calibration states for the mean; zero if unknown.
    """

    points: int
    before_mean: float
    before_max: float
    after_mean: float
    after_max: float
    between_max: float
    wide: float = 0.0

    @property
    def words(self) -> str:
        """One line."""
        share = 100 * (1 - self.after_mean / self.before_mean) if self.before_mean > 0 else 0.0
        return (
            f'volumetric error by the tables, {self.points} points as in the calibration: mean '
            f'{self._um(self.before_mean)}, largest {self._um(self.before_max)}; this file leaves '
            f'mean {self._um(self.after_mean)} ({share:.0f} % less), largest '
            f'{self._um(self.after_max)}, between these points up to {self._um(self.between_max)}'
        )

    def _um(self, value: float) -> str:
        """A length, as many digits as its uncertainty leaves; to 0.01 um where that is unknown."""
        return f'{figure(1e6 * value, 1e6 * self.wide)} um'

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, um."""
        sizes = {k: v for k, v in asdict(self).items() if k not in ('points', 'wide')}
        return {'points': self.points, **{f'{k}_um': 1e6 * v for k, v in sizes.items()}}


def remaining_error(
    tables: ErrorTables, held: Field, headline: Mapping[str, Any] | None = None
) -> Remaining:
    """Forecast what compensation by a file leaves.

    Parameters
    ----------
    tables : ErrorTables
    held : callable
        Error that the control takes off, m.
    headline : mapping, optional
        Entry of error_tables.json; decides how many digits are stated.
    """
    q = lattice(tables.machine)
    finer = covered_grid(tables.machine, np.array(table_ranges(tables)), FINER)
    error = displacement(tables, q)
    before = np.linalg.norm(without_rigid_motion(error, q), axis=1)
    after = np.linalg.norm(without_rigid_motion(error - held(q), q), axis=1)
    left = displacement(tables, finer) - held(finer)
    between = np.linalg.norm(without_rigid_motion(left, finer), axis=1)
    wide = headline['expected_after_compensation']['U']['mean'] if headline else 0.0
    return Remaining(
        len(q),
        float(before.mean()),
        float(before.max()),
        float(after.mean()),
        float(after.max()),
        float(between.max()),
        float(wide),
    )
