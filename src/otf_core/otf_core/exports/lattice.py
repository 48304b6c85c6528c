# SPDX-License-Identifier: Apache-2.0
"""Volumetric errors on a regular lattice, trilinear between its points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.exports.line_terms import axis_positions
from otf_core.model.kinematics import displacement
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.nodes import hat_matrix
from otf_core.model.tables import ErrorTables, TablesFile
from otf_core.prediction.covariance import unpack_covariance
from otf_core.prediction.uncertainty import prediction_rows

FEWEST, MOST = 2, 101
"""Points per axis."""
MOST_AT_NODES, INSTEAD = 60_000, 33
"""Points of a lattice at the nodes at most, and points per axis where they make more."""
FINER = 4
"""What trilinear interpolation leaves of a quadratic course falls to a sixteenth."""


@dataclass(frozen=True)
class Lattice:
    """Errors on a lattice.

    Attributes
    ----------
    axes : tuple of three ndarray, m
        Positions along X, Y, Z, ascending.
    error : ndarray, shape (nx, ny, nz, 3), m
        Actual minus nominal.
    """

    axes: tuple[Array, Array, Array]
    error: Array

    @property
    def points(self) -> Array:
        """Lattice points, shape (nx ny nz, 3), m; Z runs fastest."""
        grids = np.meshgrid(*self.axes, indexing='ij')
        return np.stack([g.ravel() for g in grids], axis=1)

    def at(self, q: Array) -> Array:
        """Errors (n, 3), m, at positions (n, 3), m: trilinear, constant outside."""
        x, y, z = (hat_matrix(a, q[:, k]) for k, a in enumerate(self.axes))
        return np.asarray(np.einsum('ni,nj,nk,ijkc->nc', x, y, z, self.error, optimize=True))


def sampled_lattice(tables: ErrorTables, points: int | None) -> tuple[Lattice, tuple[str, ...]]:
    """Errors of tables on a lattice over their range.

    Parameters
    ----------
    tables : ErrorTables
    points : int, optional
        Per axis, evenly spread. If not given, the planes stand at the nodes of the tables: the
        model is linear between them in the coordinates of axes that carry the target, so that
        trilinear interpolation is exact; rotations of an axis that carries the table act on its
        own travel too, which makes it quadratic there: these intervals are divided by
        ``FINER``. If that makes more than ``MOST_AT_NODES`` points, ``INSTEAD`` per axis.

    Returns
    -------
    Lattice
    tuple of str
        Remark, where it does not stand at the nodes though no number is given.

    Raises
    ------
    ConfigError
        If ``points`` is too few or too many.
    """
    if points is not None and not FEWEST <= points <= MOST:
        raise ConfigError(f'--points: {points} is out of range [{FEWEST}, {MOST}]')
    remarks: tuple[str, ...] = ()
    x, y, z = (_planes(tables, k, points) for k in range(3))
    count = len(x) * len(y) * len(z)
    if count > MOST_AT_NODES and points is None:
        x, y, z = (axis_positions(tables, k, INSTEAD) for k in range(3))
        remarks = (
            f'the planes do not stand at the nodes of the tables, which make {count} points, more '
            f'than {MOST_AT_NODES}, but evenly, {INSTEAD} per axis; --points takes up to {MOST}',
        )
    empty = Lattice((x, y, z), np.empty((len(x), len(y), len(z), 3)))
    error = displacement(tables, empty.points).reshape(empty.error.shape)
    return Lattice(empty.axes, error), remarks


def _planes(tables: ErrorTables, axis: int, points: int | None) -> Array:
    """Positions of the planes across one axis, m."""
    nodes = axis_positions(tables, axis, points)
    machine = tables.machine
    if points is not None or machine.axis_names[axis] not in machine.chain.table_side:
        return nodes
    fine = np.arange(FINER * (len(nodes) - 1) + 1) / FINER
    return np.asarray(np.interp(fine, np.arange(len(nodes)), nodes).round(12))


def lattice_covariance(content: TablesFile, q: Array) -> Array:
    """Covariance of the errors at points (n, 3), shape (3 n, 3 n), m^2: x, y, z of each point.

    That of the tables where their file holds it, else their nodes as independent.
    """
    tables = content.tables
    nodes: dict[str, Array] = {m: tables.motions[m].position for m in MOTIONS}
    size = len(SQUARENESS) + sum(len(v) for v in nodes.values())
    covariance = unpack_covariance(content.extra.get('covariance'), size)
    rows = prediction_rows(tables.machine, nodes, q).reshape(3 * len(q), size)
    if covariance is None:
        own = [np.array([tables.squareness[k].u]) for k in SQUARENESS]
        own += [tables.motions[m].u for m in MOTIONS]
        covariance = np.diag(np.concatenate(own) ** 2)
    return np.asarray(rows @ covariance @ rows.T)
