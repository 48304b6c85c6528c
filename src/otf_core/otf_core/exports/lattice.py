# SPDX-License-Identifier: Apache-2.0
"""Volumetric errors on a lattice, and the part of them that tables in one variable hold."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.files.text_table import unit_hint, unit_words
from otf_core.model.joints import Sight
from otf_core.model.kinematics import displacement, has_constant_lever
from otf_core.model.machine import Chain, Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.nodes import hat_matrix
from otf_core.model.tables import ErrorTables, MotionTable, Squareness, TablesFile
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.uncertainty import prediction_rows

# What tables in one variable can hold of the volumetric error: its mean over the other axes.
#
# f_ij(q_j) = mean of e_i over the positions of the other two axes, zero at the reference position
# of j. The sum of such functions of one axis each is the least-squares fit to the whole volume. In
# the rigid-body model of first order the motions of another axis k act through their means over
# its range: q_k enters the levers linearly, and products of q_k with motions of k do not depend on
# q_j. So f_ij is the course along the middle line of j with the means in place of the motions of
# k.

Pair = tuple[int, int]
"""Direction of the error, axis that moves."""

ALL_PAIRS = tuple((i, j) for j in range(3) for i in range(3))
OWN_PAIRS = tuple((i, i) for i in range(3))
CROSS_PAIRS = tuple(pair for pair in ALL_PAIRS if pair[0] != pair[1])


@dataclass(frozen=True)
class LineTerm:
    """Error in one direction as a function of one axis.

    Attributes
    ----------
    position : ndarray, shape (k,), m
    value : ndarray, shape (k,), m
        Actual minus nominal.
    """

    position: Array
    value: Array


def axis_positions(tables: ErrorTables, axis: int, points: int | None = None) -> Array:
    """Positions of an axis at which a table says all that the tables say, m.

    Parameters
    ----------
    points : int, optional
        Spread this many evenly over the range of the tables, instead of taking their nodes. The
        only position of an axis that did not move stands once.
    """
    low, high = (float(v[axis]) for v in table_ranges(tables))
    if points is not None and high > low:
        return np.linspace(low, high, points).round(12)
    own = tables.machine.axis_names[axis]
    nodes = np.concatenate(
        [tables.motions[m].position for m in tables.machine.motions if m.axis == own]
        + [[low, high]]
    )
    return np.unique(nodes[(nodes >= low) & (nodes <= high)].round(12))


def even_points(tables: ErrorTables, axis: int, most: int) -> int:
    """Points of an even spacing as fine as the nodes of an axis, at most so many."""
    nodes = axis_positions(tables, axis)
    if len(nodes) < 2:
        return 2
    wide = np.diff(nodes)
    typical = float(np.median(wide))
    return min(most, int(np.ceil(np.ptp(nodes) / typical - 1e-6)) + 1)


def reference_position(tables: ErrorTables, axis: int) -> float:
    """Where tables of an axis are zero: its zero position, else its minimum, m."""
    low, high = (float(v[axis]) for v in table_ranges(tables))
    return 0.0 if low <= 0.0 <= high else low


def middle_line(tables: ErrorTables, axis: int, position: Array) -> Array:
    """Points (k, 3), m, along the line of an axis through the middle of the volume."""
    low, high = table_ranges(tables)
    q = np.tile(0.5 * (low + high), (len(position), 1))
    q[:, axis] = position
    return q


def mean_motion(table: MotionTable, low: float, high: float) -> MotionTable:
    """Motion that is constant at its mean from one position to another, m."""
    inner = table.position[(table.position > low) & (table.position < high)]
    q = np.concatenate([[low], inner, [high]])
    value = table.at(q)
    mean = value[:1]
    if high > low:
        mean = np.array([0.5 * np.sum((value[1:] + value[:-1]) * np.diff(q)) / (high - low)])
    return MotionTable(np.array([low]), mean, np.zeros(1))


def others_at_their_means(tables: ErrorTables, axis: int) -> ErrorTables:
    """Tables in which the motions of the other axes are constant: their means over the range."""
    low, high = (v.tolist() for v in table_ranges(tables))
    motions = dict(tables.motions)
    for m in (m for m in MOTIONS if m.place != axis):
        motions[m] = mean_motion(motions[m], low[m.place], high[m.place])
    return replace(tables, motions=motions)


def line_terms(
    tables: ErrorTables, pairs: Collection[Pair], positions: Mapping[int, Array]
) -> dict[Pair, LineTerm]:
    """Errors as functions of one axis each, means over the others.

    Parameters
    ----------
    pairs : collection of pair
        Direction of the error, axis that moves.
    positions : mapping of axis to ndarray, m
    """
    means = {j: others_at_their_means(tables, j) for j in {j for _, j in pairs}}
    terms = {}
    for i, j in pairs:
        at = positions[j]
        error = displacement(means[j], middle_line(tables, j, at))[:, i]
        # zero in the table as the control reads it, also where the reference lies between nodes
        zero = np.interp(reference_position(tables, j), at, error)
        terms[i, j] = LineTerm(at, error - zero)
    return terms


def even_terms(
    tables: ErrorTables, pairs: Collection[Pair], points: int | None, most: int, decimals: int
) -> dict[Pair, LineTerm]:
    """Errors as functions of one axis at even spacings, rounded as they will be written.

    Those of an axis that did not move are left out: a table needs a range.

    Parameters
    ----------
    points : int, optional
        Per axis; as fine as the nodes if not given.
    most : int
        Of these, what the control holds.
    decimals : int
        Of values in mm.
    """
    positions = {
        k: axis_positions(tables, k, points or even_points(tables, k, most)) for k in range(3)
    }
    return {
        pair: LineTerm(term.position, term.value.round(decimals + 3))
        for pair, term in line_terms(tables, pairs, positions).items()
        if len(term.position) > 1
    }


def linear_tables(tables: ErrorTables) -> ErrorTables:
    """Tables of the linear axes alone: what a machine does whose rotary axes stand at zero."""
    machine = tables.machine
    if not machine.rotary_names:
        return tables
    links = [link for link in str(machine.chain).split('-') if link not in machine.rotary_names]
    linear = replace(
        machine,
        chain=Chain.parse('-'.join(links)),
        axes={a: v for a, v in machine.axes.items() if not v.rotary},
    )
    motions: dict[str, MotionTable] = {m: tables.motions[m] for m in linear.motions}
    return replace(tables, machine=linear, motions=motions, location={})


def rotary_term(
    tables: ErrorTables, axis: str, points: int | None, most: int, decimals: int
) -> LineTerm | None:
    """Positioning error of a rotary axis at even spacings, rad; None where it did not move.

    Positive in the sense of the programmed angle: the part of its rotations about its direction.

    Parameters
    ----------
    points : int, optional
        As fine as the nodes if not given.
    decimals : int
        Of values in degrees.
    """
    machine = tables.machine
    column = machine.column(axis)
    at = axis_positions(tables, column, points or even_points(tables, column, most))
    if len(at) < 2:
        return None
    turns = np.stack([tables.motions[f'E{d}{axis}'].at(at) for d in 'ABC'], axis=1)
    error = turns @ np.array(machine.axes[axis].direction)
    error -= np.interp(reference_position(tables, column), at, error)
    return LineTerm(at, np.radians(np.degrees(error).round(decimals)))


def displacement_by_terms(machine: Machine, terms: Mapping[str, LineTerm], q: Array) -> Array:
    """Displacement (n, 3), m, in the frame of the table, of axes that are off by their terms."""
    off = np.zeros_like(q)
    for axis, term in terms.items():
        column = machine.column(axis)
        off[:, column] = np.interp(machine.wrapped(q)[:, column], term.position, term.value)
    return np.asarray(np.einsum('nij,nj->ni', Sight.of_tool(machine).at(q).velocity, off))


def axes_without_table(tables: ErrorTables) -> tuple[str, ...]:
    """State which axes did not move, so that there is no table over their positions."""
    low, high = table_ranges(tables)
    still = [a for a, b, c in zip(tables.machine.axis_names, low, high, strict=True) if b == c]
    if not still:
        return ()
    return (
        f'{", ".join(still)}: did not move in the calibration, so no table over its positions',
    )


def error_of_terms(terms: Mapping[Pair, LineTerm], q: Array) -> Array:
    """Error (n, 3), m, that terms hold at positions (n, 3), m; constant beyond their ends."""
    total = np.zeros_like(q)
    for (i, j), term in terms.items():
        total[:, i] += np.interp(q[:, j], term.position, term.value)
    return total


def pair_name(pair: Pair, axes: Sequence[str]) -> str:
    """State a pair: 'error along Y with X'."""
    return f'error along {axes[pair[0]]} with {axes[pair[1]]}'


# How positioning differs between forward and backward travel, from ``reversal`` of a file.
#
# The reversal value of a motion is its error in forward travel less that in backward travel;
# tables hold the mean. Along the middle line of an axis its own motions act alone.


def reversal_motions(content: TablesFile) -> dict[str, MotionTable]:
    """Reversal values by motion, forward minus backward; empty if the file holds none.

    Raises
    ------
    ConfigError
        If it holds some that are no numbers at ascending positions.
    """
    reversal = content.extra.get('reversal')
    motions = reversal.get('motions') if isinstance(reversal, Mapping) else None
    if not isinstance(motions, Mapping):
        return {}
    tables = {}
    for name, entry in motions.items():
        try:
            position, value = (np.asarray(entry[k], dtype=float) for k in ('position', 'value'))
        except (KeyError, TypeError, ValueError):
            raise ConfigError(f'reversal: {name}: expected position and value, lists') from None
        ascending = position.ndim == 1 and bool(np.all(np.diff(position) > 0))
        if name not in MOTIONS or not ascending or position.shape != value.shape:
            raise ConfigError(f'reversal: {name}: no table of an error motion')
        tables[name] = MotionTable(position, value, 0.0 * value)
    return tables


def half_reversal(content: TablesFile, axis: int, position: Array) -> Array:
    """Half of the positioning in forward less that in backward travel, shape (k,), m.

    Parameters
    ----------
    position : ndarray, shape (k,), m
        Along the line of the axis through the middle of the volume.
    """
    tables, known = content.tables, reversal_motions(content)
    none = MotionTable(np.zeros(1), np.zeros(1), np.zeros(1))
    own: dict[str, MotionTable] = {
        m: known.get(m, none) if m.place == axis else none for m in MOTIONS
    }
    q = middle_line(tables, axis, position)
    only = replace(tables, motions=own, squareness={k: Squareness() for k in SQUARENESS})
    return np.asarray(0.5 * displacement(only, q)[:, axis])


# Volumetric errors on a regular lattice, trilinear between its points.

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
    fine = np.arange(REFINEMENT * (len(nodes) - 1) + 1) / REFINEMENT
    return np.asarray(np.interp(fine, np.arange(len(nodes)), nodes).round(12))


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
    nodes: dict[str, Array] = {m: lattice.axes[m.place] for m in MOTIONS}
    matrix = prediction_rows(machine, nodes, q).reshape(3 * len(q), -1)
    sizes = [1] * len(SQUARENESS) + [len(nodes[m]) for m in MOTIONS]
    reach = float(np.max(machine.upper - machine.lower))
    scale = np.concatenate(
        [[1.0 / reach] * len(SQUARENESS)]
        + [np.full(len(nodes[m]), 1.0 if m.is_translation else 1.0 / reach) for m in MOTIONS]
    )
    low, high = q.min(axis=0), q.max(axis=0)
    rotations = [m for m in MOTIONS if not m.is_translation]
    hidden = {m for m in rotations if has_constant_lever(machine, m, low, high)}
    scale[np.repeat([False] * len(SQUARENESS) + [m in hidden for m in MOTIONS], sizes)] = 0.0
    scaled, wanted = matrix * scale, lattice.error.reshape(-1)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    seen = values > SINGULAR_VALUE_RATIO * values[-1]
    basis = vectors[:, seen]
    solved = scale * (basis @ ((basis.T @ (scaled.T @ wanted)) / values[seen]))
    remainder = wanted - matrix @ solved
    tables = _tables(machine, nodes, solved, hidden)
    return ImportedTables(tables, float(_rms(wanted)), float(_rms(remainder)))


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


def _rms(values: Array) -> Array:
    """Root mean square of vectors of three."""
    return np.asarray(np.sqrt(np.mean(np.sum(values.reshape(-1, 3) ** 2, axis=1))))


def _tables(
    machine: Machine, nodes: dict[str, Array], values: Array, hidden: Collection[str]
) -> ErrorTables:
    square = {k: Squareness(float(v)) for k, v in zip(SQUARENESS, values[:3], strict=True)}
    motions: dict[str, MotionTable] = {}
    start = len(SQUARENESS)
    for motion in MOTIONS:
        position = nodes[motion]
        own = values[start : start + len(position)]
        motions[motion] = MotionTable(position, own, np.zeros(len(position)), motion not in hidden)
        start += len(position)
    return ErrorTables(machine, motions, square)
