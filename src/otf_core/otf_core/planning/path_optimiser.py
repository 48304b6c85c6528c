# SPDX-License-Identifier: Apache-2.0
"""Plans that make the grid best known in a given time, or known well enough in the least time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from otf_core.arrays import Array, Index
from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.evaluation import covered_grid, free_rows
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.nodes import table_nodes
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_core.planning.forecast import (
    DriveTimes,
    Forecast,
    Setup,
    forecast,
    lay_out,
    leg_time,
    recorded_pieces,
    tracker_pose,
)
from otf_core.planning.path_creation import inner_range
from otf_core.solving.model_choice import smooth_bases
from otf_core.solving.normal import NormalEquations, sum_groups
from otf_core.solving.roughness import expected_precision
from otf_core.solving.solution import identifiable_blocks
from otf_core.solving.system import build_system, model_rows
from otf_core.solving.unknowns import Unknowns, layout
from otf_core.solving.whitener import Whitener

# Candidate lines of a path, and what each line at each feed would tell: its normal matrix.
#
# Candidates join any two points of a small lattice: edges, face and space diagonals, lines of half
# slope. Lines are separated by standstill, so their normal matrices add up, and a path is judged
# by the sum over its legs. For this choice the splines have ``INTERVALS`` parts per axis.

INTERVALS = 10
_GRID_POINTS = 5
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

    def at_feeds(self, selected: NDArray[np.bool_]) -> CandidateLines:
        """Return the lines at some of the feeds only."""
        size = self.prior.shape[0]
        information = self.information.reshape(*self.cost.shape, size, size)[:, selected]
        return replace(
            self,
            feeds=self.feeds[selected],
            cost=self.cost[:, selected],
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
    pieces = lay_out(starts, ends, times, recorded_pieces(unknowns.knots, setup), setup)
    system = build_system(setup.machine, pieces, tracker_pose(setup), unknowns, nodal_lever=nodal)
    whitener = Whitener.of(system, pieces, setup.noise)
    group = pieces.leg[[low for low, _ in whitener.bounds]]
    sums = sum_groups(system, unknowns, whitener, group)
    return np.stack([s.matrix for s in sums]), moving


def _target(machine: Machine, points: Array, unknowns: Unknowns, use: Index) -> Array:
    """Quadratic form of the mean variance on the grid, rigid motion removed."""
    grid = covered_grid(machine, points, _GRID_POINTS)
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


# How much driving time each candidate line deserves, were lines divisible (A-optimal design).
#
# Minimise trace(target @ inv(prior + sum w_i N_i)) over w >= 0 with sum w_i cost_i = time. The
# multiplicative rule w_i <- w_i (gain_i / mean gain)^0.7 converges monotonically in practice, and
# max gain / mean gain bounds how far any plan can be better (equivalence theorem). The path that
# is driven is judged against this bound.
#
# References
# ----------
# Pukelsheim, Optimal Design of Experiments, SIAM 2006, chapters 5 and 7 (equivalence theorem).

ITERATIONS = 60
_POWER = 0.7


@dataclass(frozen=True)
class Judgement:
    """Mean variance of the grid and what every line would take off it.

    Attributes
    ----------
    variance : float
        In units of ``unidentifiable_above`` squared.
    gain : ndarray, shape (n, f)
        Decrease of the variance per unit weight of each line at each feed.
    """

    variance: float
    gain: Array


def variance(lines: CandidateLines, matrix: Array) -> float:
    """Mean variance of the grid for a sum of normal matrices."""
    factor = linalg.cho_factor(matrix + lines.prior, lower=True, check_finite=False)
    return float(np.trace(linalg.cho_solve(factor, lines.target, check_finite=False)))


def judge(lines: CandidateLines, matrix: Array) -> Judgement:
    """Mean variance of the grid and its derivative with respect to every line.

    Parameters
    ----------
    matrix : ndarray, shape (u, u)
        Sum of normal matrices.
    """
    factor = linalg.cho_factor(matrix + lines.prior, lower=True, check_finite=False)
    half = linalg.cho_solve(factor, lines.target, check_finite=False)
    gradient = linalg.cho_solve(factor, half.T, check_finite=False)
    flat = lines.information.reshape(len(lines.information), -1)
    return Judgement(float(np.trace(half)), (flat @ gradient.ravel()).reshape(lines.cost.shape))


def total(lines: CandidateLines, weight: Array) -> Array:
    """Sum of normal matrices for weights of shape (n, f)."""
    size = lines.prior.shape[0]
    flat = lines.information.reshape(len(lines.information), -1)
    return np.asarray((weight.ravel() @ flat).reshape(size, size))


def allocate(lines: CandidateLines, time: float, iterations: int = ITERATIONS) -> Array:
    """Share out driving time among lines and feeds.

    Parameters
    ----------
    time : float
        s, connections not counted: every line is a candidate, so are they.

    Returns
    -------
    ndarray, shape (n, f)
        How often each line is driven, not whole numbers.
    """
    weight = time / lines.cost / lines.cost.size
    for _ in range(iterations):
        worth = judge(lines, total(lines, weight)).gain / lines.cost
        weight = weight * np.maximum(worth / worth.max(), 1e-12) ** _POWER
        weight *= time / float(np.sum(weight * lines.cost))
    return np.asarray(weight)


# A continuous drive over lattice points that makes the grid best known in a given time.
#
# Every leg between lattice points is a measured line, connections included. The walk is built leg
# by leg: next comes the leg at the feed that takes most off the mean grid variance per second,
# judged as if the rest of the time were shared out ideally (``line_allocation``). On drives of a
# hundred legs it comes within 1 % of that ideal; exchanging corner points afterwards gained
# nothing.


@dataclass(frozen=True)
class Walk:
    """A sequence of lattice points.

    Attributes
    ----------
    corners : tuple of int
        Lattice points in driving order.
    feeds : tuple of int
        Index of the feed of every leg.
    passes : int
        How often it is driven, every second time backwards.
    time : float
        s of all passes, with one corner dwell per leg.
    variance : float
        Mean grid variance, in units of ``unidentifiable_above`` squared.
    """

    corners: tuple[int, ...]
    feeds: tuple[int, ...]
    passes: int
    time: float
    variance: float


def _pairs(lines: CandidateLines) -> NDArray[np.int64]:
    """Line that joins two points, as a matrix over the points; -1 where there is none."""
    count = len(lines.points)
    line = np.full((count, count), -1, dtype=np.int64)
    line[lines.ends[:, 0], lines.ends[:, 1]] = np.arange(len(lines.ends))
    return np.maximum(line, line.T)


def best_walk(lines: CandidateLines, ideal: Array, time: float, passes: int) -> Walk:
    """Build the walk that uses up the time.

    Parameters
    ----------
    ideal : ndarray, shape (u, u), 1/s
        Normal matrix per second of an ideal share of the time among the lines.
    time : float
        s, of all passes together.

    Returns
    -------
    Walk
        Without any leg if the time does not suffice for one.
    """
    joined = _pairs(lines)
    matrix, remaining_time = np.zeros_like(ideal), time
    corners, feeds = [int(np.argmin(lines.points.sum(axis=1)))], []
    while True:
        worth = judge(lines, matrix + max(remaining_time, 0.0) * ideal).gain / lines.cost
        worth = np.where(passes * lines.cost <= remaining_time, worth, -np.inf)
        from_here = joined[corners[-1]]
        gain = np.where(from_here >= 0, worth.max(axis=1)[from_here], -np.inf)
        target = int(np.argmax(gain))
        if not np.isfinite(gain[target]):
            break
        line = int(from_here[target])
        feed = int(np.argmax(worth[line]))
        corners.append(target)
        feeds.append(feed)
        matrix += passes * lines.information[line * len(lines.feeds) + feed]
        remaining_time -= passes * float(lines.cost[line, feed])
    return Walk(
        tuple(corners), tuple(feeds), passes, time - remaining_time, variance(lines, matrix)
    )


# Plans that make the grid best known in a given time, or known well enough in the least time.
#
# Lines, diagonals, feeds and the number of passes are chosen; the highest feed, the dwells and the
# margin are given (``PlannerConfig``). Every plan is checked by the full forecast: each error that
# lines in this volume can show is determined at every node.

FEED_STEPS = (1.0, 0.5, 0.25)
"""Feeds to choose from, as ratios to the highest."""
LAP_TIME = 900.0
"""s; longer drives repeat a lap of no more than this."""
REVERSAL_PRICE = 1.05
"""A walk driven forward and backward, which shows backlash, may be worse by this than one way."""
LONGEST_PLAN = 4 * 3600.0
"""s; no plan is longer."""
_LEVELS = 3
_SEARCHES, _CLOSE = 9, 0.97
"""Plans tried for a wanted uncertainty; forecast over wanted that is close enough."""
_NEGLIGIBLE = 0.005
"""Share of the time below which a feed is not considered further."""


@dataclass(frozen=True)
class OptimisedPlan:
    """A plan and what it was chosen for.

    Attributes
    ----------
    passes : int
        How often the walk is driven, every second time backwards.
    efficiency : float
        Mean grid variance of an ideal share of the time among the candidate lines, over that of
        this walk: 1 means that no other walk over these lines is better.
    """

    plan: Plan
    forecast: Forecast
    passes: int
    efficiency: float


class PathOptimiser:
    """Chooses paths for one machine, tracker place and noise.

    Parameters
    ----------
    config : PlannerConfig
        ``feed`` is the highest feed; dwells and margin count, the rest is chosen.

    Raises
    ------
    ConfigError
        If the margin leaves nothing of an axis.
    """

    def __init__(self, setup: Setup, config: PlannerConfig) -> None:
        self._setup, self._config = setup, config
        points = lattice_points(*inner_range(setup.machine, config), _LEVELS)
        feeds = config.feed * np.array(FEED_STEPS)
        lines = candidate_lines(setup, points, feeds, config.corner_dwell)
        share = allocate(lines, LAP_TIME) * lines.cost / LAP_TIME
        lines = lines.at_feeds(share.sum(axis=0) > _NEGLIGIBLE)
        self.lines: CandidateLines = lines
        self._ideal = total(lines, allocate(lines, LAP_TIME)) / LAP_TIME

    def _overhead(self) -> float:
        """Dwell at both ends, which the walk does not count, s."""
        return 2 * self._config.end_dwell - self._config.corner_dwell

    def _walk(self, time: float) -> Walk:
        laps = int(np.ceil(time / LAP_TIME))
        both = best_walk(self.lines, self._ideal, time, 2 * laps)
        single = best_walk(self.lines, self._ideal, time, 2 * laps - 1)
        return both if both.variance <= REVERSAL_PRICE**2 * single.variance else single

    def _plan(self, walk: Walk) -> Plan:
        points = self.lines.points[list(walk.corners)]
        feed = self.lines.feeds[list(walk.feeds)]
        laps = [points if k % 2 == 0 else points[::-1] for k in range(walk.passes)]
        feeds = [feed if k % 2 == 0 else feed[::-1] for k in range(walk.passes)]
        path = np.concatenate([laps[0]] + [lap[1:] for lap in laps[1:]])
        dwell = np.full(len(path), self._config.corner_dwell)
        dwell[[0, -1]] = self._config.end_dwell
        return Plan(NominalPath(path), np.concatenate(feeds), dwell)

    def _missing(self, forecast: Forecast) -> tuple[str, ...]:
        loose = forecast.loose_nodes
        missing = (set(self.lines.visible) & set(forecast.not_identifiable)) | set(loose)
        return tuple(n for n in self.lines.visible if n in missing)

    def _attempt(self, budget: float) -> OptimisedPlan | None:
        """Return the best plan for a time in s, or None if it does not show every error."""
        time = budget - self._overhead()
        if time <= float(self.lines.cost.min()) * 2:
            return None
        walk = self._walk(time)
        if not walk.feeds:
            return None
        plan = self._plan(walk)
        outlook = forecast(plan, self._setup)
        if self._missing(outlook):
            return None
        return OptimisedPlan(plan, outlook, walk.passes, self.ideal_variance(time) / walk.variance)

    def ideal_variance(self, time: float) -> float:
        """Mean grid variance of an ideal share of the time, as ``Walk.variance``."""
        return variance(self.lines, time * self._ideal)

    def for_time(self, budget: float) -> OptimisedPlan:
        """Plan the best drive of no more than ``budget`` s, accelerations and dwells included.

        Raises
        ------
        ConfigError
            If that is too short to show every error that can be shown; says what suffices.
        """
        if budget > LONGEST_PLAN:
            raise ConfigError(
                f'time_budget: {budget:g} s; no plan is longer than {LONGEST_PLAN:g} s'
            )
        attempt = self._attempt(budget)
        if attempt is not None:
            return attempt
        enough = max(budget, self._overhead())
        while enough < LONGEST_PLAN:
            enough *= 1.4
            if self._attempt(enough) is not None:
                raise ConfigError(
                    f'time_budget: {budget:g} s is too short to show every error motion at every '
                    f'node; {math.ceil(enough)} s suffice at this feed'
                )
        raise ConfigError(
            f'time_budget: neither {budget:g} s nor {LONGEST_PLAN:g} s suffices to show every '
            f'error motion at every node'
        )

    def for_uncertainty(self, wanted: float) -> OptimisedPlan:
        """Plan a short drive whose forecast mean grid uncertainty is at most ``wanted`` m.

        Raises
        ------
        ConfigError
            If the longest plan does not reach it; says what it reaches.
        """
        limit = self._setup.calibration.unidentifiable_above
        time = LAP_TIME * self.ideal_variance(LAP_TIME) * limit**2 / wanted**2
        short, time = 0.0, min(time + self._overhead(), LONGEST_PLAN)
        best: OptimisedPlan | None = None
        for _ in range(_SEARCHES):
            attempt = self._attempt(time)
            ratio = attempt.forecast.mean_grid_u / wanted if attempt else np.inf
            if ratio <= 1.0:
                best, long = attempt, time
                if ratio > _CLOSE:
                    break
            elif time >= LONGEST_PLAN:
                reached = f'then {1e6 * attempt.forecast.mean_grid_u:.3g} um' if attempt else ''
                raise ConfigError(
                    f'wanted_uncertainty: {1e6 * wanted:g} um needs more than {LONGEST_PLAN:g} '
                    f's at this feed; {reached}'
                )
            else:
                short = time
            if best is None:
                time = min(time * float(np.clip(1.02 * ratio**2, 1.1, 1.5)), LONGEST_PLAN)
            else:
                time = 0.5 * (short + long) if short else long * max(0.5, ratio**2)
        if best is None:
            raise ConfigError(f'wanted_uncertainty: no plan found for {1e6 * wanted:g} um')
        return best
