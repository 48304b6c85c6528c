# SPDX-License-Identifier: Apache-2.0
"""From a solution to tables in their gauge: nodes, location errors, covariance, what is seen.

The line of a rotary axis, its location errors, is the least-squares line over the nodes: with D a
displacement of the line and R(q) the rotation of the axis, the motions of a line moved by D are

    target side  m = D - R D,    table side  m = R^-1 D - D

They and a constant are fitted to the motions at the nodes, taken off them and added to the location
errors; then the motions are set to zero at the zero position of the axis. None of it changes the
errors of the machine by more than a rigid motion of table or target.
"""  # noqa: E501

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.model.evaluation import evenly_spread, rigid_columns
from otf_core.model.joints import Sight, rotations
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS, location_names
from otf_core.model.nodes import hat_matrix, table_nodes
from otf_core.model.tables import ErrorTables, LocationError, MotionTable, Squareness
from otf_core.rotary.axis_solution import AxisSolution
from otf_core.solving.solution import Positive, free_columns, smoothness
from otf_core.solving.tabulate import projection
from otf_core.solving.unknowns import linear, reference_position

FRACTIONS = (1, 2, 3, 4, 6, 8)
MOST_NODES = 1600
WORTH = 0.3
"""Share of the mean uncertainty of the grid that straight lines between nodes may cost."""
BENDS = 0.1
"""Weight of smoothness where it is judged what the data show, in units of 1 / limit^2: what they
show is then known to less than the limit, what they do not to several times it."""


@dataclass(frozen=True)
class AxisTables:
    """Tables of a solution.

    Attributes
    ----------
    covariance : ndarray, shape (m, m)
        Of squareness and location errors and all nodes.
    fraction : int
        Nodes stand ``table_pitch / fraction`` apart.
    hidden : tuple of str
        What the data do not show; zero in the tables.
    grid_u : float
        m; mean uncertainty of the error vectors over the driven ranges.
    rows : ndarray, shape (m, full)
        Squareness and location errors and nodes from all unknowns.
    straight : ndarray, shape (m,), m^2 and rad^2
        Variance that stands for what straight lines between nodes miss.
    """

    tables: ErrorTables
    covariance: Array
    hidden: tuple[str, ...]
    fraction: int
    grid_u: float
    rows: Array
    straight: Array


def raw_rows(joint: AxisSolution, nodes: Mapping[str, Array]) -> Array:
    """Scalars and node values from the full vector, in the gauge of the unknowns, (m, full)."""
    machine, unknowns = joint.machine, joint.unknowns
    sizes = [1] * len(machine.scalars) + [len(nodes[m.axis]) for m in machine.motions]
    rows = np.zeros((sum(sizes), unknowns.full))
    start = 0
    for name in machine.scalars:
        rows[start, unknowns.blocks[name].start] = 1.0
        start += 1
    for motion in machine.motions:
        own = nodes[motion.axis]
        stop = start + len(own)
        rows[start:stop, unknowns.blocks[motion]] = projection(
            motion, unknowns.bases[motion.axis], own
        )
        start = stop
    return rows


def line_motions(machine: Machine, axis: str, q: Array) -> Array:
    """Displacement (n, 3, 3) that a displacement of the line of a rotary axis does as motion."""
    spec = machine.axes[axis]
    assert spec.direction is not None
    sign = -1.0 if axis in machine.chain.table_side else 1.0
    return np.asarray(sign * (np.eye(3) - rotations(sign * q, np.array(spec.direction))))


