# SPDX-License-Identifier: Apache-2.0
"""Candidate lines of a path, and what each line at each feed would tell: its normal matrix.

Candidates join any two points of a small lattice: edges, face and space diagonals, lines of half
slope. Lines are separated by standstill, so their normal matrices add up, and a path is judged by
the sum over its legs. For this choice the splines have ``INTERVALS`` parts per axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.model.evaluation import covered_grid, free_rows
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.nodes import table_nodes
from otf_core.planning.drive_time import DriveTimes, leg_time
from otf_core.planning.forecast import Setup, as_recorded, lay_out, tracker_pose
from otf_core.solving.normal import NormalEquations, sum_groups
from otf_core.solving.roughness import expected_precision
from otf_core.solving.shape_choice import smooth_bases
from otf_core.solving.solution import identifiable_blocks
from otf_core.solving.system import build_system, model_rows
from otf_core.solving.unknowns import Unknowns, layout
from otf_core.solving.whitener import Whitener

INTERVALS = 10
_JUDGED = 5
_BATCH = 40


@dataclass(frozen=True)
class CandidateLines:
    """Lines with their normal matrices, in units of ``unidentifiable_above``.

    Attributes
    ----------
    points : ndarray, shape (k, 3), m
        Lattice points.
    ends : ndarray of int64, shape (n, 2)
        Lattice points that each line joins.
    feeds : ndarray, shape (f,), m/s
    cost : ndarray, shape (n, f), s
        Driving time with acceleration, and one corner dwell.
    information : ndarray, shape (n * f, u, u)
        Normal matrix of line i at feed j in row i * f + j.
    prior : ndarray, shape (u, u)
        What is expected of the motions.
    target : ndarray, shape (u, u)
        trace(target @ covariance) is the mean variance of the grid, in the same units.
    visible : tuple of str
        Squareness errors and motions that all lines together can show.
    """

    points: Array
    ends: Index
    feeds: Array
    cost: Array
    information: Array
    prior: Array
    target: Array
    visible: tuple[str, ...]

    def at_feeds(self, kept: NDArray[np.bool_]) -> CandidateLines:
        """Return the lines at some of the feeds only."""
        size = self.prior.shape[0]
        information = self.information.reshape(*self.cost.shape, size, size)[:, kept]
        return replace(
            self,
            feeds=self.feeds[kept],
            cost=self.cost[:, kept],
            information=np.ascontiguousarray(information.reshape(-1, size, size)),
        )


def lattice_points(low: Array, high: Array, levels: int) -> Array:
    """Points of a regular lattice between two corners, shape (levels**3, 3), m."""
    grids = np.meshgrid(*(np.linspace(a, b, levels) for a, b in zip(low, high, strict=True)))
    return np.stack([g.ravel() for g in grids], axis=1)


def _line_matrices(
    setup: Setup, unknowns: Unknowns, starts: Array, ends: Array, feed: float, nodal: bool
) -> tuple[Array, Array]:
    """Normal matrices of lines at one feed, shape (n, free, free), and driving times, s."""
    length = np.linalg.norm(ends - starts, axis=1)
    peak, moving = leg_time(length, np.full(len(length), feed), setup.config.acceleration)
    # far apart in time: each line is driven on its own
    begin = np.arange(len(length)) * (moving.max() + 100.0)
    times = DriveTimes(length, peak, moving, begin, setup.config.acceleration, 0.0)
    pieces = lay_out(starts, ends, times, as_recorded(unknowns.knots, setup), setup)
    system = build_system(setup.machine, pieces, tracker_pose(setup), unknowns, nodal_lever=nodal)
    whitener = Whitener.of(system, pieces, setup.noise)
    group = pieces.leg[[low for low, _ in whitener.bounds]]
    sums = sum_groups(system, unknowns, whitener, group)
    return np.stack([s.matrix for s in sums]), moving


def _target(machine: Machine, points: Array, unknowns: Unknowns, use: Index) -> Array:
    """Quadratic form of the mean variance on the grid, rigid motion taken out."""
    grid = covered_grid(machine, points, _JUDGED)
    rows = model_rows(machine, unknowns, grid)
    flat = free_rows(rows.reshape(-1, rows.shape[2]), grid)
    free = (flat @ unknowns.gauge)[:, use]
    return np.asarray(free.T @ free / len(grid))


def candidate_lines(
    setup: Setup, points: Array, feeds: Array, corner_dwell: float
) -> CandidateLines:
    """Set up all lines between lattice points.

    Parameters
    ----------
    setup : Setup
    points : ndarray, shape (k, 3), m
    feeds : ndarray, shape (f,), m/s
    corner_dwell : float
        s.

    Returns
    -------
    CandidateLines
        Only of the errors that all lines together can show.
    """
    machine, limit = setup.machine, setup.calibration.unidentifiable_above
    nodes = table_nodes(machine, points.min(axis=0), points.max(axis=0))
    unknowns = layout(smooth_bases(nodes, INTERVALS))
    ends = np.array(list(combinations(range(len(points)), 2)))
    starts_m, ends_m = points[ends[:, 0]], points[ends[:, 1]]
    accepted = _visible(setup, unknowns, starts_m, ends_m, float(feeds[0]))
    blocks = [unknowns.free_blocks[n] for n in accepted]
    use = np.concatenate([np.arange(b.start, b.stop) for b in blocks])
    prior = expected_precision(unknowns, limit, setup.config.error_size)
    information = np.empty(
        (len(ends), len(feeds), use.size, use.size),
    )
    cost = np.empty((len(ends), len(feeds)))
    for low in range(0, len(ends), _BATCH):
        part = slice(low, low + _BATCH)
        for j, feed in enumerate(feeds):
            matrices, moving = _line_matrices(
                setup, unknowns, starts_m[part], ends_m[part], float(feed), False
            )
            information[part, j] = matrices[:, use[:, None], use] * limit**2
            cost[part, j] = moving + corner_dwell
    return CandidateLines(
        points,
        ends,
        feeds,
        cost,
        information.reshape(-1, use.size, use.size),
        limit**2 * prior[np.ix_(use, use)],
        _target(machine, points, unknowns, use),
        tuple(n for n in accepted if n in SQUARENESS or n in MOTIONS),
    )


def _visible(
    setup: Setup, unknowns: Unknowns, starts: Array, ends: Array, feed: float
) -> tuple[str, ...]:
    """Blocks of unknowns that all lines together can show."""
    total = np.zeros((unknowns.free, unknowns.free))
    for low in range(0, len(starts), _BATCH):
        part = slice(low, low + _BATCH)
        matrices, _ = _line_matrices(setup, unknowns, starts[part], ends[part], feed, True)
        total += matrices.sum(axis=0)
    normal = NormalEquations(total, np.zeros(unknowns.free), 0.0, 0)
    return identifiable_blocks(normal, unknowns, setup.calibration.unidentifiable_above)
