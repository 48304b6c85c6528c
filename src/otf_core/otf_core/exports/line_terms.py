# SPDX-License-Identifier: Apache-2.0
"""What tables in one variable can hold of the volumetric error: its mean over the other axes.

f_ij(q_j) = mean of e_i over the positions of the other two axes, zero at the reference position of
j. The sum of such functions of one axis each is the least-squares fit to the whole volume. In the
rigid-body model of first order the motions of another axis k act through their means over its
range: q_k enters the levers linearly, and products of q_k with motions of k do not depend on q_j.
So f_ij is the course along the middle line of j with the means in place of the motions of k.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.model.kinematics import displacement
from otf_core.model.motions import MOTIONS
from otf_core.model.tables import ErrorTables, MotionTable
from otf_core.prediction.driven_volume import table_ranges

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
    tables : ErrorTables
    axis : int
    points : int, optional
        Spread this many evenly over the range of the tables, instead of taking their nodes. The
        only position of an axis that did not move stands once.
    """
    low, high = (float(v[axis]) for v in table_ranges(tables))
    if points is not None and high > low:
        return np.linspace(low, high, points).round(12)
    nodes = np.concatenate(
        [tables.motions[m].position for m in MOTIONS if m.place == axis] + [[low, high]]
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
    tables : ErrorTables
    pairs : collection of pair
        Direction of the error, axis that moves.
    positions : mapping of axis to ndarray, m

    Returns
    -------
    mapping of pair to LineTerm
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
    tables : ErrorTables
    pairs : collection of pair
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


def without_table(tables: ErrorTables) -> tuple[str, ...]:
    """Say which axes did not move, so that there is no table over their positions."""
    low, high = table_ranges(tables)
    still = [a for a, b, c in zip(tables.machine.axis_names, low, high, strict=True) if b == c]
    if not still:
        return ()
    return (
        f'{", ".join(still)}: did not move in the calibration, so no table over its positions',
    )


def held_by(terms: Mapping[Pair, LineTerm], q: Array) -> Array:
    """Error (n, 3), m, that terms hold at positions (n, 3), m; constant beyond their ends."""
    total = np.zeros_like(q)
    for (i, j), term in terms.items():
        total[:, i] += np.interp(q[:, j], term.position, term.value)
    return total


def pair_name(pair: Pair, axes: Sequence[str]) -> str:
    """Say a pair: 'error along Y with X'."""
    return f'error along {axes[pair[0]]} with {axes[pair[1]]}'
