# SPDX-License-Identifier: Apache-2.0
"""From smooth functions to tables, in the gauge of the tables.

Node values are those of the table that is nearest to the function in the mean square over the
range and keeps the gauge at its nodes exactly. Nodes stand at the spacing of machine.yaml
(``table_pitch``), or at a whole fraction of it where the straight lines between them would cost
more than ``MAX_SHARE_OF_U`` of the uncertainty of the grid.

A displacement of the line of a rotary axis by D moves all that the axis carries by D - T D T^-1 at
the angle q: as motion (I - R(q)) t in translation and (I - R(q)) r in rotation. The line that fits
the motions best over the nodes is taken off them and added to the location errors; then the
motions are set to zero at the zero position of the axis. None of it changes the errors of the
machine by more than a rigid motion of table or target.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from otf_core.arrays import Array
from otf_core.model.chain import Sight, rotations
from otf_core.model.evaluation import (
    evenly_spread,
    free_rows,
    mean_length,
    without_rigid_motion,
)
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES, DIRECTIONS, ErrorMotion, location_names
from otf_core.model.nodes import hat_matrix, table_nodes
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.solving.joint import JointSolution
from otf_core.solving.solution import determined_by_data
from otf_core.solving.system import model_rows
from otf_core.solving.unknowns import Basis, Unknowns, linear, motion_gauge, reference_position

MAX_SHARE_OF_U = 0.3
"""Share of the mean uncertainty of the grid that straight lines between nodes may cost."""
FRACTIONS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16)
MAX_NODES = 1600
"""Nodes of all motions together: their covariance is part of the file."""
FIXED = 1e-12
"""Nodes that depend less on the unknowns are fixed by the gauge."""
PARTS_OF_INTERVAL = 32
"""Parts of an interval at which it is judged what bends between nodes."""


@dataclass(frozen=True)
class Tabulation:
    """Tables of a solution and how they were made.

    Attributes
    ----------
    tables : ErrorTables
        Without uncertainties, see ``tables.with_uncertainty``.
    rows : ndarray, shape (m, full)
        Squareness and location errors and nodes, in the order of a covariance, from the unknowns.
    fraction : int
        Nodes stand ``table_pitch / fraction`` apart.
    costs : mapping of fraction to TableCost
        What straight lines between nodes cost, for 1 (the wish) and for the fraction taken.
    bends : mapping of motion to float, m
        See ``unseen_bends``.
    hidden : tuple of str
        What the data do not show; zero in the tables.
    left_out : ndarray, shape (m,), m and rad
        What was estimated of it.
    covariance : ndarray, shape (m, m)
        Of the values of ``rows``, of what was left out and of what straight lines miss.
    """

    tables: ErrorTables
    rows: Array
    fraction: int
    costs: Mapping[int, TableCost]
    bends: Mapping[ErrorMotion, float]
    hidden: tuple[str, ...]
    left_out: Array
    covariance: Array

    @property
    def straight(self) -> Array:
        """Variance of the nodes that stands for what straight lines miss, shape (m,).

        Independent nodes of variance v make 2/3 v on the average over the places between them.
        """
        cost, tables = self.costs[self.fraction].motions, self.tables
        parts = [np.zeros(len(tables.machine.scalars))]
        for motion in tables.machine.motions:
            missed = cost[motion] ** 2 + self.bends.get(motion, 0.0) ** 2
            parts.append(np.full(len(tables.motions[motion].position), 1.5 * missed))
        return np.asarray(np.concatenate(parts) * (np.abs(self.rows).max(axis=1) > FIXED))

    def covariance_of(self, whole: Array) -> Array:
        """Covariance (m, m) of the tables for one of all unknowns, (full, full)."""
        cover = self.rows @ whole @ self.rows.T + np.diag(self.straight)
        # what is written as zero may be what was estimated, within its uncertainty
        return np.asarray(cover + np.outer(self.left_out, self.left_out))


@dataclass(frozen=True)
class TableCost:
    """What straight lines between nodes cost.

    Attributes
    ----------
    motions : mapping of motion to float, m or rad
        Root mean square over the range of function less table.
    grid : float
        m; mean length of the difference on a grid, rigid motion removed.
    """

    motions: Mapping[str, float]
    grid: float


def projection(motion: ErrorMotion, basis: Basis, nodes: Array) -> Array:
    """Node values of the best table from the coefficients, shape (nodes, size)."""
    table = basis.linear_between(nodes)
    if basis.size == 1 or (
        basis.degree == table.degree and np.array_equal(basis.knots, table.knots)
    ):
        return table.at_nodes(nodes, np.eye(basis.size))
    gauge = motion_gauge(motion, table)
    cuts = np.unique(np.concatenate([basis.knots, nodes]))
    places, weights = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(cuts)
    q = (cuts[:-1, None] + half[:, None] * (1.0 + places)).ravel()
    weight = np.sqrt((half[:, None] * weights).ravel())[:, None]
    hats = table.matrix(q) @ gauge
    best = np.linalg.lstsq(hats * weight, basis.matrix(q) * weight, rcond=None)[0]
    return table.at_nodes(nodes, gauge @ best)


def line_motions(machine: Machine, axis: str, q: Array) -> Array:
    """Displacement (n, 3, 3) that a displacement of the line of a rotary axis does as motion."""
    spec = machine.axes[axis]
    assert spec.direction is not None
    sign = -1.0 if axis in machine.chain.table_side else 1.0
    return np.asarray(sign * (np.eye(3) - rotations(sign * q, np.array(spec.direction))))


def gauge_matrix(
    machine: Machine, nodes: Mapping[str, Array], hidden: Collection[str] = ()
) -> Array:
    """Scalars and nodes (m, m) in the gauge of the tables from those in any other.

    A line is not moved where that would give a share to a motion that is ``hidden``.
    """
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
            if any(f'E{d}{axis}' in hidden for d in letters):
                continue
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
    return free_rows(rows, Sight.of_tool(machine).nominal(q))


def table_rows(
    machine: Machine,
    unknowns: Unknowns,
    nodes: Mapping[str, Array],
    hidden: Collection[str] = (),
) -> Array:
    """Squareness and location errors and nodes of all motions from the full vector, (m, full).

    ``hidden`` are motions that stay zero.
    """
    alike = {(m.axis, m.is_straightness): m for m in machine.motions}  # of one gauge
    best = {k: projection(m, unknowns.bases[m.axis], nodes[m.axis]) for k, m in alike.items()}
    blocks = [np.eye(1)] * len(machine.scalars)
    blocks += [best[m.axis, m.is_straightness] for m in machine.motions]
    order = [unknowns.blocks[n] for n in (*machine.scalars, *machine.motions)]
    rows = np.zeros((sum(len(b) for b in blocks), unknowns.full))
    rows[:, np.concatenate([np.arange(b.start, b.stop) for b in order])] = block_diag(*blocks)
    return gauge_matrix(machine, nodes, hidden) @ rows if machine.location else rows


def by_motion(
    machine: Machine, values: NDArray[Any], nodes: Mapping[str, Array]
) -> dict[str, NDArray[Any]]:
    """Node values of every motion among values (m,) in the order of ``table_rows``."""
    sizes = [len(machine.scalars)] + [len(nodes[m.axis]) for m in machine.motions]
    parts = np.split(values, np.cumsum(sizes)[:-1])[1:]
    return dict(zip(machine.motions, parts, strict=True))


def _cost(machine: Machine, joint: JointSolution, nodes: Mapping[str, Array]) -> TableCost:
    unknowns = joint.unknowns
    grid = evenly_spread(*_ends(machine, unknowns))
    seen = Sight.of_tool(machine).at(grid)
    field, motions = np.zeros_like(seen.position), dict[str, float]()
    for name in machine.motions:
        basis, at = unknowns.bases[name.axis], nodes[name.axis]
        coefficients = joint.solution.value[unknowns.blocks[name]]
        values = projection(name, basis, at) @ coefficients

        def left(q: Array, at: Array = at, basis: Basis = basis, values: Array = values,
                 coefficients: Array = coefficients) -> Array:  # fmt: skip
            return np.asarray(basis.matrix(q) @ coefficients - np.interp(q, at, values))

        fine = linear(at).finer(16)
        motions[name] = float(np.sqrt(np.mean(np.square(left(fine)))))
        if name.axis in seen.motions:
            influence = seen.motions[name.axis][:, :, DIRECTIONS.index(name.direction)]
            field += left(grid[:, machine.column(name.axis)])[:, None] * influence
    return TableCost(motions, mean_length(without_rigid_motion(field, seen.position)))


def unseen_bends(machine: Machine, joint: JointSolution) -> dict[ErrorMotion, float]:
    """What rotations that are not seen bend translations between straight nodes, rms, m.

    On the table side a rotation acts over the travel of its own axis: as a translation, which is
    not straight where the rotation is: over an interval h in which the rotation has the slope s it
    departs by s u (h - u), of which straight lines between the nodes follow a part. Slopes are
    taken to be those of the rotations that are seen.
    """
    unknowns, accepted = joint.unknowns, joint.solution.accepted
    bends: dict[ErrorMotion, float] = {}
    if any(basis.degree > 1 for basis in unknowns.bases.values()):
        return bends
    steps = {axis: np.diff(knots) for axis, knots in unknowns.knots.items()}
    turning = [
        m
        for m in machine.motions
        if not m.is_translation and m.axis in AXES and steps[m.axis].size
    ]
    values = {m: joint.solution.value[unknowns.blocks[m]] for m in turning if m in accepted}
    slopes = [np.diff(value) / steps[m.axis] for m, value in values.items()]
    slope = float(np.sqrt(np.mean(np.concatenate(slopes) ** 2))) if slopes else 0.0
    for axis in machine.axis_names:
        hidden = [m for m in turning if m.axis == axis and m not in accepted]
        if not hidden or axis not in machine.chain.lever_axes(axis):
            continue
        size = slope * _bend(unknowns.bases[axis])
        for motion in hidden:
            bent = np.cross(np.eye(3)[motion.along], np.eye(3)[motion.place])
            for other in machine.motions:
                if other.is_translation and other.axis == axis and bent[other.along]:
                    bends[other] = float(np.hypot(bends.get(other, 0.0), size))
    return bends


def _bend(basis: Basis) -> float:
    """Root mean square of what tables do not follow of a bend by independent slopes of 1, m^2."""
    q = np.concatenate([basis.finer(PARTS_OF_INTERVAL), basis.knots])
    start, end = basis.knots[:-1], basis.knots[1:]
    bends = np.maximum((q[:, None] - start) * (end - q[:, None]), 0.0)
    hats = basis.matrix(q)
    remainder = bends - hats @ np.linalg.lstsq(hats, bends, rcond=None)[0]
    return float(np.sqrt(np.sum(remainder**2) / len(q)))


def tabulate(machine: Machine, joint: JointSolution, grid_u: float, limit: float) -> Tabulation:
    """Make tables of the functions that were solved for.

    Parameters
    ----------
    grid_u : float
        m; mean uncertainty of the grid, which decides how fine the tables are.
    limit : float
        m and rad; ``unidentifiable_above``.
    """
    unknowns, accepted = joint.unknowns, joint.solution.accepted
    low, high = _ends(machine, unknowns)
    costs: dict[int, TableCost] = {}
    fraction = FRACTIONS[0]
    for tried in FRACTIONS:
        finer = table_nodes(_finer(machine, tried), low, high)
        if tried > 1 and 6 * sum(len(n) for n in finer.values()) > MAX_NODES:
            break
        fraction, nodes = tried, finer
        costs[fraction] = _cost(machine, joint, nodes)
        if costs[fraction].grid <= MAX_SHARE_OF_U * grid_u:
            break
    rows = table_rows(machine, unknowns, nodes, [m for m in machine.motions if m not in accepted])
    value = rows @ joint.solution.value
    determined = determined_by_data(joint.normal, unknowns, accepted, limit, rows)
    known, free = by_motion(machine, determined, nodes), np.abs(rows).max(axis=1) > FIXED
    loose = by_motion(machine, free, nodes)
    count = len(machine.scalars)
    shown = {
        name: name in accepted and (name in machine.squareness or bool(determined[k]))
        for k, name in enumerate(machine.scalars)
    }
    for motion in machine.motions:
        own = known[motion][loose[motion]]
        # motions of a rotary axis trade with its line and with places of targets
        seen = own.any() if machine.axes[motion.axis].rotary and own.size else True
        shown[motion] = bool(seen) and motion in accepted
    sizes = [1] * count + [len(nodes[m.axis]) for m in machine.motions]
    stated = np.repeat([shown[n] for n in (*machine.scalars, *machine.motions)], sizes)
    left_out, value = np.where(stated, 0.0, value), np.where(stated, value, 0.0) + 0.0
    split = by_motion(machine, value, nodes)
    motions: dict[str, MotionTable] = {
        m: MotionTable(
            nodes[m.axis], split[m], np.zeros(len(split[m])), shown[m], known[m] & shown[m]
        )
        for m in machine.motions
    }
    scalars = dict(zip(machine.scalars, value[:count].tolist(), strict=True))
    tables = ErrorTables(
        machine,
        motions,
        {n: ScalarError(scalars[n]) for n in machine.squareness},
        {n: ScalarError(scalars[n], 0.0, shown[n]) for n in machine.location},
    )
    return Tabulation(
        tables=tables,
        rows=rows,
        fraction=fraction,
        costs={k: costs[k] for k in {1, fraction}},
        bends=unseen_bends(machine, joint),
        hidden=tuple(str(name) for name, seen in shown.items() if not seen),
        left_out=left_out,
        covariance=np.zeros((len(rows), len(rows))),
    )


def _finer(machine: Machine, fraction: int) -> Machine:
    axes = {
        name: replace(axis, table_pitch=axis.table_pitch / fraction)
        for name, axis in machine.axes.items()
    }
    return replace(machine, axes=axes)


def mean_grid_uncertainty(machine: Machine, unknowns: Unknowns, covariance: Array) -> float:
    """Mean over the driven volume of the uncertainty of the error vector, m.

    Parameters
    ----------
    covariance : ndarray, shape (full, full)
    """
    grid = evenly_spread(*_ends(machine, unknowns))
    rows = model_rows(machine, unknowns, grid)
    free = remove_rigid_motions(machine, grid, rows.reshape(-1, rows.shape[2]))
    variance = np.maximum(np.einsum('ij,ij->i', free @ covariance, free), 0.0)
    return float(np.sqrt(variance.reshape(-1, 3).sum(axis=1)).mean())


def _ends(machine: Machine, unknowns: Unknowns) -> tuple[Array, Array]:
    own = [unknowns.knots[a] for a in machine.axis_names]
    return np.array([knots[0] for knots in own]), np.array([knots[-1] for knots in own])


USUAL_ANGLE = 2e-5
"""rad; size of rotations where none is seen at all."""


def unseen_sizes(tables: ErrorTables, accepted: Collection[str]) -> dict[str, float]:
    """Standard deviations of the rotations that are not seen, rad: like those that are."""
    turning = [m for m in tables.machine.motions if not m.is_translation]
    seen = [v for m in turning if m in accepted for v in tables.motions[m].value]
    size = float(np.sqrt(np.mean(np.square(seen)))) if seen else 0.0
    return {str(m): size or USUAL_ANGLE for m in turning if m not in accepted}