def gauge_matrix(machine: Machine, nodes: Mapping[str, Array]) -> Array:
    """Scalars and nodes (m, m) in the gauge of the tables from those in any other."""
    names = list(machine.scalars)
    places, start = {n: k for k, n in enumerate(names)}, len(names)
    spans = {}
    for motion in machine.motions:
        spans[str(motion)] = np.arange(start, start + len(nodes[motion.axis]))
        start += len(nodes[motion.axis])
    matrix = np.eye(start)
    for axis in machine.rotary_names:
        q = nodes[axis]
        reference = reference_position(q[0], q[-1])
        moved = line_motions(machine, axis, q)
        at_zero = hat_matrix(q, np.array([reference]))[0]
        for first in (0, 3):  # translations, rotations
            letters = DIRECTIONS[first : first + 3]
            free = [n for n in location_names(axis) if n[0] in letters]
            columns = [letters.index(n[0]) for n in free]
            shapes = moved[:, :, columns]  # (n, 3, 2)
            design = np.zeros((len(q), 3, len(free) + 3))
            design[:, :, : len(free)] = shapes
            design[:, :, len(free) :] = np.eye(3)
            own = np.concatenate([spans[f'E{d}{axis}'] for d in letters])
            # one direction after the other, as the nodes lie in the vector
            flat = design.transpose(1, 0, 2).reshape(3 * len(q), -1)
            line = np.linalg.lstsq(flat, np.eye(3 * len(q)), rcond=1e-9)[0][: len(free)]
            change = np.eye(3 * len(q)) - shapes.transpose(1, 0, 2).reshape(3 * len(q), -1) @ line
            zero = np.kron(np.eye(3), np.outer(np.ones(len(q)), at_zero))
            change = change - zero @ change
            matrix[np.ix_(own, own)] = change
            for k, name in enumerate(free):
                matrix[places[name], own] = line[k]
    return matrix


def field_rows(machine: Machine, nodes: Mapping[str, Array], q: Array) -> Array:
    """Derivatives of the error at positions (n, k) by scalars and nodes, (3 n, m), rigid out."""
    from otf_core.prediction.uncertainty import prediction_rows

    rows = prediction_rows(machine, {m: nodes[m.axis] for m in machine.motions}, q)
    return remove_rigid_motions(machine, q, rows.reshape(-1, rows.shape[2]))


def remove_rigid_motions(machine: Machine, q: Array, rows: Array) -> Array:
    """Take the rigid motions of the table out of columns (3 n, m) of errors at q (n, k)."""
    points = Sight.of_tool(machine).nominal(q)
    basis = np.linalg.qr(rigid_columns(points).reshape(-1, 6))[0]
    return np.asarray(rows - basis @ (basis.T @ rows))


def tabulate(machine: Machine, joint: AxisSolution, driven: tuple[Array, Array], limit: float,
             covariance: Array) -> AxisTables:  # fmt: skip
    """Make tables of the functions that were solved for.

    Parameters
    ----------
    driven : tuple of ndarray, shape (k,)
        Lowest and highest positions driven.
    limit : float
        m and rad; ``unidentifiable_above``.
    covariance : ndarray, shape (full, full)
        Of the unknowns.
    """
    low, high = driven
    q = evenly_spread(low, high)
    best = None
    fine = table_nodes(_finer(machine, FRACTIONS[-1]), low, high)
    fine_value = gauge_matrix(machine, fine) @ (raw_rows(joint, fine) @ joint.solution.value)
    reference = field_rows(machine, fine, q) @ fine_value
    for fraction in FRACTIONS:
        nodes = table_nodes(_finer(machine, fraction), low, high)
        if best is not None and 6 * sum(len(n) for n in nodes.values()) > MOST_NODES:
            break
        rows = gauge_matrix(machine, nodes) @ raw_rows(joint, nodes)
        value = rows @ joint.solution.value
        field = field_rows(machine, nodes, q)
        cost = float(np.linalg.norm((field @ value - reference).reshape(-1, 3), axis=1).mean())
        spread = rows @ covariance @ rows.T
        variance = np.einsum('ij,ij->i', field @ spread, field)
        grid_u = float(np.sqrt(np.maximum(variance, 0.0).reshape(-1, 3).sum(axis=1)).mean())
        best = (fraction, nodes, rows, value, spread, grid_u, cost)
        if cost <= WORTH * grid_u:
            break
    assert best is not None
    fraction, nodes, rows, value, spread, grid_u, cost = best
    straight = _straight(joint, nodes, spread)
    seen = determined_combinations(joint, rows, limit)
    made = _assembled(machine, nodes, value, spread + np.diag(straight), seen)
    return AxisTables(*made, fraction=fraction, grid_u=grid_u, rows=rows, straight=straight)


