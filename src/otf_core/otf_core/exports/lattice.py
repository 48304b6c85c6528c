# SPDX-License-Identifier: Apache-2.0
"""Volumetric errors on a regular lattice, trilinear between its points, written and read.

CSV: ``#`` lines, then x,y,z,dx,dy,dz,u_dx,u_dy,u_dz in m, Z fastest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError, InputError
from otf_core.exports.format import POINT_WORDS, THREE_AXES, ExportedFiles, Format, Request
from otf_core.exports.terms import axis_positions
from otf_core.files.text_table import (
    LENGTHS,
    fault_words,
    is_comment,
    known_lengths,
    read_lines,
    read_text_table,
    split_heading,
    unit_hint,
    unit_words,
)
from otf_core.model.chain import displacement, has_constant_lever
from otf_core.model.machine import Machine
from otf_core.model.motions import unit_of
from otf_core.model.nodes import hat_matrix
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.prediction.predict import predict
from otf_core.prediction.volumetric import table_places, table_rows

HEADER = ('x', 'y', 'z', 'dx', 'dy', 'dz', 'u_dx', 'u_dy', 'u_dz')
DECIMALS = 12
SAME_COORDINATE = 1e-9
"""m; coordinates that differ by less are one plane of the lattice."""


FEWEST, MOST = 2, 101
"""Points per axis."""
MOST_AT_NODES, INSTEAD = 60_000, 33
"""Points of a lattice at the nodes at most, and points per axis where they make more."""
REFINEMENT = 4
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
    points : int, optional
        Per axis, evenly spread. If not given, the planes stand at the nodes of the tables: the
        model is linear between them in the coordinates of axes that carry the target, so that
        trilinear interpolation is exact; rotations of an axis that carries the table act on its
        own travel too, which makes it quadratic there: these intervals are divided by
        ``REFINEMENT``. If that makes more than ``MOST_AT_NODES`` points, ``INSTEAD`` per axis.

    Returns
    -------
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
    x, y, z = (_planes(tables, a, points) for a in tables.machine.axis_names)
    count = len(x) * len(y) * len(z)
    if count > MOST_AT_NODES and points is None:
        x, y, z = (axis_positions(tables, a, INSTEAD) for a in tables.machine.axis_names)
        remarks = (
            f'the planes do not stand at the nodes of the tables, which make {count} points, more '
            f'than {MOST_AT_NODES}, but evenly, {INSTEAD} per axis; --points takes up to {MOST}',
        )
    empty = Lattice((x, y, z), np.empty((len(x), len(y), len(z), 3)))
    error = displacement(tables, empty.points).reshape(empty.error.shape)
    return Lattice(empty.axes, error), remarks


def _planes(tables: ErrorTables, axis: str, points: int | None) -> Array:
    """Positions of the planes across one axis, m."""
    nodes = axis_positions(tables, axis, points)
    if points is not None or axis not in tables.machine.chain.table_side:
        return nodes
    fine = np.arange(REFINEMENT * (len(nodes) - 1) + 1) / REFINEMENT
    return np.asarray(np.interp(fine, np.arange(len(nodes)), nodes).round(12))


def _make(fmt: Format, request: Request) -> ExportedFiles:
    """Make the CSV."""
    lattice, remarks = sampled_lattice(request.content.tables, request.points)
    q = lattice.points
    rounded = Lattice(lattice.axes, lattice.error.round(DECIMALS) + 0.0)
    u = predict(request.content, q).u.round(DECIMALS)
    rows = np.hstack([q.round(DECIMALS) + 0.0, rounded.error.reshape(-1, 3), u]).tolist()
    lines = [f'# {line}' for line in request.header(fmt)]
    lines += [','.join(HEADER)]  # no u outside the driven volume
    lines += [','.join(repr(v) if v == v else '' for v in row) for row in rows]
    text = ('\n'.join(lines) + '\n').encode()
    return ExportedFiles({request.name: text}, rounded.at, remarks)


def read_lattice_csv(path: str | Path) -> Lattice:
    """Read a lattice in any order of its points.

    Raises
    ------
    ConfigError
        Names file and line of what is wrong, or the point that is missing.
    """
    q, error = _columns(path)
    axes, places = [], []
    for k in range(3):
        order = np.unique(q[:, k])
        axes.append(order[np.concatenate([[True], np.diff(order) > SAME_COORDINATE])])
        places.append(np.abs(q[:, k, None] - axes[k]).argmin(axis=1))
    shape = tuple(map(len, axes))
    filled = np.full((*shape, 3), np.nan)
    filled[tuple(places)] = error
    missing = np.argwhere(np.isnan(filled[..., 0]))
    if len(missing) or len(q) != np.prod(shape):
        what = 'points appear twice'
        if len(missing):
            x, y, z = (axes[k][missing[0][k]] for k in range(3))
            what = f'no point at ({x:g}, {y:g}, {z:g})'
        raise ConfigError(
            f'{path}: not a regular lattice: {len(q)} points, '
            f'{" x ".join(map(str, shape))} planes, {what}'
        )
    if min(shape) < 2:
        raise ConfigError(f'{path}: needs two points along every axis, got {shape}')
    return Lattice((axes[0], axes[1], axes[2]), filled)


def _columns(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions and errors, each (n, 3), m, or in the units that the header states."""
    wanted = HEADER[:6]
    try:
        table = read_text_table(path, _is_head)
    except InputError as error:
        raise ConfigError(f'{error}; expected the header {",".join(wanted)}') from None
    if table.names is None:
        raise ConfigError(f'{path}: expected the header {",".join(wanted)}, in m')
    headings = [split_heading(name) for name in table.names]
    names = [name.lower() for name, _ in headings]
    places = [names.index(name) for name in wanted]
    read, _ = table.numbers({place: table.names[place] for place in places})
    faults = dict(table.faults)
    for column in read:
        faults |= {table.lines[row]: reason for row, reason in column.faults.items()}
    if faults:
        raise ConfigError(
            f'{path}: line {min(faults)}: expected six numbers; {fault_words(faults)}'
        )
    values = np.stack([column.values for column in read], axis=1)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise ConfigError(f'{path}: line {table.lines[bad[0]]}: not finite')
    for k, place in enumerate(places):
        unit = headings[place][1] or 'm'
        if unit not in LENGTHS:
            raise ConfigError(
                f'{path}: {table.names[place]}: no unit of length; possible: {known_lengths()}'
            )
        values[:, k] *= LENGTHS[unit]
    return values[:, :3], values[:, 3:]


