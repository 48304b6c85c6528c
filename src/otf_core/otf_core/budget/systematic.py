# SPDX-License-Identifier: Apache-2.0
"""Systematic contributions as shared parameters: what each is, and its standard uncertainty.

Each is an effect of the catalogue with the same coefficients in the whole calibration; the
columns are those of the effect (``Effect.terms``), and the effect says from which keys of
machine.yaml their uncertainty comes (``Effect.contributions``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from otf_core.arrays import Array
from otf_core.effects import REGISTRY, Effect, State, Terms
from otf_core.effects.base import Contribution
from otf_core.model.declared import KEYS, DeclaredUncertainty
from otf_core.model.tables import ErrorTables
from otf_core.pieces.observed import Observed
from otf_core.solving.columns import across, piece_state, projected
from otf_core.solving.joint import JointSolution, SolvedRun

ENOUGH = 50_000
"""Pieces over which an uncertainty declared for the whole path is shared out; of longer runs
every n-th."""


@dataclass(frozen=True)
class Systematic:
    """One contribution.

    Attributes
    ----------
    effect : Effect
        What it acts as.
    acts : Contribution
    """

    effect: Effect
    acts: Contribution

    @property
    def source(self) -> str:
        """As the budget calls it."""
        return self.acts.source

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of machine.yaml, any of which declares it."""
        return self.acts.keys

    def uncertainty(self, terms: Terms, state: State, declared: DeclaredUncertainty) -> Array:
        """Standard uncertainty of every coefficient, shape (k,)."""
        return self.acts.size(terms, state, declared.get(*self.keys))


SYSTEMATIC = tuple(
    sorted(
        (Systematic(e, c) for e in REGISTRY.values() for c in e.contributions),
        key=lambda one: list(KEYS).index(one.keys[0]),
    )
)
"""In the order of their keys."""


def declared_sources(runs: Sequence[Observed]) -> tuple[Systematic, ...]:
    """Contributions that any run declares."""
    given = {k for r in runs if r.machine.uncertainty for k in r.machine.uncertainty.values}
    return tuple(s for s in SYSTEMATIC if given & set(s.keys))


def piece_states(
    runs: Sequence[Observed], done: JointSolution, tables: ErrorTables
) -> list[State]:
    """State of the pieces of every run, with what its machine declares."""
    nodes = done.unknowns.knots
    return [piece_state(r, s, nodes, tables) for r, s in zip(runs, done.runs, strict=True)]


def systematic_sensitivities(
    sources: Sequence[Systematic], states: Sequence[State], done: JointSolution
) -> list[Array]:
    """Change of the estimates per standard uncertainty of the coefficients of every source.

    A coefficient is one parameter shared by all runs. The weights of a line are made once for
    all sources.

    Parameters
    ----------
    sources : sequence of Systematic
    states : sequence of State
        See ``piece_states``.
    done : JointSolution

    Returns
    -------
    list of ndarray, shape (full, k)
    """
    pulls = systematic_pulls(sources, states, done)
    return [done.solution.covariance @ pull for pull in pulls]


def systematic_pulls(
    sources: Sequence[Systematic], states: Sequence[State], done: JointSolution
) -> list[Array]:
    """A^T W c for the columns c of every source, (full, k): sensitivities less the covariance."""
    if not sources:
        return []
    sizes = [[_uncertainty(source, state) for source in sources] for state in states]
    columns = [
        partial(_columns, sources, state, solved, u)
        for state, solved, u in zip(states, done.runs, sizes, strict=True)
    ]
    ends = np.cumsum([len(u) for u in sizes[0]])
    return np.split(projected(done, columns), ends[:-1], axis=1)


def _uncertainty(source: Systematic, state: State) -> Array:
    """Standard uncertainty of every coefficient for one run, shape (k,)."""
    some = state.part(slice(None, None, max(1, len(state) // ENOUGH)))
    declared = state.machine.uncertainty or DeclaredUncertainty({})
    return source.uncertainty(source.effect.terms(some, source.acts.shape), some, declared)


def _columns(
    sources: Sequence[Systematic],
    state: State,
    solved: SolvedRun,
    sizes: Sequence[Array],
    pieces: slice,
) -> Array:
    """Displacements across the path of some pieces of a run, (c, m, k), m, per uncertainty."""
    some = state.part(pieces)
    columns = [
        across(solved, source.effect.terms(some, source.acts.shape).columns, pieces) * u
        for source, u in zip(sources, sizes, strict=True)
    ]
    return np.concatenate(columns, axis=2)
