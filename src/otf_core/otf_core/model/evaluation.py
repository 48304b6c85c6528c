# SPDX-License-Identifier: Apache-2.0
"""Errors over a volume: positions that stand for it, fields without rigid motion, mean length."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ShapeError
from otf_core.model.machine import Machine
from otf_core.model.tables import ErrorTables

GRID, GRID_AXES = 7, 3
"""Points per axis of a regular lattice, and axes that have one at most."""
PLACES = 300
"""Axis positions at which errors are judged that depend on more than three axes."""


def lattice(machine: Machine, count: int = GRID) -> Array:
    """Regular lattice of count points per axis over the ranges, shape (count**k, k), m and rad."""
    ends = zip(machine.lower, machine.upper, strict=True)
    grids = np.meshgrid(*(np.linspace(a, b, count) for a, b in ends), indexing='ij')
    return np.stack([g.ravel() for g in grids], axis=1)


def covered_grid(machine: Machine, points: Array, count: int) -> Array:
    """Lattice over the part of the axis ranges that positions (n, k), m and rad, cover.

    Beyond it tables are held constant: no noise tells how wrong that is.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    axes = {
        a: replace(machine.axes[a], min=float(low[k]), max=float(high[k]))
        for k, a in enumerate(machine.axis_names)
    }
    return lattice(replace(machine, axes=axes), count)


def evenly_spread(low: Array, high: Array, count: int = PLACES) -> Array:
    """Positions (n, k) that fill ranges evenly and keep no step with nodes.

    Multiples of the powers of the root of g^(k + 1) = g + 1, the remainders by 1.
    """
    k = len(low)
    g = 1.5
    for _ in range(50):
        g = (1.0 + g) ** (1.0 / (k + 1))
    share = (0.5 + np.arange(count)[:, None] * g ** -np.arange(1.0, k + 1.0)) % 1.0
    return np.asarray(low + share * (high - low))


def driven_positions(tables: ErrorTables, count: int = PLACES) -> Array:
    """Axis positions (n, k), m and rad, that stand for the range of the tables.

    A regular lattice; of more than three axes ``count`` positions that are spread evenly.
    """
    names = tables.machine.axis_names
    low, high = np.transpose([tables.motions[f'E{a}{a}'].position[[0, -1]] for a in names])
    if len(names) <= GRID_AXES:
        return covered_grid(tables.machine, np.array([low, high]), GRID)
    return evenly_spread(low, high, count)


def rigid_columns(q: Array) -> Array:
    """Displacement per unit of three translations and three small rotations, shape (n, 3, 6)."""
    columns = np.zeros((len(q), 3, 6))
    columns[:, :, :3] = np.eye(3)
    for k in range(3):
        columns[:, :, 3 + k] = np.cross(np.eye(3)[k], q)
    return columns


def without_rigid_motion(field: Array, q: Array) -> Array:
    """Take the best-fitting small rigid motion out of an error field.

    No calibration can know it: it belongs to the choice of the machine frame.

    Parameters
    ----------
    field : ndarray, shape (n, 3), m
    q : ndarray, shape (n, 3), m
        Where the field is given.

    Returns
    -------
    ndarray, shape (n, 3), m

    Examples
    --------
    >>> q = np.array([[0.0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1]])
    >>> moved = np.full((4, 3), 1e-5)  # all by the same: a shift of the machine frame
    >>> bool(abs(otf_core.without_rigid_motion(moved, q)).max() < 1e-15)
    True
    """
    columns = rigid_columns(q).reshape(-1, 6)
    motion = np.linalg.lstsq(columns, field.reshape(-1), rcond=None)[0]
    return np.asarray(field - (columns @ motion).reshape(-1, 3))


def mean_length(field: Array) -> float:
    """Mean length of the vectors of a field (n, 3): the mean absolute error (MAE), m."""
    return float(np.linalg.norm(field, axis=1).mean())


def free_rows(rows: Array, grid: Array) -> Array:
    """Take the best-fitting rigid motion of the grid out of the columns (3 n, k)."""
    basis, size, _ = np.linalg.svd(rigid_columns(grid).reshape(-1, 6), full_matrices=False)
    rigid = basis[:, size > 1e-9 * size[0]]
    return np.asarray(rows - rigid @ (rigid.T @ rows))


@dataclass(frozen=True)
class VolumeErrors:
    """Predicted errors on a grid.

    Attributes
    ----------
    points : ndarray, shape (n, 3), m
        Nominal positions of the target: of three linear axes the programmed positions.
    errors, u : ndarray, shape (n, 3), m
        Error in the gauge of the tables, and its standard uncertainty (k = 1).
    provisional : bool
        From a part of the run.
    axes : tuple of str
        Letters of the axes of the machine.
    positions : ndarray, shape (n, k), m and rad
        Their programmed positions at the points.

    Raises
    ------
    ShapeError
        If the arrays differ in shape.
    """

    points: Array
    errors: Array
    u: Array
    provisional: bool = False
    axes: tuple[str, ...] = ()
    positions: Array = field(default_factory=lambda: np.empty((0, 0)))

    def __post_init__(self) -> None:
        """Check the shapes."""
        shapes = [field.shape for field in (self.points, self.errors, self.u)]
        if len(set(shapes)) > 1 or shapes[0][1:] != (3,):
            raise ShapeError(f'points, errors and u need one shape (n, 3), got {shapes}')

    @property
    def mean(self) -> float:
        """Mean length of the errors without a rigid motion of the whole (m), as in reports."""
        if not len(self.points):
            return 0.0
        return mean_length(without_rigid_motion(self.errors, self.points))
