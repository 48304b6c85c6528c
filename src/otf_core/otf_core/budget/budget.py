# SPDX-License-Identifier: Apache-2.0
"""The budget: covariance of squareness and nodes as a sum over sources."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.budget.bend import Bend, estimate_bend
from otf_core.budget.columns import piece_state
from otf_core.budget.freedom import (
    coverage_factor,
    residual_freedom,
    standstill_freedom,
    welch_satterthwaite,
)
from otf_core.budget.noise import noise_parts
from otf_core.budget.systematic import SYSTEMATIC, declared_sources, systematic_sensitivity
from otf_core.budget.unseen import unseen_covariance
from otf_core.joint import JointSolution
from otf_core.normal import COHERENCE, MODEL_FLOOR
from otf_core.runs import Run
from otf_core.tables import MOTIONS, SQUARENESS, ErrorTables
from otf_core.uncertainty import ResidualCheck, check_residuals
from otf_core.unknowns import Unknowns

Array = NDArray[np.float64]

NOISE, MISFIT, BEND, UNSEEN = 'noise', 'misfit', 'bend between nodes', 'rotations not seen'
NAMES = (*SQUARENESS, *MOTIONS)


@dataclass(frozen=True)
class Source:
    """One contribution.

    Attributes
    ----------
    name : str
    covariance : ndarray, shape (m, m)
        Of C0Y, B0Z, A0Z and the nodes of EXX ... ECZ in that order, m and rad.
    dof : float
        Degrees of freedom of its size; infinite for declared ones.
    """

    name: str
    covariance: Array
    dof: float


@dataclass(frozen=True)
class Budget:
    """Uncertainty by source.

    Attributes
    ----------
    sources : tuple of Source
        Their covariances add up.
    not_stated : tuple of str
        Systematic contributions that nothing was declared for; not included.
    bend_factor, u_bend_factor : float
        See ``bend.Bend``.
    inflation : float
        Factor on the covariance that the residuals call for, the bend taken off.
    whole : ndarray, shape (full, full)
        Combined covariance of all unknowns, poses and reversal included.
    """

    sources: tuple[Source, ...]
    not_stated: tuple[str, ...]
    bend_factor: float
    u_bend_factor: float
    inflation: float
    whole: Array

    @property
    def covariance(self) -> Array:
        """Combined covariance, shape (m, m)."""
        return np.asarray(sum(s.covariance for s in self.sources))

    @property
    def freedoms(self) -> Array:
        """Degrees of freedom of every source, shape (sources,)."""
        return np.array([s.dof for s in self.sources])

    def variances(self, rows: Array | None = None) -> Array:
        """Variance by source of every value, or of linear combinations ``rows`` (n, m) of them.

        Returns
        -------
        ndarray, shape (sources, n)
        """
        if rows is None:
            found = [np.diag(s.covariance) for s in self.sources]
        else:
            found = [np.einsum('ij,ij->i', rows @ s.covariance, rows) for s in self.sources]
        return np.maximum(np.array(found), 0.0)

    def expansion(self, variances: Array) -> tuple[float, float]:
        """Coverage factor for 95 % and degrees of freedom, smallest over values (sources, n)."""
        known = variances[:, variances.sum(axis=0) > 0]
        freedom = float(welch_satterthwaite(known, self.freedoms).min(initial=np.inf))
        return coverage_factor(freedom), freedom


def table_order(unknowns: Unknowns) -> NDArray[np.int64]:
    """Places of squareness and nodes in the full vector, in the order of predictions."""
    blocks = [unknowns.blocks[name] for name in NAMES]
    return np.concatenate([np.arange(b.start, b.stop) for b in blocks])


def whole_check(
    runs: Sequence[Run], done: JointSolution, residuals: Sequence[Array]
) -> ResidualCheck:
    """Check residuals (c, p) of all runs together against the noise assumed."""
    white = [s.whitener.vector(e) for s, e in zip(done.runs, residuals, strict=True)]
    # legs of different runs are told apart
    legs = [r.pieces.leg + 100_000 * k for k, r in enumerate(runs)]
    return check_residuals(np.concatenate(white, axis=1), np.concatenate(legs), done.solution.rank)


def _believed(run: Run, bend: Bend) -> float:
    """Variance of the floor of one run that is believed, over the one it was weighted with."""
    if not bend.significant:
        return 1.0
    # what makes the shapes between nodes worse than noise of their size is then known
    seen = (run.floor**2 - MODEL_FLOOR**2) / COHERENCE**2
    return (MODEL_FLOOR**2 + seen) / run.floor**2


def make_budget(
    runs: Sequence[Run], done: JointSolution, tables: ErrorTables, speed: float
) -> Budget:
    """Set up the budget of a calibration.

    Parameters
    ----------
    runs : sequence of Run
    done : JointSolution
        Of the same runs.
    tables : ErrorTables
        As solved.
    speed : float
        m/s; slower counts as standstill.
    """
    own = done.solution.covariance
    states = [
        piece_state(r, s, done.unknowns.nodes, tables)
        for r, s in zip(runs, done.runs, strict=True)
    ]
    first = whole_check(runs, done, [s.residual for s in done.runs])
    bend = estimate_bend(runs, done, tables, first.inflation)
    check = whole_check(runs, done, bend.residuals)
    parts = noise_parts(runs, done, states)
    floors = [own @ f @ own for f in parts.floors]
    noise = own - sum(floors) + own @ parts.corners @ own
    misfit = (check.inflation - 1.0) * own
    misfit += sum(_believed(r, bend) * f for r, f in zip(runs, floors, strict=True))
    dof = residual_freedom(done, check.correlation_factor) + standstill_freedom(runs, speed)
    found = [(NOISE, noise, dof), (MISFIT, misfit, dof), (BEND, bend.covariance, bend.dof)]
    found.append((UNSEEN, *unseen_covariance(runs, done, bend.residuals, check.inflation)))
    declared = declared_sources(runs)
    for source in declared:
        change = systematic_sensitivity(source, runs, done, tables)
        found.append((source.source, change @ change.T, np.inf))
    order = table_order(done.unknowns)
    return Budget(
        tuple(Source(name, c[np.ix_(order, order)], d) for name, c, d in found),
        tuple(s.source for s in SYSTEMATIC if s not in declared),
        bend.factor,
        bend.u,
        check.inflation,
        np.asarray(sum(c for _, c, _ in found)),
    )
