# SPDX-License-Identifier: Apache-2.0
"""What differs between both senses of travel: backlash, a constant of each motion, and lags.

All motions of all axes get half a constant with the sign of the last travel of their axis, and all
axes a lag that displaces them by its speed; those that are significant are kept, and the tables
hold the mean of both senses. An axis that stands after its travel shows backlash, but no lag.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any, TypeVar, cast

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.model.motions import ErrorMotion
from otf_core.rotary.axis_solution import AxisSolution, place_equations, tables_of
from otf_core.rotary.axis_unknowns import lag_block
from otf_core.rotary.rows import build_rows
from otf_core.solving.normal import normal_equations
from otf_core.solving.solution import solve
from otf_core.solving.unknowns import Unknowns, reversal_block

SIGNIFICANT = 5.0
"""Standard uncertainties; by chance one of thirty constants exceeds them in 60 000 runs."""
LEAST = 3e-7
"""m and rad; smaller differences are left in the residuals."""
MOST, MOST_LAG = 1e-3, 1e-3
"""m and rad, and s; differences between both senses and lags are smaller."""
LATE = 1.01
"""Preference of an axis that is late over another that is early: where they drive together only,
the data do not tell them apart."""
NONE, CONSTANT, AUTO = 'none', 'constant', 'auto'


Key = TypeVar('Key', bound=Hashable)


@dataclass(frozen=True)
class AxisReversal:
    """Forward less backward travel of one motion, m or rad, and its standard uncertainty."""

    motion: ErrorMotion
    value: float
    u: float


@dataclass(frozen=True)
class AxisLag:
    """Time by which an axis is late behind the others, s, and its standard uncertainty."""

    axis: str
    value: float
    u: float


def reversals(joint: AxisSolution, covariance: Array | None = None) -> list[AxisReversal]:
    """Constants of a solution; with another covariance (full, full) than its own."""
    motions = {m: reversal_block(m, 0) for m in joint.machine.motions}
    return [AxisReversal(m, *of) for m, of in _estimates(joint, motions, covariance).items()]


def lags(joint: AxisSolution, covariance: Array | None = None) -> list[AxisLag]:
    """Lags of a solution; with another covariance (full, full) than its own."""
    axes = {a: lag_block(a) for a in joint.machine.axis_names}
    return [AxisLag(a, *of) for a, of in _estimates(joint, axes, covariance).items()]


def _estimates(
    joint: AxisSolution, blocks: Mapping[Key, str], covariance: Array | None
) -> dict[Key, tuple[float, float]]:
    """Values and standard uncertainties of those single unknowns that were solved for."""
    found, cover = {}, joint.solution.covariance if covariance is None else covariance
    for key, name in blocks.items():
        block = joint.unknowns.blocks.get(name)
        if block is not None:
            k = block.start
            u = float(np.sqrt(max(cover[k, k], 0.0)))
            found[key] = (float(joint.solution.value[k]), u)
    return found


def trial_of_reversal(joint: AxisSolution, unknowns: Unknowns) -> AxisSolution:
    """One step from a solution with further unknowns at the end, which are next to unknown before.

    Parameters
    ----------
    unknowns : Unknowns
        Those of the solution, a constant for every motion, and a lag for every axis.
    """
    tables = tables_of(joint.machine, joint.unknowns, joint.solution.value)
    parts = [
        normal_equations(cast(Any, build_rows(s.run, unknowns, tables)), unknowns, s.whitener)
        for s in joint.runs
    ]
    places = place_equations(joint.machine, unknowns, joint.runs[0].run.places)
    names = [n for n, s in unknowns.free_blocks.items() if s.stop > s.start]
    sizes = np.full(unknowns.free, MOST)
    for axis in joint.machine.axis_names:
        sizes[unknowns.free_blocks[lag_block(axis)]] = MOST_LAG
    prior, old = np.diag(sizes**-2.0), joint.unknowns.free
    prior[:old, :old] = joint.roughness.precision
    solution = solve(reduce(add, [*parts, places]), unknowns, 1e-6, tuple(names), prior)
    return replace(joint, unknowns=unknowns, solution=solution)


def significant(
    trial: AxisSolution, config: CalibrationConfig
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Motions to keep a constant of, and axes to keep a lag of.

    One after the other: the one that explains most beside those already kept, all others zero.

    Parameters
    ----------
    trial : AxisSolution
        With a constant for every motion and a lag for every axis.
    """
    limit = config.unidentifiable_above
    constants, late = reversals(trial), lags(trial)
    if config.reversal != AUTO:
        return tuple(str(r.motion) for r in constants if r.u < limit), ()
    names = [str(r.motion) for r in constants] + [r.axis for r in late]
    blocks = [reversal_block(n, 0) if len(n) == 3 else lag_block(n) for n in names]
    place = [trial.unknowns.blocks[b].start for b in blocks]
    rates = np.concatenate([np.abs(s.run.pieces.rate) for s in trial.runs]).max(axis=0)
    least = np.array([LEAST] * len(constants) + [LEAST / max(rates[k], 1e-9) for k in
                     (trial.machine.column(r.axis) for r in late)])  # fmt: skip
    value = trial.solution.value[place]
    weight = np.linalg.inv(trial.solution.covariance[np.ix_(place, place)])
    pull, kept = weight @ value, list[int]()
    for _ in names:
        inner = np.linalg.inv(weight[np.ix_(kept, kept)])
        among = weight[:, kept] @ inner
        left = np.diag(weight) - np.einsum('ij,ij->i', among, weight[:, kept])
        left[kept] = 0.0
        free = left > 1.0 / limit**2 * np.where(np.arange(len(names)) < len(constants), 1.0, 1e-4)
        size = np.where(free, (pull - among @ pull[kept]) / np.where(free, left, 1.0), 0.0)
        score = np.where(np.abs(size) > least, np.abs(size) * np.sqrt(np.maximum(left, 0.0)), 0.0)
        best = int(np.argmax(score * np.where(size > 0.0, LATE, 1.0)))
        if score[best] < SIGNIFICANT:
            break
        kept.append(best)
    chosen = [names[k] for k in kept]
    return tuple(n for n in chosen if len(n) == 3), tuple(n for n in chosen if len(n) == 1)
