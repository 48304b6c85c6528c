# SPDX-License-Identifier: Apache-2.0
"""From smooth functions to tables.

Node values are those of the table that is nearest to the function in the mean square over the
range and keeps the gauge at its nodes exactly. Nodes stand at the spacing of machine.yaml
(``table_pitch``), or at a whole fraction of it where the straight lines between them would cost
more than ``MAX_SHARE_OF_U`` of the uncertainty of the grid.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from otf_core.arrays import Array
from otf_core.model.evaluation import free_rows, mean_length, without_rigid_motion
from otf_core.model.kinematics import motion_influence, turn_arms
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion
from otf_core.model.nodes import table_nodes
from otf_core.model.tables import ErrorTables, MotionTable, Squareness
from otf_core.solving.joint import JointSolution
from otf_core.solving.solution import determined_by_data
from otf_core.solving.system import model_rows
from otf_core.solving.unknowns import Basis, Unknowns, linear, motion_gauge

MAX_SHARE_OF_U = 0.3
"""Share of the mean uncertainty of the grid that straight lines between nodes may cost."""
FRACTIONS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16)
MAX_NODES = 1600
"""Nodes of all motions together: their covariance is part of the file."""
FIXED = 1e-12
"""Nodes that depend less on the unknowns are fixed by the gauge."""
PARTS_OF_INTERVAL = 32
"""Parts of an interval at which it is judged what bends between nodes."""
GRID_PLACES = 216
"""At which the cost on the grid is judged."""


@dataclass(frozen=True)
class Tabulation:
    """Tables of a solution and how they were made.

    Attributes
    ----------
    tables : ErrorTables
        Values; uncertainties are not filled in.
    rows : ndarray, shape (m, full)
        C0Y, B0Z, A0Z and the nodes of EXX ... ECZ from the full vector of unknowns.
    fraction : int
        Nodes stand ``table_pitch / fraction`` apart.
    costs : mapping of fraction to TableCost
        What straight lines between nodes cost, for 1 (the wish) and for the fraction taken.
    bends : mapping of motion to float, m
        See ``unseen_bends``.
    """

    tables: ErrorTables
    rows: Array
    fraction: int
    costs: Mapping[int, TableCost]
    bends: Mapping[ErrorMotion, float]

    @property
    def straight(self) -> Array:
        """Variance of the nodes that stands for what straight lines miss, shape (m,).

        Independent nodes of variance v make 2/3 v on the average over the places between them.
        """
        cost, motions = self.costs[self.fraction].motions, self.tables.motions
        missed = {m: cost[m] ** 2 + self.bends.get(m, 0.0) ** 2 for m in MOTIONS}
        parts = [np.zeros(len(SQUARENESS))]
        parts += [np.full(len(motions[m].position), 1.5 * missed[m]) for m in MOTIONS]
        free = np.abs(self.rows).max(axis=1) > FIXED
        return np.asarray(np.concatenate(parts) * free)


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


def table_rows(unknowns: Unknowns, nodes: Mapping[str, Array]) -> Array:
    """C0Y, B0Z, A0Z and node values of EXX ... ECZ from the full vector, shape (m, full)."""
    alike = {(m.axis, m.is_straightness): m for m in MOTIONS}  # of one gauge
    best = {k: projection(m, unknowns.bases[m.axis], nodes[m.axis]) for k, m in alike.items()}
    blocks = [np.eye(1)] * len(SQUARENESS) + [best[m.axis, m.is_straightness] for m in MOTIONS]
    order = [unknowns.blocks[n] for n in (*SQUARENESS, *MOTIONS)]
    rows = np.zeros((sum(len(b) for b in blocks), unknowns.full))
    rows[:, np.concatenate([np.arange(b.start, b.stop) for b in order])] = block_diag(*blocks)
    return rows


def by_motion(values: NDArray[Any], nodes: Mapping[str, Array]) -> dict[str, NDArray[Any]]:
    """Node values of every motion among values (m,) in the order of ``table_rows``."""
    ends = np.cumsum([len(SQUARENESS)] + [len(nodes[m.axis]) for m in MOTIONS])
    return dict(zip(MOTIONS, np.split(values, ends[:-1])[1:], strict=True))


def _cost(
    machine: Machine, joint: JointSolution, nodes: Mapping[str, Array], values: Mapping[str, Array]
) -> TableCost:
    unknowns = joint.unknowns
    grid = _inner_places(*_ends(machine, unknowns))
    field = np.zeros_like(grid)
    motions: dict[str, float] = {}
    for name in MOTIONS:
        basis, at = unknowns.bases[name.axis], nodes[name.axis]
        coefficients = joint.solution.value[unknowns.blocks[name]]

        def left(q: Array, name: str = name, at: Array = at, basis: Basis = basis,
                 coefficients: Array = coefficients) -> Array:  # fmt: skip
            return np.asarray(basis.matrix(q) @ coefficients - np.interp(q, at, values[name]))

        fine = linear(at).finer(16)
        motions[name] = float(np.sqrt(np.mean(np.square(left(fine)))))
        own = left(grid[:, name.place])
        field += own[:, None] * motion_influence(machine, name, grid)
    return TableCost(motions, mean_length(without_rigid_motion(field, grid)))


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
    rotations = [m for m in MOTIONS if not m.is_translation and steps[m.axis].size]
    values = {m: joint.solution.value[unknowns.blocks[m]] for m in rotations if m in accepted}
    slopes = [np.diff(value) / steps[m.axis] for m, value in values.items()]
    slope = float(np.sqrt(np.mean(np.concatenate(slopes) ** 2))) if slopes else 0.0
    for axis in machine.axis_names:
        hidden = [m for m in rotations if m.axis == axis and m not in accepted]
        if not hidden or axis not in machine.chain.lever_axes(axis):
            continue
        size = slope * _bend(unknowns.bases[axis])
        for motion in hidden:
            bent = turn_arms(motion.along, np.eye(3)[[motion.place]])[0]
            for other in MOTIONS:
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


def _inner_places(low: Array, high: Array) -> Array:
    """Places that fill the volume evenly and keep no step with nodes, shape (n, 3), m.

    Multiples of the powers of the root of g^4 = g + 1, the remainders by 1 (additive recurrence).
    """
    steps = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    share = (0.5 + np.arange(GRID_PLACES)[:, None] * steps) % 1.0
    return np.asarray(low + share * (high - low))


def tabulate(machine: Machine, joint: JointSolution, grid_u: float, limit: float) -> Tabulation:
    """Make tables of the functions that were solved for.

    Parameters
    ----------
    grid_u : float
        m; mean uncertainty of the grid, which decides how fine the tables are.
    limit : float
        m and rad; ``unidentifiable_above``.
    """
    low, high = _ends(machine, joint.unknowns)
    costs: dict[int, TableCost] = {}
    best = None
    for fraction in FRACTIONS:
        nodes = table_nodes(_finer(machine, fraction), low, high)
        if fraction > 1 and 6 * sum(len(n) for n in nodes.values()) > MAX_NODES:
            break
        rows = table_rows(joint.unknowns, nodes)
        value = rows @ joint.solution.value
        split = by_motion(value, nodes)
        costs[fraction] = _cost(machine, joint, nodes, split)
        best = (fraction, nodes, rows, value, split)
        if costs[fraction].grid <= MAX_SHARE_OF_U * grid_u:
            break
    assert best is not None
    fraction, nodes, rows, value, split = best
    accepted = joint.solution.accepted
    known = by_motion(
        determined_by_data(joint.normal, joint.unknowns, accepted, limit, rows), nodes
    )
    motions: dict[str, MotionTable] = {
        m: MotionTable(
            nodes[m.axis],
            split[m] + 0.0,
            np.zeros(len(split[m])),
            m in accepted,
            known[m] if m in accepted else np.zeros(len(split[m]), dtype=bool),
        )
        for m in MOTIONS
    }
    squareness = {n: Squareness(float(value[k])) for k, n in enumerate(SQUARENESS)}
    two_costs = {k: costs[k] for k in {1, fraction}}
    tables, bends = ErrorTables(machine, motions, squareness), unseen_bends(machine, joint)
    return Tabulation(tables, rows, fraction, two_costs, bends)


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
    grid = _inner_places(*_ends(machine, unknowns))
    rows = model_rows(machine, unknowns, grid)
    free = free_rows(rows.reshape(-1, rows.shape[2]), grid)
    variance = np.maximum(np.einsum('ij,ij->i', free @ covariance, free), 0.0)
    return float(np.sqrt(variance.reshape(-1, 3).sum(axis=1)).mean())


def _ends(machine: Machine, unknowns: Unknowns) -> tuple[Array, Array]:
    own = [unknowns.knots[a] for a in machine.axis_names]
    return np.array([knots[0] for knots in own]), np.array([knots[-1] for knots in own])


USUAL_ANGLE = 2e-5
"""rad; size of rotations where none is seen at all."""


def unseen_sizes(tables: ErrorTables, accepted: Collection[str]) -> dict[str, float]:
    """Standard deviations of the rotations that are not seen, rad: like those that are."""
    rotations = [m for m in MOTIONS if not m.is_translation]
    seen = [v for m in rotations if m in accepted for v in tables.motions[m].value]
    size = float(np.sqrt(np.mean(np.square(seen)))) if seen else 0.0
    return {str(m): size or USUAL_ANGLE for m in rotations if m not in accepted}
