# SPDX-License-Identifier: Apache-2.0
"""Bend between nodes: how far smooth errors are off tables that are linear between nodes.

If the truth is smooth, it bends between the nodes as a cubic spline through them does; the bend,
spline less straight line, is known once the tables are. One factor kappa on the bends of all
motions (0: straight between nodes, 1: smooth) is estimated from the residuals. They are
independent of the estimated tables, so under straight truth kappa / u(kappa) is standard normal
whatever noise the tables hold. Only beyond 4 is anything added: rotations that the data do not see
bend the product with their own lever, and that may pass for a small kappa.

Least squares tables of a smooth curve of curvature f'' are off by h^2 f'' / 12 at the nodes and by
half of that, the other way, between them (h: spacing): over all places the root mean square is
0.45 of that at the nodes. Node errors of the size that the bend causes (its sensitivity, as for
systematic contributions) with a correlation of -1/2 between neighbours are half as uncertain in
the middle, and 0.71 in root mean square. The sizes are taken 0.8 times: an error of known size is
within 2 u all the same, at nodes too, and between them u is less too large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from otf_core.budget.columns import across, projected, weighted
from otf_core.joint import JointSolution
from otf_core.kinematics import motion_influence
from otf_core.machine import AXES
from otf_core.runs import Run
from otf_core.tables import MOTIONS, ErrorTables, MotionTable

Array = NDArray[np.float64]

SIGNIFICANT = 4.0
"""kappa over its standard uncertainty."""
SIZE = 0.8
"""Standard uncertainty at the nodes over the error that the bend causes there."""
FINE = 16
"""Points per interval for integrals over the bend."""


@dataclass(frozen=True)
class Bend:
    """Bend between nodes.

    Attributes
    ----------
    factor, u : float
        kappa and its standard uncertainty.
    covariance : ndarray, shape (full, full)
        What it adds; zero if kappa is not significant.
    residuals : tuple of ndarray, each of shape (c, p), m
        Residuals of the runs less the bend; as they were if kappa is not significant.
    """

    factor: float
    u: float
    covariance: Array
    residuals: tuple[Array, ...]

    @property
    def significant(self) -> bool:
        """Tell whether the truth bends between the nodes."""
        return self.factor > SIGNIFICANT * self.u

    @property
    def dof(self) -> float:
        """Degrees of freedom of the squared size (GUM G.4.2)."""
        return max(1.0, 0.5 * (self.factor / self.u) ** 2) if self.significant else np.inf


def bend_of(table: MotionTable, q: Array) -> Array:
    """Cubic spline less straight line between nodes, at axis positions q (n,).

    The spline runs through the nodes that a smooth truth would have: those of the table less
    their own error, t = (1 + P) t_true with P from ``node_operator``.
    """
    value = np.linalg.solve(np.eye(len(table.value)) + node_operator(table.position), table.value)
    spline = CubicSpline(table.position, value)
    inside = np.clip(q, table.position[0], table.position[-1])
    return np.asarray(spline(inside) - np.interp(inside, table.position, value))


def _bending(tables: ErrorTables) -> list[str]:
    return [
        m for m in MOTIONS
        if tables.motions[m].identifiable and len(tables.motions[m].position) > 2
    ]  # fmt: skip


def _columns(run: Run, q: Array, names: Sequence[str], tables: ErrorTables) -> Array:
    """Displacement by the bend of every motion, shape (p, 3, motions), m."""
    return np.stack(
        [
            motion_influence(run.machine, m, q)
            * bend_of(tables.motions[m], q[:, AXES.index(m[2])])[:, None]
            for m in names
        ],
        axis=2,
    )


def node_operator(nodes: Array) -> Array:
    """Node errors of the least-squares table of a spline, per node value, shape (k, k)."""
    fine = np.linspace(0.0, 1.0, 2 * FINE + 1)[1::2]
    q = np.concatenate([a + fine * (b - a) for a, b in pairwise(nodes)])
    weight = np.sqrt(np.repeat(np.diff(nodes), FINE))[:, None]
    hat = np.stack([np.interp(q, nodes, e) for e in np.eye(len(nodes))], axis=1)
    bend = CubicSpline(nodes, np.eye(len(nodes)))(q) - hat
    return np.asarray(np.linalg.lstsq(hat * weight, bend * weight, rcond=None)[0])


def _signal_share(table: MotionTable, covariance: Array) -> float:
    """Share of the squared bend that is not noise of the nodes."""
    direct = node_operator(table.position)
    operator = np.asarray(np.linalg.solve(np.eye(len(direct)) + direct, direct), dtype=float)
    total = float(np.sum((operator @ table.value) ** 2))
    noise = float(np.trace(operator @ covariance @ operator.T))
    return max(0.0, 1.0 - noise / max(total, 1e-300))


def estimate_bend(
    runs: Sequence[Run], done: JointSolution, tables: ErrorTables, inflation: float
) -> Bend:
    """Estimate kappa and what it adds to the covariance.

    Parameters
    ----------
    runs : sequence of Run
    done : JointSolution
    tables : ErrorTables
        As solved.
    inflation : float
        Factor on the covariance that the residuals call for.
    """
    size, names = done.unknowns.full, _bending(tables)
    plain = tuple(s.residual for s in done.runs)
    nothing = Bend(0.0, np.inf, np.zeros((size, size)), plain)
    if not names:
        return nothing
    columns = [
        across(s, _columns(r, s.system.q, names, tables))
        for r, s in zip(runs, done.runs, strict=True)
    ]
    right = projected(done, columns)
    change = np.asarray(done.solution.covariance @ right)
    whole = [np.sum(part, axis=2, keepdims=True) for part in columns]
    pairs = [(t, weighted(s, t), s.residual) for s, t in zip(done.runs, whole, strict=True)]
    own = sum(float(np.sum(w * t)) for t, w, _ in pairs)
    left = own - float(right.sum(axis=1) @ change.sum(axis=1))
    if left <= 1e-9 * own:
        return nothing
    factor = sum(float(np.sum(w[:, :, 0] * e)) for _, w, e in pairs) / left
    bend = replace(nothing, factor=factor, u=float(np.sqrt(inflation / left)))
    if not bend.significant:
        return bend
    moved = change.sum(axis=1)
    rest = tuple(
        e - factor * (t[:, :, 0] - (s.system.design @ moved).reshape(e.shape))
        for s, (t, _, e) in zip(done.runs, pairs, strict=True)
    )
    return replace(
        bend, covariance=_covariance(change, names, done, tables, factor), residuals=rest
    )


def _covariance(
    change: Array, names: Sequence[str], done: JointSolution, tables: ErrorTables, factor: float
) -> Array:
    shares, sizes = [], np.sum(change**2, axis=0)
    for name in names:
        block = done.unknowns.blocks[name]
        shares.append(_signal_share(tables.motions[name], done.solution.covariance[block, block]))
    share = np.array(shares)
    # noise in the nodes makes the bend too large and kappa too small by the same share
    level = min(1.0, factor / max(float(share @ sizes / sizes.sum()), 1e-3))
    total = np.zeros((len(change),) * 2)
    for k, name in enumerate(names):
        block = done.unknowns.blocks[name]
        moved = level * np.sqrt(share[k]) * change[:, k]
        size = SIZE * np.abs(moved[block])
        neighbours = np.eye(len(size)) - 0.5 * (np.eye(len(size), k=1) + np.eye(len(size), k=-1))
        moved[block] = 0.0
        total += np.outer(moved, moved)
        total[block, block] += neighbours * np.outer(size, size)
    return total
