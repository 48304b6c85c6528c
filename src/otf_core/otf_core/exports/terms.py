# SPDX-License-Identifier: Apache-2.0
"""What tables in one variable hold of the volumetric error: its mean over the other axes.

f_ij(q_j) = mean of e_i over the positions of the other linear axes, rotary axes at zero, itself
zero at the reference position of j. The sum of such functions of one axis each is the
least-squares fit to the whole volume. In the rigid-body model of first order the motions of
another axis k act through their means over its range: q_k enters the levers linearly, and products
of q_k with motions of k do not depend on q_j. So f_ij is the course along the middle line of j
with the means in place of the motions of k. Of a rotary axis it is the part of its rotations about
its direction, positive in the sense of the programmed angle.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.model.chain import Sight, displacement
from otf_core.model.frames import XYZ
from otf_core.model.machine import Chain, Machine
from otf_core.model.motions import ErrorMotion
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.prediction.calibration_document import CalibrationDocument
from otf_core.prediction.driven_volume import table_ranges

Pair = tuple[str, str]
"""Axis that a control moves, axis whose position decides by how much."""


def own_pairs(machine: Machine) -> tuple[Pair, ...]:
    """Every axis by its own position."""
    return tuple((a, a) for a in machine.axis_names)


def cross_pairs(machine: Machine) -> tuple[Pair, ...]:
    """Every linear axis by the position of every other one."""
    linear = [a for a in machine.axis_names if not machine.axes[a].rotary]
    return tuple((i, j) for j in linear for i in linear if i != j)


@dataclass(frozen=True)
class LineTerm:
    """Error along or about one axis as a function of one axis.

    Attributes
    ----------
    position : ndarray, shape (k,), m or rad
    value : ndarray, shape (k,), m or rad
        Actual minus nominal.
    """

    position: Array
    value: Array


def control_unit(machine: Machine, axis: str) -> float:
    """Unit of a control per m or rad: mm, of a rotary axis degrees."""
    return float(np.degrees(1.0)) if machine.axes[axis].rotary else 1e3


def table_ends(tables: ErrorTables, axis: str) -> tuple[float, float]:
    """Range of the tables of an axis, m or rad."""
    low, high = (float(v[tables.machine.column(axis)]) for v in table_ranges(tables))
    return low, high


def axis_positions(tables: ErrorTables, axis: str, points: int | None = None) -> Array:
    """Positions of an axis at which a table says all that the tables say, m or rad.

    Parameters
    ----------
    points : int, optional
        Spread this many evenly over the range of the tables, instead of taking their nodes. The
        only position of an axis that did not move stands once.
    """
    low, high = table_ends(tables, axis)
    if points is not None and high > low:
        return np.linspace(low, high, points).round(12)
    own = [tables.motions[m].position for m in tables.machine.motions if m.axis == axis]
    nodes = np.concatenate([*own, [low, high]])
    return np.unique(nodes[(nodes >= low) & (nodes <= high)].round(12))


def even_positions(tables: ErrorTables, axis: str, points: int | None, most: int) -> Array:
    """The same at even spacing; as fine as the nodes, at most so many, where none is given."""
    nodes = axis_positions(tables, axis)
    if points is None and len(nodes) > 1:
        typical = float(np.median(np.diff(nodes)))
        points = min(most, int(np.ceil(np.ptp(nodes) / typical - 1e-6)) + 1)
    return axis_positions(tables, axis, points)


def middle_line(tables: ErrorTables, axis: str, position: Array) -> Array:
    """Positions (k, axes) along an axis: others mid-range, rotary ones at zero, m and rad."""
    machine = tables.machine
    turning = [machine.axes[a].rotary for a in machine.axis_names]
    q = np.tile(np.where(turning, 0.0, np.mean(table_ranges(tables), axis=0)), (len(position), 1))
    q[:, machine.column(axis)] = position
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


def linear_tables(tables: ErrorTables) -> ErrorTables:
    """Tables of the linear axes alone: what a machine does whose rotary axes stand at zero."""
    machine = tables.machine
    links = [link for link in str(machine.chain).split('-') if link not in machine.rotary_names]
    axes = {a: v for a, v in machine.axes.items() if not v.rotary}
    linear = replace(machine, chain=Chain.parse('-'.join(links)), axes=axes)
    motions: dict[str, MotionTable] = {m: tables.motions[m] for m in linear.motions}
    return replace(tables, machine=linear, motions=motions, location={})


def error_along(tables: ErrorTables, moved: str, axis: str, q: Array) -> Array:
    """Error along an axis, or about it, at positions (k, axes) on the middle line of one, (k,)."""
    machine = tables.machine
    spec = machine.axes[axis]
    if spec.direction is not None:
        at = q[:, machine.column(axis)]
        turns = np.stack([tables.motions[f'E{d}{axis}'].at(at) for d in 'ABC'], axis=1)
        return np.asarray(turns @ np.array(spec.direction))
    linear = [not machine.axes[a].rotary for a in machine.axis_names]
    return displacement(linear_tables(tables), q[:, linear])[:, XYZ.index(moved)]


def line_terms(
    tables: ErrorTables, pairs: Collection[Pair], positions: Mapping[str, Array], decimals: int
) -> dict[Pair, LineTerm]:
    """Errors as functions of one axis each, means over the others.

    Parameters
    ----------
    pairs : collection of Pair
    positions : mapping of axis to ndarray, m or rad
    decimals : int
        To which values in the unit of the control are rounded.
    """
    terms = {}
    for moved, axis in pairs:
        means: dict[str, MotionTable] = {
            m: table if m.axis == axis else mean_motion(table, *table_ends(tables, m.axis))
            for m in tables.machine.motions
            for table in [tables.motions[m]]
        }
        at, (low, high) = positions[axis], table_ends(tables, axis)
        line = middle_line(tables, axis, at)
        error = error_along(replace(tables, motions=means), moved, axis, line)
        # zero in the table as the control reads it, also where the reference lies between nodes
        error = error - np.interp(0.0 if low <= 0.0 <= high else low, at, error)
        unit = control_unit(tables.machine, axis)
        terms[moved, axis] = LineTerm(at, (unit * error).round(decimals) / unit)
    return terms


def even_terms(
    tables: ErrorTables, pairs: Collection[Pair], points: int | None, most: int, decimals: int
) -> dict[Pair, LineTerm]:
    """The same at even spacings, without axes that did not move: a table needs a range."""
    positions = {a: even_positions(tables, a, points, most) for _, a in pairs}
    return line_terms(tables, [p for p in pairs if len(positions[p[1]]) > 1], positions, decimals)


def error_of_terms(machine: Machine, terms: Mapping[Pair, LineTerm], q: Array) -> Array:
    """Displacement (n, 3), m, in the frame of the table, of axes that are off by their terms."""
    at, off = machine.wrapped(q), np.zeros_like(q)
    for (moved, axis), term in terms.items():
        own = at[:, machine.column(axis)]
        off[:, machine.column(moved)] += np.interp(own, term.position, term.value)
    return np.asarray(np.einsum('nij,nj->ni', Sight.of_tool(machine).at(q).velocity, off))


def term_remarks(machine: Machine, pairs: Collection[Pair]) -> tuple[str, ...]:
    """State what tables over the positions of single axes hold of a machine with rotary axes."""
    if not machine.rotary_names:
        return ()
    words = 'tables of linear axes hold with the rotary axes at zero; location errors: see pivot'
    own = [a for a in machine.rotary_names if (a, a) in pairs]
    if not own:
        return (words,)
    return (
        words,
        f'{", ".join(own)}: actual angles in degrees, angular positioning '
        f'({", ".join(f"E{a}{a}" for a in own)}) alone, in the sense of the programmed angle',
    )


def half_reversal(content: CalibrationDocument, axis: str, position: Array) -> Array:
    """Half of the positioning in forward less that in backward travel, shape (k,), m or rad.

    From ``reversal`` of a file: error of a motion in forward travel less that in backward travel,
    while tables hold the mean. Along the middle line of an axis its own motions act alone.

    Raises
    ------
    ConfigError
        If it holds values that are no numbers at ascending positions.
    """
    tables, known = content.tables, _reversal_motions(content)
    none = MotionTable(np.zeros(1), np.zeros(1), np.zeros(1))
    motions: dict[str, MotionTable] = {
        m: known.get(m, none) if m.axis == axis else none for m in tables.machine.motions
    }
    only = ErrorTables(
        tables.machine,
        motions,
        {k: ScalarError() for k in tables.squareness},
        {k: ScalarError() for k in tables.location},
    )
    return 0.5 * error_along(only, axis, axis, middle_line(tables, axis, position))


def _reversal_motions(content: CalibrationDocument) -> dict[str, MotionTable]:
    """Reversal values by motion, forward minus backward; empty if the file holds none."""
    own = content.reversal.motions if content.reversal else {}
    return {
        ErrorMotion.of(name): MotionTable(one.position, one.value, 0.0 * one.value)
        for name, one in own.items()
    }