def _straight(joint: AxisSolution, nodes: Mapping[str, Array], covariance: Array) -> Array:
    """Variance (m,) of the nodes that stands for what straight lines between them miss.

    Independent nodes of variance v make 2/3 v on the average over the places between them.
    """
    machine, unknowns = joint.machine, joint.unknowns
    parts = [np.zeros(len(machine.scalars))]
    for motion in machine.motions:
        basis, at = unknowns.bases[motion.axis], nodes[motion.axis]
        coefficients = joint.solution.value[unknowns.blocks[motion]]
        table = projection(motion, basis, at) @ coefficients
        fine = linear(at).finer(8)
        missed = basis.matrix(fine) @ coefficients - np.interp(fine, at, table)
        parts.append(np.full(len(at), 1.5 * float(np.mean(missed**2))))
    return np.concatenate(parts) * (np.diag(covariance) > 0.0)


def determined_combinations(joint: AxisSolution, rows: Array, limit: float) -> NDArray[np.bool_]:
    """Which combinations (m, full) the data determine without what is assumed of smoothness."""
    unknowns = joint.unknowns
    use = free_columns(unknowns, joint.solution.accepted)
    place = np.ix_(use, use)
    weight = joint.normal.matrix[place] * limit**2 + BENDS * smoothness(unknowns)[place]
    own = (rows @ unknowns.gauge)[:, use]
    variance = np.einsum('ij,ji->i', own, Positive(weight).solve(own.T))
    return np.asarray(variance <= 1.0)


def _finer(machine: Machine, fraction: int) -> Machine:
    axes = {
        name: replace(axis, table_pitch=axis.table_pitch / fraction)
        for name, axis in machine.axes.items()
    }
    return replace(machine, axes=axes)


def _assembled(
    machine: Machine,
    nodes: Mapping[str, Array],
    value: Array,
    covariance: Array,
    seen: NDArray[np.bool_],
) -> tuple[ErrorTables, Array, tuple[str, ...]]:
    """Tables, the covariance of their values, and what the data do not show."""
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    hidden: list[str] = []
    in_tables = np.ones(len(value), dtype=bool)
    count = len(machine.scalars)
    for k, name in enumerate(machine.scalars):
        in_tables[k] = bool(seen[k])
        if not seen[k]:
            hidden.append(name)
    motions: dict[str, MotionTable] = {}
    start = count
    for motion in machine.motions:
        at = nodes[motion.axis]
        own = slice(start, start + len(at))
        start = own.stop
        free = u[own] > 0.0
        known = seen[own]
        visible = bool(np.mean(known[free]) > 0.5) if free.any() else len(at) > 1
        if not visible:
            hidden.append(str(motion))
            in_tables[own] = False
        motions[motion] = MotionTable(
            at,
            np.where(visible, value[own], 0.0) + 0.0,
            u[own],
            visible,
            known & visible,
        )
    # what is written as zero may be what was estimated, within its uncertainty
    left_out = np.where(in_tables, 0.0, value)
    spread = covariance + np.outer(left_out, left_out)
    u = np.sqrt(np.maximum(np.diag(spread), 0.0))
    motions = {m: replace(t, u=_of_nodes(machine, nodes, u)[m]) for m, t in motions.items()}
    square = {
        n: Squareness(float(value[k] * in_tables[k]) + 0.0, float(u[k]))
        for k, n in enumerate(machine.squareness)
    }
    location = {
        n: LocationError(float(value[k] * in_tables[k]) + 0.0, float(u[k]), bool(in_tables[k]))
        for k, n in enumerate(machine.location, start=len(machine.squareness))
    }
    tables = ErrorTables(machine, motions, square, location)
    return tables, spread, tuple(hidden)


def _of_nodes(machine: Machine, nodes: Mapping[str, Array], values: Array) -> dict[str, Array]:
    """Parts of values (m,) that belong to the nodes of every motion."""
    by_motion, start = {}, len(machine.scalars)
    for motion in machine.motions:
        by_motion[str(motion)] = values[start : start + len(nodes[motion.axis])]
        start += len(nodes[motion.axis])
    return by_motion
