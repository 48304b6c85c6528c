# SPDX-License-Identifier: Apache-2.0
"""Plans that make the grid best known in a given time, or known well enough in the least time.

With rotary axes chains are chosen (``part_choice``). Without, a walk over the points of a small
lattice: every leg between two of them, connections included, is a measured line. Lines are
separated by standstill, so their normal matrices add up. How much driving time each line at each
feed deserves, were lines divisible, is the A-optimal design: minimise
trace(T inv(P + sum w_i N_i)) over w >= 0 with sum w_i cost_i = time, by
w_i <- w_i (gain_i / mean gain)^0.7. The walk is built leg by leg: next comes the leg at the feed
that takes most off the mean grid variance per second, judged as if the rest of the time were
shared out ideally. On drives of a hundred legs it comes within 1 % of that ideal. Every plan is
checked by the full forecast: each error that lines in this volume can show is determined at every
node.

References
----------
Pukelsheim, Optimal Design of Experiments, SIAM 2006, chapters 5 and 7 (equivalence theorem).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from scipy import linalg

from otf_core.arrays import Array, Index
from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.axis_path import AxisPath
from otf_core.model.plan import Part, Plan
from otf_core.planning.forecast import Forecast, Judge, Setup, forecast
from otf_core.planning.part_choice import choose_parts
from otf_core.planning.path_creation import inner_range, plan_path
from otf_core.solving.solution import free_columns

COARSE = 10
"""Intervals of the splines where lines are chosen."""
ITERATIONS, POWER = 60, 0.7
LEVELS, GRID = 3, 5
"""Points per axis of the lattice, and of the grid that is judged."""
FEED_STEPS = (1.0, 0.5, 0.25)
"""Feeds to choose from, as ratios to the highest."""
LAP_TIME = 900.0
"""s; longer drives repeat a lap of no more than this."""
REVERSAL_PRICE = 1.05
"""A walk driven forward and backward, which shows backlash, may be worse by this than one way."""
LONGEST_PLAN = 4 * 3600.0
"""s; no plan is longer."""
SEARCHES, CLOSE = 9, 0.97
"""Plans tried for a wanted uncertainty; forecast over wanted that is close enough."""
NEGLIGIBLE = 0.005
"""Share of the time below which a feed is not considered further."""


@dataclass(frozen=True)
class OptimisedPlan:
    """A plan, what it will show, and in words how it was chosen."""

    plan: Plan
    forecast: Forecast
    how: str


@dataclass(frozen=True)
class Walk:
    """A sequence of lattice points.

    Attributes
    ----------
    corners, feeds : list of int
        Lattice points in driving order, and the number of the feed of every leg.
    passes : int
        How often it is driven, every second time backwards.
    variance : float
        Mean variance of the grid, in units of ``unidentifiable_above`` squared.
    """

    corners: list[int]
    feeds: list[int]
    passes: int
    variance: float


class Walks:
    """Walks over lines between lattice points, for a machine without rotary axes.

    Attributes
    ----------
    points : ndarray, shape (p, k), m
        Lattice points.
    ends : ndarray of int64, shape (n, 2)
        Lattice points that each line joins.
    feeds : ndarray, shape (f,), m/s
    cost : ndarray, shape (n, f), s
        Driving time with acceleration, and one corner dwell.
    information : ndarray, shape (n f, u, u)
        Normal matrix of line i at feed j in row i f + j, in units of ``unidentifiable_above``, of
        the errors that lines in this volume can show.
    """

    def __init__(self, setup: Setup, config: PlannerConfig) -> None:
        """Set up all lines.

        Raises
        ------
        ConfigError
            If the margin leaves nothing of an axis.
        """
        self._setup, self._config, machine = setup, config, setup.machine
        low, high = inner_range(machine, machine.axis_names, config.margin)
        self.points = low + np.array(list(product(np.linspace(0, 1, LEVELS), repeat=len(low)))) * (
            high - low
        )
        self.ends: Index = np.array(list(combinations(range(len(self.points)), 2)))
        self.feeds = config.feed * np.array(FEED_STEPS)
        lap = plan_path(machine, replace(config, passes=1, levels=LEVELS)).parts[0]
        judge = Judge(setup, [lap], COARSE)
        accepted = judge.visible(lap)
        self.visible = tuple(str(n) for n in accepted if str(n) in judge.names)
        use = free_columns(judge.unknowns, accepted)
        place, unit = np.ix_(use, use), setup.limit**2
        lines = [self._line(i, f) for i in range(len(self.ends)) for f in self.feeds]
        shape = len(self.ends), len(self.feeds)
        self.cost = np.array([setup.seconds(line) for line in lines]).reshape(shape)
        self.information = np.stack([unit * n.matrix[place] for n in judge.equations(lines)])
        self._prior = unit * judge.prior[place]
        field = judge.field(GRID)[:, use]
        self._target = field.T @ field / (len(field) / 3)
        share = (self.allocate(LAP_TIME) * self.cost).sum(axis=0) / LAP_TIME
        worth = share > NEGLIGIBLE
        self.feeds, self.cost = self.feeds[worth], self.cost[:, worth]
        self.information = self.information[np.tile(worth, len(self.ends))]
        self._ideal = self.total(self.allocate(LAP_TIME)) / LAP_TIME

    def _line(self, number: int, feed: float) -> Part:
        path = AxisPath(self._setup.machine.axis_names, self.points[self.ends[number]])
        return Part(path, np.array([feed]), np.array([0.0, self._config.corner_dwell]))

    def judge(self, matrix: Array) -> tuple[float, Array]:
        """Mean variance of the grid for a sum of normal matrices, and what a line takes off it.

        Returns
        -------
        variance : float
        gain : ndarray, shape (n, f)
            Decrease of the variance per unit weight of each line at each feed.
        """
        factor = linalg.cho_factor(matrix + self._prior, lower=True, check_finite=False)
        half = linalg.cho_solve(factor, self._target, check_finite=False)
        gradient = linalg.cho_solve(factor, half.T, check_finite=False)
        flat = self.information.reshape(len(self.information), -1)
        return float(np.trace(half)), (flat @ gradient.ravel()).reshape(self.cost.shape)

    def total(self, weight: Array) -> Array:
        """Sum of normal matrices for weights of shape (n, f)."""
        return np.asarray(np.tensordot(weight.ravel(), self.information, 1))

    def allocate(self, time: float) -> Array:
        """Share out driving time, s, among lines and feeds: how often each is driven, (n, f)."""
        weight = time / self.cost / self.cost.size
        for _ in range(ITERATIONS):
            worth = self.judge(self.total(weight))[1] / self.cost
            weight = weight * np.maximum(worth / worth.max(), 1e-12) ** POWER
            weight *= time / float(np.sum(weight * self.cost))
        return np.asarray(weight)

    def ideal_variance(self, time: float) -> float:
        """Mean grid variance of an ideal share of the time, s, as ``Walk.variance``."""
        return self.judge(time * self._ideal)[0]

    def walk(self, time: float, passes: int) -> Walk:
        """Build the walk that uses up the time, s, of all passes together.

        Without any leg if the time does not suffice for one.
        """
        joined = np.full((len(self.points),) * 2, -1, dtype=np.int64)
        joined[self.ends[:, 0], self.ends[:, 1]] = np.arange(len(self.ends))
        joined = np.maximum(joined, joined.T)
        matrix, left = np.zeros_like(self._ideal), time
        corners, feeds = [int(np.argmin(self.points.sum(axis=1)))], list[int]()
        while True:
            worth = self.judge(matrix + max(left, 0.0) * self._ideal)[1] / self.cost
            worth = np.where(passes * self.cost <= left, worth, -np.inf)
            from_here = joined[corners[-1]]
            gain = np.where(from_here >= 0, worth.max(axis=1)[from_here], -np.inf)
            target = int(np.argmax(gain))
            if not np.isfinite(gain[target]):
                return Walk(corners, feeds, passes, self.judge(matrix)[0])
            line = int(from_here[target])
            feed = int(np.argmax(worth[line]))
            corners.append(target)
            feeds.append(feed)
            matrix += passes * self.information[line * len(self.feeds) + feed]
            left -= passes * float(self.cost[line, feed])

    def plan(self, walk: Walk) -> Plan:
        """Corners, feeds and dwells of a walk."""
        q, feed = self.points[walk.corners], self.feeds[walk.feeds]
        laps = [q if k % 2 == 0 else q[::-1] for k in range(walk.passes)]
        feeds = [feed if k % 2 == 0 else feed[::-1] for k in range(walk.passes)]
        corners = np.concatenate([laps[0], *(lap[1:] for lap in laps[1:])])
        dwell = np.full(len(corners), self._config.corner_dwell)
        dwell[[0, -1]] = self._config.end_dwell
        path = AxisPath(self._setup.machine.axis_names, corners)
        return Plan((Part(path, np.concatenate(feeds), dwell),))

    def attempt(self, budget: float) -> OptimisedPlan | None:
        """Return the best plan for a time in s, or None if it does not show every error."""
        time = budget - (2 * self._config.end_dwell - self._config.corner_dwell)
        if time <= float(self.cost.min()) * 2:
            return None
        laps = int(np.ceil(time / LAP_TIME))
        walk, single = self.walk(time, 2 * laps), self.walk(time, 2 * laps - 1)
        if walk.variance > REVERSAL_PRICE**2 * single.variance:
            walk = single
        if not walk.feeds:
            return None
        plan = self.plan(walk)
        outlook = forecast(plan, self._setup)
        if set(self.visible) & {*outlook.not_identifiable, *outlook.loose_nodes}:
            return None
        many = f'{walk.passes} passes, every second one reversed'
        worth = 100 * self.ideal_variance(time) / walk.variance
        how = (
            f'{many if walk.passes > 1 else "driven once"}; {worth:.0f} % of the information of '
            f'an ideal allocation of time to lines'
        )
        return OptimisedPlan(plan, outlook, how)

    def guess(self, wanted: float) -> float:
        """Time, s, in which a mean grid uncertainty, m, may be reached."""
        return LAP_TIME * self.ideal_variance(LAP_TIME) * (self._setup.limit / wanted) ** 2


class ChosenParts:
    """Parts chosen from the chains that show the errors of rotary axes."""

    def __init__(self, setup: Setup, config: PlannerConfig) -> None:
        self._setup, self._config = setup, config

    def attempt(self, budget: float) -> OptimisedPlan | None:
        """Return the best plan for a time in s, moves by hand included; None if none fits."""
        try:
            plan = Plan(choose_parts(self._setup, self._config, budget))
        except ConfigError:
            return None
        return OptimisedPlan(plan, forecast(plan, self._setup), f'{len(plan.parts)} parts')

    def guess(self, wanted: float) -> float:
        """Time, s, to begin with."""
        return 2.0 * LAP_TIME


def options_of(setup: Setup, config: PlannerConfig) -> Walks | ChosenParts:
    """What plans can be chosen from.

    Parameters
    ----------
    config : PlannerConfig
        ``feed`` is the highest feed; dwells and margin count, the rest is chosen.
    """
    return ChosenParts(setup, config) if setup.machine.rotary_names else Walks(setup, config)


Attempt = Callable[[float], OptimisedPlan | None]


def plan_for_time(attempt: Attempt, budget: float) -> OptimisedPlan:
    """Plan the best drive of no more than ``budget`` s, accelerations and dwells included.

    Raises
    ------
    ConfigError
        If that is too short to show every error that can be shown; says what suffices.
    """
    if budget > LONGEST_PLAN:
        raise ConfigError(f'time_budget: {budget:g} s; no plan is longer than {LONGEST_PLAN:g} s')
    best = attempt(budget)
    if best is not None:
        return best
    enough = max(budget, 10.0)
    while enough < LONGEST_PLAN:
        enough *= 1.4
        if attempt(enough) is not None:
            raise ConfigError(
                f'time_budget: {budget:g} s is too short to show every error motion at every '
                f'node; {math.ceil(enough)} s suffice at this feed'
            )
    raise ConfigError(
        f'time_budget: neither {budget:g} s nor {LONGEST_PLAN:g} s suffices to show every '
        f'error motion at every node'
    )


def plan_for_uncertainty(attempt: Attempt, wanted: float, guess: float) -> OptimisedPlan:
    """Plan a short drive whose forecast mean grid uncertainty is at most ``wanted`` m.

    Parameters
    ----------
    guess : float
        s to begin with.

    Raises
    ------
    ConfigError
        If the longest plan does not reach it; says what it reaches.
    """
    short, time = 0.0, min(guess, LONGEST_PLAN)
    best: OptimisedPlan | None = None
    for _ in range(SEARCHES):
        tried = attempt(time)
        ratio = tried.forecast.mean_grid_u / wanted if tried else np.inf
        if ratio <= 1.0:
            best, long = tried, time
            if ratio > CLOSE:
                break
        elif time >= LONGEST_PLAN:
            reached = f'then {1e6 * tried.forecast.mean_grid_u:.3g} um' if tried else ''
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