def holds_lattice(path: str | Path) -> bool:
    """Return whether a text has the header of a lattice."""
    return any(_is_head(line.split(',')) for line in read_lines(path) if not is_comment(line))


def _is_head(fields: Sequence[str]) -> bool:
    return set(HEADER[:6]) <= {split_heading(field)[0].lower() for field in fields}


# Error tables from volumetric errors on a lattice: least squares over all 21 functions.
#
# Nodes stand at the planes of the lattice. The rigid-body model is linear in the node values, so e
# = A p; of all p that fit alike (what is squareness, what a slope) the shortest is taken, angles
# in units of the longest travel. What the model cannot follow stays over and is reported.
# Rotations that act like translations, since no other axis changes their lever, are these: they
# are zero and marked as not seen, so that a prediction for another target offset knows it.

SINGULAR_VALUE_RATIO = 1e-10
"""Relative size of singular values below which a combination is not determined."""
OUTSIDE_TOLERANCE = 1e-3
"""m; a lattice further outside the axes is not of this machine."""

MAX_ERROR_RATIO = 0.01
"""Of the travel; no machine has larger errors."""
MAX_ERROR_RATIO_IN_MM = 1.0
"""Of the travel; errors in mm, read as m, are less."""


@dataclass(frozen=True)
class ImportedTables:
    """Tables and what they leave of the lattice.

    Attributes
    ----------
    tables : ErrorTables
        Without uncertainties.
    size_rms, left_rms : float
        m; of the errors on the lattice, and of what the tables do not follow.
    """

    tables: ErrorTables
    size_rms: float
    left_rms: float


