# SPDX-License-Identifier: Apache-2.0
"""Volumetric error over the driven volume: vectors, their uncertainty, what each motion adds.

The best-fitting rigid motion of all positions is taken out of all of it: it belongs to the choice
of the machine frame, and no calibration can know it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from otf_core.arrays import Array
from otf_core.model.chain import nominal_position
from otf_core.model.evaluation import driven_positions, free_rows
from otf_core.model.tables import ErrorTables
from otf_core.prediction.uncertainty import prediction_rows
from otf_core.threads import one_thread

VOLUME_PLACES = 1000
"""Axis positions at which the errors of a machine with rotary axes are stated."""


def table_places(tables: ErrorTables) -> dict[str, slice]:
    """Places of squareness and location errors and motions in a covariance of tables."""
    machine = tables.machine
    sizes = [1] * len(machine.scalars)
    sizes += [len(tables.motions[m].position) for m in machine.motions]
    ends = np.concatenate([[0], np.cumsum(sizes)]).tolist()
    names = (*machine.scalars, *machine.motions)
    return {n: slice(a, b) for n, a, b in zip(names, ends[:-1], ends[1:], strict=True)}


def table_values(tables: ErrorTables) -> Array:
    """Values of squareness errors and nodes in the order of a covariance, shape (m,)."""
    machine = tables.machine
    scalars = [tables.scalar(n) for n in machine.scalars]
    return np.concatenate([scalars, *(tables.motions[m].value for m in machine.motions)])


def table_rows(tables: ErrorTables, q: Array) -> Array:
    """Derivatives of the volumetric error at q (n, k) by all of these, shape (n, 3, m)."""
    nodes: dict[str, Array] = {m: tables.motions[m].position for m in tables.machine.motions}
    return prediction_rows(tables.machine, nodes, q)


def volume_rows(tables: ErrorTables) -> Array:
    """Derivatives of the error vectors at ``driven_positions``, rigid motion out, (3 n, m)."""
    q = driven_positions(tables, VOLUME_PLACES)
    rows = table_rows(tables, q)
    return free_rows(rows.reshape(-1, rows.shape[2]), nominal_position(tables.machine, q))


def length_sizes(length: Array) -> dict[str, float]:
    """Mean, 95 % quantile and largest of lengths (n,)."""
    return {
        'mean': float(length.mean()),
        'p95': float(np.quantile(length, 0.95)),
        'max': float(length.max()),
    }


@dataclass(frozen=True)
class VolumetricError:
    """Errors of a machine at positions over the volume of its tables, see ``driven_positions``.

    Attributes
    ----------
    covariance : ndarray, shape (m, m), m and rad
        Of squareness and nodes.
    """

    tables: ErrorTables
    covariance: Array

    @cached_property
    def positions(self) -> Array:
        """Axis positions, shape (n, k), m and rad."""
        return driven_positions(self.tables, VOLUME_PLACES)

    @cached_property
    def grid(self) -> Array:
        """Nominal points of the target there, shape (n, 3), m."""
        return nominal_position(self.tables.machine, self.positions)

    @cached_property
    def error(self) -> Array:
        """Actual minus nominal, shape (n, 3), m."""
        return np.asarray((self.rows @ table_values(self.tables)).reshape(-1, 3))

    @cached_property
    def length(self) -> Array:
        """Lengths of the error vectors, shape (n,), m."""
        return np.asarray(np.linalg.norm(self.error, axis=1))

    @cached_property
    def rows(self) -> Array:
        """Derivatives of the components by scalars and nodes, shape (3 n, m)."""
        return volume_rows(self.tables)

    @cached_property
    def _spread(self) -> Array:
        """Rows times covariance, shape (3 n, m)."""
        with one_thread():
            return np.asarray(self.rows @ self.covariance)

    @cached_property
    def u(self) -> Array:
        """Standard uncertainty of the components, shape (n, 3), m."""
        variance = np.einsum('ij,ij->i', self._spread, self.rows)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0).reshape(-1, 3)))

    @cached_property
    def u_size(self) -> Array:
        """Standard uncertainty of the error vectors, root of the sum over components, (n,), m."""
        return np.asarray(np.linalg.norm(self.u, axis=1))

    @cached_property
    def unit(self) -> Array:
        """Unit vectors along the error vectors, shape (n, 3)."""
        return np.asarray(self.error / np.maximum(self.length, 1e-300)[:, None])

    @cached_property
    def length_rows(self) -> Array:
        """Derivatives of the lengths: along each error vector, shape (n, m)."""
        rows = self.rows.reshape(*self.unit.shape, -1)
        return np.asarray(np.einsum('nk,nkm->nm', self.unit, rows))

    def part(self, name: str) -> Array:
        """Errors that one motion or squareness error makes alone, shape (n, 3), m."""
        place = table_places(self.tables)[name]
        return (self.rows[:, place] @ table_values(self.tables)[place]).reshape(-1, 3)

    def sizes(self) -> dict[str, float]:
        """Mean, 95 % quantile and largest length, m."""
        return length_sizes(self.length)
