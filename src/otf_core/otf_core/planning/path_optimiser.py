# SPDX-License-Identifier: Apache-2.0
"""Plans that make the grid best known in a given time, or known well enough in the least time.

Lines, diagonals, feeds and the number of passes are chosen; the highest feed, the dwells and the
margin are given (``PlannerConfig``). Every plan is checked by the full forecast: each error that
lines in this volume can show is determined at every node.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_core.planning.candidate_lines import CandidateLines, candidate_lines, lattice_points
from otf_core.planning.creator import inner_range
from otf_core.planning.forecast import Forecast, Setup, forecast
from otf_core.planning.line_allocation import allocate, total, variance
from otf_core.planning.walk_search import Walk, best_walk

FEED_STEPS = (1.0, 0.5, 0.25)
"""Feeds to choose from, as ratios to the highest."""
LAP_TIME = 900.0
"""s; longer drives repeat a lap of no more than this."""
REVERSAL_PRICE = 1.05
"""A walk driven forward and backward, which shows backlash, may be worse by this than one way."""
LONGEST = 4 * 3600.0
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
    plan : Plan
    forecast : Forecast
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
    setup : Setup
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

    def _missing(self, found: Forecast) -> tuple[str, ...]:
        loose = found.loose_nodes
        missing = (set(self.lines.visible) & set(found.not_identifiable)) | set(loose)
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
        found = forecast(plan, self._setup)
        if self._missing(found):
            return None
        return OptimisedPlan(plan, found, walk.passes, self.ideal_variance(time) / walk.variance)

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
        if budget > LONGEST:
            raise ConfigError(f'time_budget: {budget:g} s; no plan is longer than {LONGEST:g} s')
        found = self._attempt(budget)
        if found is not None:
            return found
        enough = max(budget, self._overhead())
        while enough < LONGEST:
            enough *= 1.4
            if self._attempt(enough) is not None:
                raise ConfigError(
                    f'time_budget: {budget:g} s is too short to show every error motion at every '
                    f'node; {math.ceil(enough)} s suffice at this feed'
                )
        raise ConfigError(
            f'time_budget: {budget:g} s is too short, and {LONGEST:g} s would be, to show every '
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
        short, time = 0.0, min(time + self._overhead(), LONGEST)
        best: OptimisedPlan | None = None
        for _ in range(_SEARCHES):
            found = self._attempt(time)
            ratio = found.forecast.mean_grid_u / wanted if found else np.inf
            if ratio <= 1.0:
                best, long = found, time
                if ratio > _CLOSE:
                    break
            elif time >= LONGEST:
                reached = f'then {1e6 * found.forecast.mean_grid_u:.3g} um' if found else ''
                raise ConfigError(
                    f'wanted_uncertainty: {1e6 * wanted:g} um needs more than {LONGEST:g} s at '
                    f'this feed; {reached}'
                )
            else:
                short = time
            if best is None:
                time = min(time * float(np.clip(1.02 * ratio**2, 1.1, 1.5)), LONGEST)
            else:
                time = 0.5 * (short + long) if short else long * max(0.5, ratio**2)
        if best is None:
            raise ConfigError(f'wanted_uncertainty: no plan found for {1e6 * wanted:g} um')
        return best