def tables_from_lattice(lattice: Lattice, machine: Machine) -> ImportedTables:
    """Fit error tables to a lattice.

    Parameters
    ----------
    machine : Machine
        Its chain and target offset say how rotations act.

    Raises
    ------
    ConfigError
        If the lattice reaches beyond the axes of the machine, or its errors are none of a machine.
    """
    q = lattice.points
    _check_size(lattice, machine)
    low, high, reach = q.min(axis=0), q.max(axis=0), float(np.max(machine.upper - machine.lower))
    empty: dict[str, MotionTable] = {
        m: MotionTable(at, 0.0 * at, 0.0 * at, m.is_translation or turns)
        for m in machine.motions
        for at in [lattice.axes[machine.column(m.axis)]]
        for turns in [not has_constant_lever(machine, m, low, high)]
    }
    tables = ErrorTables(machine, empty, {n: ScalarError() for n in machine.squareness})
    matrix, places = table_rows(tables, q).reshape(3 * len(q), -1), table_places(tables)
    scale = np.full(matrix.shape[1], 1.0 / reach)
    for motion, table in empty.items():
        scale[places[motion]] *= table.identifiable * (reach if unit_of(motion) == 'm' else 1.0)
    scaled, wanted = matrix * scale, lattice.error.reshape(-1)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    seen = values > SINGULAR_VALUE_RATIO * values[-1]
    basis = vectors[:, seen]
    solved = scale * (basis @ ((basis.T @ (scaled.T @ wanted)) / values[seen]))
    motions = {m: replace(t, value=solved[places[m]]) for m, t in empty.items()}
    square = {n: ScalarError(float(solved[places[n]][0])) for n in machine.squareness}
    sizes = (_rms(wanted), _rms(wanted - matrix @ solved))
    return ImportedTables(ErrorTables(machine, motions, square), *sizes)


def _check_size(lattice: Lattice, machine: Machine) -> None:
    """Refuse positions and errors in another unit than m."""
    q, size = lattice.points, float(np.max(machine.upper - machine.lower))
    beyond = float(np.maximum(machine.lower - q, q - machine.upper).max())
    if beyond > OUTSIDE_TOLERANCE:
        reach = float(np.abs([machine.lower, machine.upper]).max())
        hint = unit_hint(float(np.abs(q).max()), reach)
        named = f'x_{hint},y_{hint},z_{hint}'
        words = f'; are they in {unit_words(hint)}? write {named} into the header'
        raise ConfigError(
            f'lattice: reaches {1e3 * beyond:.4g} mm beyond the axes of {machine.name}; '
            f'positions are in m{words if hint else ""}'
        )
    largest = float(np.abs(lattice.error).max())
    if largest > MAX_ERROR_RATIO * size:
        unit = 'um' if largest > MAX_ERROR_RATIO_IN_MM * size else 'mm'
        raise ConfigError(
            f'lattice: an error of {largest:g} m is implausible for a machine of {size:g} m; '
            f'are dx, dy, '
            f'dz in {unit_words(unit)}? write dx_{unit},dy_{unit},dz_{unit} into the header'
        )


def _rms(values: Array) -> float:
    """Root mean square of vectors of three."""
    return float(np.sqrt(np.mean(np.sum(values.reshape(-1, 3) ** 2, axis=1))))


FORMATS = (
    Format(
        'lattice-csv',
        _make,
        POINT_WORDS,
        'dx, dy, dz are errors (actual minus nominal), u standard uncertainties; all in m',
        'values between lattice points (interpolate trilinearly), other target offsets than the '
        'measured one, correlations; differences between the directions of travel',
        holds=THREE_AXES,
        takes_points=True,
    ),
)
