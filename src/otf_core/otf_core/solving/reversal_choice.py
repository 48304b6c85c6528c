# SPDX-License-Identifier: Apache-2.0
"""What differs between both senses of travel: reversal of the motions, and lags of the axes.

All motions of all axes may have half a reversal value with the sign of the last travel of their
axis, constant or a table over its position, and all axes a lag that displaces them by its speed.
Those that are significant are kept; whether they are constants, tables or nothing is decided on
held-out lines, as for linear axes (``model_choice``). The tables hold the mean of both senses. An
axis that stands after its travel shows backlash, but no lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.model.machine import Machine
from otf_core.solving.joint import (
    JointSolution,
    place_equations,
    systems_of,
    tables_of,
    unknowns_of,
)
from otf_core.solving.model_choice import (
    MIN_LINES,
    Choice,
    Evidence,
    FoldedLines,
    choose_model,
    line_folds,
    too_few,
)
from otf_core.solving.reversal import AUTO, CONSTANT, NONE, TABLES, count_functions
from otf_core.solving.solution import free_columns, solve
from otf_core.solving.unknowns import (
    Unknowns,
    is_reversal,
    lag_block,
    reversal_block,
    reversal_order,
)

SIGNIFICANT = 5.0
"""Standard uncertainties; by chance one of thirty constants exceeds them in 60 000 runs."""
PER_FUNCTION = 3.0
"""Squared standard uncertainties that each further function of a motion needs besides."""
LEAST = 3e-7
"""m and rad; smaller differences are left in the residuals."""
MOST, MOST_LAG = 1e-3, 1e-3
"""m and rad, and s; differences between both senses and lags are smaller."""
LATE = 1.01
"""Preference of backlash, and of an axis that is late, over another that is early: where axes
drive together only, or at one speed, the data do not tell them apart."""
VAGUE_LAG = 1e2
"""Lags, s, may be less certain than ``unidentifiable_above`` by this factor."""


@dataclass(frozen=True)
class AxisLag:
    """Time by which an axis is late behind the others, s, and its standard uncertainty."""

    axis: str
    value: float
    u: float


def lags(joint: JointSolution, covariance: Array) -> list[AxisLag]:
    """Lags of a solution, by a covariance (full, full) of its unknowns."""
    found = []
    for axis in joint.machine.axis_names:
        block = joint.unknowns.blocks.get(lag_block(axis))
        if block is not None:
            u = float(np.sqrt(max(covariance[block.start, block.start], 0.0)))
            found.append(AxisLag(axis, float(joint.solution.value[block.start]), u))
    return found


def choose_reversal(joint: JointSolution, config: CalibrationConfig) -> tuple[Choice, Unknowns]:
    """Choose what differs between both senses of travel.

    Parameters
    ----------
    joint : JointSolution
        Without reversal.

    Returns
    -------
    choice : Choice
    unknowns : Unknowns
        With the reversal coefficients and lags to solve for.
    """
    given, machine = config.reversal, joint.machine
    if given == NONE:
        return Choice(NONE, True, {'decided_by': 'configuration'}), joint.unknowns
    every = [
        name
        for name in _blocks(machine, CONSTANT if given == CONSTANT else TABLES)
        if name[:3] in joint.solution.accepted
    ]
    trial = _Trial.of(joint, every)
    if given != AUTO:
        seen = trial.visible(every, config.unidentifiable_above)
        return Choice(given, True, {'decided_by': 'configuration'}), _of(joint, seen)
    found = {model: trial.significant(model, config) for model in (CONSTANT, TABLES)}
    if not any(map(is_reversal, found[TABLES])):
        nothing: Evidence = {'decided_by': 'no motion differs significantly'}
        return Choice(NONE, True, nothing), _of(joint, found[CONSTANT])
    late = tuple(n for n in found[CONSTANT] if not is_reversal(n))
    models = {NONE: late, **found}
    if not any(reversal_order(n) > 0 for n in found[TABLES]):
        del models[TABLES]
    lines = sum(map(len, trial.folded.fold))
    if lines < MIN_LINES:
        few: Evidence = {'decided_by': f'significance, {too_few(lines)}', 'lines': lines}
        return Choice(CONSTANT, True, few), _of(joint, found[CONSTANT])
    choice = choose_model(trial.held_out(models), True)
    return choice, _of(joint, models[choice.model])


def _of(joint: JointSolution, names: Sequence[str]) -> Unknowns:
    """Unknowns with some blocks: reversal coefficients and lags."""
    blocks = [n for n in names if is_reversal(n)]
    late = [n.split()[1] for n in names if not is_reversal(n)]
    runs = [solved.run for solved in joint.runs]
    return unknowns_of(runs, joint.unknowns.bases, blocks, late, held=True)


def _blocks(machine: Machine, model: str) -> list[str]:
    """Blocks of all reversal coefficients of a model, motion by motion."""
    return [
        reversal_block(motion, k)
        for motion in machine.motions
        for k in range(count_functions(machine.axes[motion.axis], model))
    ]


@dataclass(frozen=True)
class _Trial:
    """One step from a solution with further unknowns at the end, next to unknown before.

    Attributes
    ----------
    common : tuple of str
        Blocks that were solved for.
    folded : FoldedLines
    prior : ndarray, shape (free, free), 1 / (m, rad)^2
    value, covariance : ndarray, shape (full,) and (full, full)
    rates : ndarray, shape (k,), m/s and rad/s
        Largest speeds of the axes.
    """

    machine: Machine
    unknowns: Unknowns
    common: tuple[str, ...]
    folded: FoldedLines
    prior: Array
    value: Array
    covariance: Array
    rates: Array

    @classmethod
    def of(cls, joint: JointSolution, blocks: Sequence[str]) -> _Trial:
        """With coefficients of reversal for motions, and a lag for every axis."""
        machine = joint.machine
        unknowns = _of(joint, [*blocks, *map(lag_block, machine.axis_names)])
        tables = tables_of(machine, joint.unknowns, joint.solution)
        systems = systems_of([s.run for s in joint.runs], unknowns, tables)
        rows = [(system, s.whitener) for system, s in zip(systems, joint.runs, strict=True)]
        known = place_equations(machine, unknowns, joint.places)
        nothing = [np.zeros((*system.deviation.shape, 0)) for system in systems]
        folded = FoldedLines.of(rows, line_folds(joint), nothing, unknowns, None, [known])
        sizes = np.full(unknowns.free, MOST)
        for axis in machine.axis_names:
            sizes[unknowns.free_blocks[lag_block(axis)]] = MOST_LAG
        prior, old = np.diag(sizes**-2.0), joint.unknowns.free
        prior[:old, :old] = joint.roughness.precision
        common = joint.solution.accepted
        further = [n for n in unknowns.blocks if n not in joint.unknowns.blocks]
        solution = solve(folded.total, unknowns, 1e-6, (*common, *further), prior)
        rates = np.concatenate([np.abs(s.run.pieces.rate) for s in joint.runs]).max(axis=0)
        return cls(
            machine, unknowns, common, folded, prior, solution.value, solution.covariance, rates
        )

    def visible(self, blocks: Sequence[str], limit: float) -> list[str]:
        """Coefficients that the data show to a limit, of every motion up to the first hidden."""
        visible, hidden = [], set[str]()
        for name in blocks:
            k, motion = self.unknowns.blocks[name].start, name[:3]
            if motion not in hidden and self.covariance[k, k] < limit**2:
                visible.append(name)
            else:
                hidden.add(motion)
        return visible

    def held_out(self, models: dict[str, tuple[str, ...]]) -> dict[str, Array]:
        """Squares that models with some of the further blocks leave of held-out lines."""
        columns = {
            m: free_columns(self.unknowns, [*self.common, *own]) for m, own in models.items()
        }
        return self.folded.squares(columns, self.prior)

    @property
    def _further(self) -> list[str]:
        """Blocks of reversal and lags."""
        lagging = {lag_block(a) for a in self.machine.axis_names}
        return [n for n in self.unknowns.blocks if is_reversal(n) or n in lagging]

    def significant(self, model: str, config: CalibrationConfig) -> tuple[str, ...]:
        """Blocks to keep: coefficients of reversal and lags, all others zero.

        One after the other: the constant, the lag or, among ``TABLES``, the functions of a motion
        that explain most beside those already kept.
        """
        names = [n for n in self._further if model == TABLES or reversal_order(n) <= 0]
        group = [[k] for k, n in enumerate(names) if reversal_order(n) <= 0]
        for motion in self.machine.motions if model == TABLES else ():
            group.append([k for k, n in enumerate(names) if is_reversal(n) and n[:3] == motion])
        group = list(filter(None, group))
        every = self._further
        at = [self.unknowns.blocks[n].start for n in every]
        weight = np.asarray(np.linalg.inv(self.covariance[np.ix_(at, at)]), dtype=np.float64)
        own = [every.index(n) for n in names]
        pull = (weight @ self.value[at])[own]
        weight = weight[np.ix_(own, own)]
        least = np.full(len(names), LEAST)
        vague = np.full(len(names), config.unidentifiable_above)
        for k, name in enumerate(names):
            if not is_reversal(name):
                rate = self.rates[self.machine.column(name.split()[1])]
                least[k], vague[k] = LEAST / max(rate, 1e-9), vague[k] * VAGUE_LAG
        kept = list[int]()
        while True:
            score = [
                _gain(weight, pull, g, kept, least, vague, is_reversal(names[g[0]])) for g in group
            ]
            best = int(np.argmax(score))
            if score[best] <= 0.0:
                return tuple(n for k, n in enumerate(names) if k in kept)
            kept += [k for k in group[best] if k not in kept]


def _gain(
    weight: Array,
    pull: Array,
    group: Sequence[int],
    kept: Sequence[int],
    least: Array,
    vague: Array,
    backlash: bool,
) -> float:
    """What some unknowns explain beside those kept, less what they have to; 0 if too small.

    Parameters
    ----------
    weight, pull : ndarray, shape (k, k) and (k,)
        Normal equations of the further unknowns, all others solved for.
    least, vague : ndarray, shape (k,)
        Smallest value that matters, and largest standard uncertainty.
    """
    own = [k for k in group if k not in kept]
    if not own:
        return 0.0
    among = weight[np.ix_(own, kept)] @ np.linalg.inv(weight[np.ix_(kept, kept)])
    left = weight[np.ix_(own, own)] - among @ weight[np.ix_(kept, own)]
    size, vectors = np.linalg.eigh(left * np.outer(vague[own], vague[own]))
    seen = size > 1.0
    along = (vectors.T @ (vague[own] * (pull[own] - among @ pull[kept])))[seen]
    value = vague[own] * (vectors[:, seen] @ (along / size[seen]))
    if not np.any(np.abs(value) > least[own]):
        return 0.0
    preference = LATE**2 if backlash or value[0] > 0.0 else 1.0
    needed = SIGNIFICANT**2 + PER_FUNCTION * (len(own) - 1)
    return preference * float(np.sum(along**2 / size[seen])) - needed
