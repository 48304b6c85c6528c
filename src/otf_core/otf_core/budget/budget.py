# SPDX-License-Identifier: Apache-2.0
"""The budget: covariance of squareness and nodes as a sum over sources."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.freedom import residual_freedom, standstill_freedom, welch_satterthwaite
from otf_core.budget.noise import NoiseParts
from otf_core.budget.systematic import (
    SYSTEMATIC,
    declared_sources,
    piece_states,
    systematic_sensitivities,
)
from otf_core.model.expanded import coverage_factor
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables
from otf_core.pieces.observed import Observed
from otf_core.pieces.runs import Run
from otf_core.solving.folds import leg_numbers
from otf_core.solving.joint import JointSolution
from otf_core.solving.residual_check import ResidualCheck, check_residuals
from otf_core.solving.unknowns import free_values

NOISE, MISFIT, SMOOTHNESS, EFFECTS = 'noise', 'misfit', 'smoothness', 'effects'
STRAIGHT = 'straight lines'
TYPICAL_SOURCE = 'typical, not declared'
"""What typical values add for systematic contributions that nobody declared."""
NAMES = (*SQUARENESS, *MOTIONS)
OBSERVED = (NOISE, MISFIT, SMOOTHNESS, EFFECTS, STRAIGHT)
"""Sources that the run itself shows; all others are systematic."""


@dataclass(frozen=True)
class Source:
    """One contribution.

    Attributes
    ----------
    name : str
    covariance : ndarray, shape (full, full), m and rad
        Of all unknowns.
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
    inflation : float
        Factor on the covariance that the residuals still call for.
    rows : ndarray, shape (m, full)
        Squareness and nodes of the tables from all unknowns, see ``tabulate.Tabulation``.
    straight : ndarray, shape (m,), m^2 and rad^2
        Variance of the nodes that stands for what straight lines between them miss.
    """

    sources: tuple[Source, ...]
    not_stated: tuple[str, ...]
    inflation: float
    rows: Array
    straight: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all sources of the tables."""
        return (*(s.name for s in self.sources), STRAIGHT)

    @property
    def whole(self) -> Array:
        """Combined covariance of all unknowns, poses and reversal included, (full, full)."""
        return np.asarray(sum(s.covariance for s in self.sources))

    @cached_property
    def covariance(self) -> Array:
        """Combined covariance of C0Y, B0Z, A0Z and the nodes of EXX ... ECZ, shape (m, m)."""
        return np.asarray(self.rows @ self.whole @ self.rows.T + np.diag(self.straight))

    @property
    def freedoms(self) -> Array:
        """Degrees of freedom of every source, shape (sources,)."""
        return np.array([*(s.dof for s in self.sources), np.inf])

    def variances(self, rows: Array | None = None) -> Array:
        """Variance by source of every value, or of linear combinations ``rows`` (n, m) of them.

        Returns
        -------
        ndarray, shape (sources, n)
        """
        whole = self.rows if rows is None else rows @ self.rows
        found = [np.einsum('ij,ij->i', whole @ s.covariance, whole) for s in self.sources]
        found.append(self.straight if rows is None else rows**2 @ self.straight)
        return np.asarray(np.maximum(np.array(found), 0.0))

    def expansion(self, variances: Array) -> tuple[float, float]:
        """Coverage factor for 95 % and degrees of freedom, smallest over values (sources, n)."""
        known = variances[:, variances.sum(axis=0) > 0]
        freedom = float(welch_satterthwaite(known, self.freedoms).min(initial=np.inf))
        return coverage_factor(freedom), freedom


def whole_check(
    runs: Sequence[Observed], done: JointSolution, residuals: Sequence[Array]
) -> ResidualCheck:
    """Check residuals (c, p) of all runs together against the noise assumed."""
    white = [s.whitener.whiten(e) for s, e in zip(done.runs, residuals, strict=True)]
    legs = np.concatenate(leg_numbers(done))
    return check_residuals(np.concatenate(white, axis=1), legs, done.solution.rank)


def _prior_part(done: JointSolution) -> Array:
    """Part C K^-1 C of the covariance C that data leave to the prior K, shape (full, full)."""
    free = free_values(done.unknowns, done.solution.covariance)
    return np.asarray(free.T @ done.roughness.precision @ free)


def make_budget(
    runs: Sequence[Run],
    done: JointSolution,
    parts: NoiseParts,
    tables: ErrorTables,
    speed: float,
) -> Budget:
    """Set up the budget of a calibration.

    Parameters
    ----------
    runs : sequence of Run
    done : JointSolution
        Of the same runs.
    parts : NoiseParts
        Of both.
    tables : ErrorTables
        As solved.
    speed : float
        m/s; slower counts as standstill.

    Returns
    -------
    Budget
        Of the unknowns themselves; ``rows`` are to be set to those of the tables.
    """
    own = done.solution.covariance
    check = whole_check(runs, done, [s.residual for s in done.runs])
    gauge = done.unknowns.gauge
    smooth = _prior_part(done)
    drawn = gauge @ done.roughness.drawn
    misfit = own @ parts.misfit @ own
    noise = own - misfit - smooth + own @ (parts.corners + parts.between) @ own
    misfit += own @ parts.misfit_corners @ own + (check.inflation - 1.0) * (own - smooth)
    dof = residual_freedom(done, check.correlation_factor) + standstill_freedom(runs, speed)
    found = [(NOISE, noise, dof), (MISFIT, misfit, dof)]
    found.append((SMOOTHNESS, smooth + drawn @ drawn.T, np.inf))
    declared = declared_sources(runs)
    states = piece_states(runs, done, tables) if declared else []
    changes = systematic_sensitivities(declared, states, done)
    for source, change in zip(declared, changes, strict=True):
        found.append((source.source, change @ change.T, np.inf))
    return Budget(
        tuple(Source(*entry) for entry in found),
        tuple(s.source for s in SYSTEMATIC if s not in declared),
        check.inflation,
        np.eye(done.unknowns.full),
        np.zeros(done.unknowns.full),
    )


def with_source(budget: Budget, name: str, covariance: Array) -> Budget:
    """The budget with one more source after those of the data, (full, full), m and rad."""
    own = len((NOISE, MISFIT, SMOOTHNESS))
    source = Source(name, covariance, np.inf)
    return replace(budget, sources=(*budget.sources[:own], source, *budget.sources[own:]))
