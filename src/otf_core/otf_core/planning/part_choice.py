# SPDX-License-Identifier: Apache-2.0
"""The chains that show the errors of rotary axes within a time.

From all chains those are taken out, some at a time, whose loss costs least per second,

    cost = (S without it - S) / seconds,    S = sum over all errors of log(mean variance) + h,

until the time is kept; then those that still fit are put back. h is ``UNSEEN`` where the variance
is hardly less than before any measurement, so a chain that alone shows an error goes last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, reduce
from itertools import accumulate, groupby, pairwise

import numpy as np

from otf_core.arrays import Array
from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.machine import Machine
from otf_core.model.plan import Part, Plan
from otf_core.planning.chains import HAND_MOVE, Chain, candidate_chains, parts_of
from otf_core.planning.facings import facing_chains
from otf_core.planning.forecast import Judge, Setup
from otf_core.planning.line_of_sight import (
    HAND_TURN,
    facings_needed,
    sights,
)
from otf_core.planning.nc.programs import on_increments
from otf_core.planning.path_creation import plan_path
from otf_core.solving.normal import NormalEquations
from otf_core.solving.solution import Positive

DRIVING_TIME = 600.0
"""s of driving beside the lines that a plan takes where no time is given."""
FEWEST_LEVELS = 2
"""Levels of the shorter lines that a budget may choose."""
UNSEEN, HARDLY = 30.0, 0.15
"""What an error that is not seen costs, and the share of its variance from which it is not."""
AT_ONCE = 0.06
"""Share of the chains that goes at once while the time is far exceeded."""
COARSE = 10
"""Intervals of the range of an axis where chains are chosen."""
SHORT_LIST = 6
"""Chains whose worth is computed beyond first order, beside those that go at once."""


def choose_parts(
    setup: Setup, config: PlannerConfig, time_budget: float | None = None
) -> tuple[Part, ...]:
    """Choose the parts of a plan.

    Parameters
    ----------
    time_budget : float, optional
        s for all driving and all moves and turns by hand; without it all lines, and
        ``DRIVING_TIME`` for the rest.

    Raises
    ------
    ConfigError
        If the time is too short for any chain.
    """
    machine = setup.machine
    chains = candidate_chains(machine, config) + facing_chains(machine, setup.place)
    if time_budget is not None and config.levels > FEWEST_LEVELS:
        few = replace(config, levels=FEWEST_LEVELS)
        chains += [c for c in candidate_chains(machine, few) if c.is_lines]
    chains = sorted(chains, key=lambda c: (list(machine.targets).index(c.target), not c.is_lines))
    choice = _Choice(setup, chains, config, time_budget)
    selected = (
        list(range(len(chains))) if choice.spent(chains) <= choice.limit else choice.choose()
    )
    return parts_of(machine, [chains[k] for k in selected], config)


class _Choice:
    """Chains, what they say and how long they take."""

    def __init__(
        self, setup: Setup, chains: Sequence[Chain], config: PlannerConfig, budget: float | None
    ) -> None:
        self.setup, self.chains, self.config = setup, chains, config
        self.whole, self.limit = budget is not None, budget or DRIVING_TIME
        machine = setup.machine
        self.each = [parts_of(machine, [c], config)[0] for c in chains]
        self.seconds = [setup.seconds(part) for part in self.each]
        self.judge = Judge(setup, self.each, COARSE)
        self.turning = {n: HAND_TURN * (facings_needed(s) - 1)
                        for n, s in sights(machine, setup.place).items()
                        if not machine.targets[n].nest}  # fmt: skip

    @cached_property
    def equations(self) -> list[NormalEquations]:
        """What the samples of every chain say."""
        return self.judge.equations(self.each)

    @cached_property
    def starts(self) -> list[int]:
        """First row of every error."""
        sizes = [1] * len(self.setup.machine.scalars)
        sizes += [len(self.judge.nodes[m.axis]) for m in self.setup.machine.motions]
        return [0, *accumulate(sizes[:-1])]

    def choose(self) -> list[int]:
        """Choose: take out until the time is kept, then put back what still fits.

        Raises
        ------
        ConfigError
            If no chain fits.
        """
        selected = list(range(len(self.chains)))
        total = sum(self.equations, self.judge.known)
        while self._spent(selected) > self.limit:
            free = [k for k in selected if self.whole or not self.chains[k].is_lines]
            if len(selected) == 1 or not free:
                raise ConfigError(
                    f'--time-budget: {self.limit:g} s: the shortest chain alone takes '
                    f'{min(self.seconds):.0f} s'
                )
            drop = self._worth_least(selected, free, total)
            selected = [k for k in selected if k not in drop]
            total = reduce(NormalEquations.less, (self.equations[k] for k in drop), total)
        while True:
            more = self._with_one_more(selected)
            if more is None:
                return selected
            selected = more

    def _worth_least(
        self, selected: list[int], free: list[int], total: NormalEquations
    ) -> list[int]:
        """Those of the free chains that cost least per second."""
        now, slope = self._sum_of_logs(total), self._slope(total)
        saved = {k: self.seconds[k] + self._hand(selected, k) for k in free}
        count = max(1, int(AT_ONCE * len(free)))
        first = {k: float(np.vdot(self.equations[k].matrix, slope)) / saved[k] for k in free}
        short = sorted(free, key=lambda k: first[k])[: count + SHORT_LIST]
        cost = {k: (self._sum_of_logs(total.less(self.equations[k])) - now) / saved[k]
                for k in short}  # fmt: skip
        drop = sorted(short, key=lambda k: cost[k])[:count]
        over = self._spent(selected) - self.limit
        while len(drop) > 1 and sum(saved[k] for k in drop[:-1]) > over:
            drop = drop[:-1]
        return drop

    def _with_one_more(self, selected: list[int]) -> list[int] | None:
        """The best chain that still fits beside the others; None if none does."""
        left = self.limit - self._spent(selected)
        out = [k for k in range(len(self.chains)) if k not in selected and self.seconds[k] <= left]
        total = sum((self.equations[k] for k in selected), self.judge.known)
        slope = self._slope(total)
        out.sort(key=lambda k: -float(np.vdot(self.equations[k].matrix, slope)))
        fits: list[int] = []
        for k in out:
            if len(fits) < SHORT_LIST and self._spent(sorted([*selected, k])) <= self.limit:
                fits.append(k)
        if not fits:
            return None
        gain = {k: -self._sum_of_logs(total + self.equations[k]) for k in fits}
        return sorted([*selected, max(fits, key=lambda k: gain[k])])

    def _spent(self, selected: Sequence[int]) -> float:
        return self.spent([self.chains[k] for k in selected])

    def spent(self, chains: Sequence[Chain]) -> float:
        """Time that counts: all of it, or without a budget the driving beside the lines, s."""
        parts = parts_of(self.setup.machine, chains, self.config)
        took = [self.setup.seconds(part) for part in parts]
        if self.whole:
            turned = {c.target for c in chains if not c.is_lines}
            moves, turns = work_by_hand(self.setup.machine, parts)
            by_hand = HAND_MOVE * moves + HAND_TURN * turns
            return sum(took) + by_hand + sum(self.turning.get(t, 0) for t in turned)
        kinds = [kind for kind, _ in groupby(chains, key=lambda c: c.part)]
        return sum(t for t, kind in zip(took, kinds, strict=True) if not kind[1])

    def _hand(self, selected: Sequence[int], k: int) -> float:
        """Time by hand, s, that goes with a chain: of the only one of its target."""
        own, targets = self.chains[k], self.setup.machine.targets
        others = [self.chains[i].target for i in selected if i != k]
        if not self.whole or own.target in others:
            return 0.0
        nest = targets[own.target].nest
        if nest and any(targets[t].nest == nest for t in others):
            return HAND_TURN
        return HAND_MOVE + (0.0 if own.is_lines else self.turning.get(own.target, 0.0))

    def _variances(self, normal: NormalEquations) -> Array:
        """Mean variance of every error over its nodes."""
        return self._means(self._cover(normal) @ self.judge.errors.T)

    def _cover(self, normal: NormalEquations) -> Array:
        """Covariance of the free unknowns, in units of the squared limit."""
        return Positive((normal.matrix + self.judge.prior) * self.setup.limit**2).inverse

    def _means(self, pulled: Array) -> Array:
        variance = np.einsum('ij,ji->i', self.judge.errors, pulled)
        sizes = np.diff([*self.starts, len(variance)])
        return np.asarray(np.maximum(np.add.reduceat(variance, self.starts) / sizes, 1e-30))

    def _slope(self, normal: NormalEquations) -> Array:
        """Minus the derivative of S by the normal equations, (free, free)."""
        pulled = self._cover(normal) @ self.judge.errors.T
        sizes = np.diff([*self.starts, len(self.judge.errors)])
        weight = np.repeat(1.0 / (sizes * self._means(pulled)), sizes)
        return np.asarray((pulled * weight) @ pulled.T)

    @cached_property
    def before(self) -> Array:
        """Variances before any measurement."""
        return self._variances(self.judge.known)

    def _sum_of_logs(self, normal: NormalEquations) -> float:
        """S."""
        variance = self._variances(normal)
        unseen = int(np.sum(variance > HARDLY * self.before))
        return float(np.log(variance).sum()) + UNSEEN * unseen


def work_by_hand(machine: Machine, parts: Sequence[Part]) -> tuple[int, int]:
    """How often the reflector is taken to another place, and how often turned in its nest."""
    order = [target for target, _ in groupby(parts, key=lambda p: p.path.target)]
    nests = [machine.targets[target].nest for target in order]
    turns = sum(bool(a) and a == b for a, b in pairwise(nests))
    return len(order) - 1 - turns, turns


def planned(setup: Setup, config: PlannerConfig) -> Plan:
    """What to drive where nothing else is wished, at positions that a program can state.

    Laps of the linear axes, or with rotary ones the parts that ``choose_parts`` takes.
    """
    turns = bool(setup.machine.rotary_names)
    parts = choose_parts(setup, config) if turns else plan_path(setup.machine, config).parts
    return on_increments(setup.machine, parts)
