# SPDX-License-Identifier: Apache-2.0
"""Typical systematic contributions, where machine.yaml declares none.

A calibration without declared contributions would state the noise of the tracker and the misfit
of the model, often a tenth of what a repetition with another tracker on another day would show.
The sensitivities S of the unknowns to the missing contributions are those of the budget
(``systematic``); only their sizes are typical ones (``presets.TYPICAL``) instead of declared, and
S S^T is one more source of the budget.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import (
    SYSTEMATIC,
    TYPICAL_SOURCE,
    Budget,
    Source,
    Systematic,
    possible_keys,
    systematic_pulls,
)
from otf_core.effects import State
from otf_core.model.presets import TYPICAL, typical_values
from otf_core.model.sections import DeclaredUncertainty
from otf_core.pieces.runs import Observed
from otf_core.solving.joint import JointSolution
from otf_core.threads import one_thread


@dataclass(frozen=True)
class TypicalSystematic:
    """Typical values for what nobody declared.

    Attributes
    ----------
    missing : tuple of str
        Contributions of which at least one key is not declared, as the budget calls them.
    assumed : mapping of key to float
        Typical standard uncertainty of every missing key.
    change : ndarray, shape (full, k), m and rad
        Of all unknowns, per typical standard uncertainty of each coefficient.
    """

    missing: tuple[str, ...]
    nothing_declared: bool
    assumed: Mapping[str, float]
    change: Array

    @property
    def warning(self) -> str:
        """One line for the user."""
        return (
            f'machine.yaml declares nothing for {", ".join(self.missing)}: u includes typical '
            f'values for them (presets {", ".join(TYPICAL)}); declare them in the section '
            f'uncertainty'
        )


def typical_runs(runs: Sequence[Observed], values: Mapping[str, float]) -> list[Observed]:
    """Runs of machines that declare these values and nothing else."""
    declared = DeclaredUncertainty(values)
    return [replace(r, machine=replace(r.machine, uncertainty=declared)) for r in runs]


def missing_keys(runs: Sequence[Observed]) -> dict[str, float]:
    """Keys that no run declares, with their typical values."""
    declared = {k for r in runs if r.machine.uncertainty for k in r.machine.uncertainty.values}
    typical = typical_values()
    return {k: typical[k] for k in possible_keys(runs) if k not in declared}


def _missing(assumed: Mapping[str, float]) -> list[Systematic]:
    """Contributions of which at least one key is among these."""
    return [s for s in SYSTEMATIC if set(s.keys) & set(assumed)]


def typical_pulls(
    runs: Sequence[Observed],
    joint: JointSolution,
    states_of: Callable[[Sequence[Observed]], Sequence[State]],
) -> Array:
    """A^T W c of typical contributions, shape (full, coefficients); see ``systematic_pulls``.

    Parameters
    ----------
    states_of : callable(runs)
        States of the pieces of every run, see ``piece_states``.
    """
    assumed = missing_keys(runs)
    states = states_of(typical_runs(runs, assumed)) if assumed else []
    with one_thread():
        pulls = systematic_pulls(_missing(assumed), states, joint)
    return np.concatenate([np.zeros((joint.unknowns.full, 0)), *pulls], axis=1)


def typical_systematic(
    runs: Sequence[Observed], joint: JointSolution, pulls: Array
) -> TypicalSystematic | None:
    """Compute what typical contributions add; None if everything is declared.

    Parameters
    ----------
    joint : JointSolution
        Of the same runs.
    pulls : ndarray, shape (full, coefficients)
        See ``typical_pulls``.
    """
    assumed = missing_keys(runs)
    sources = _missing(assumed)
    if not sources:
        return None
    with one_thread():
        change = joint.solution.covariance @ pulls
    possible = possible_keys(runs)
    missing = tuple(s.source for s in sources)
    return TypicalSystematic(missing, len(assumed) == len(possible), assumed, change)


def with_typical(budget: Budget, typical: TypicalSystematic | None) -> Budget:
    """The budget with typical values where nothing is declared: what is stated first."""
    if typical is None:
        return budget
    source = Source(TYPICAL_SOURCE, typical.change @ typical.change.T, np.inf)
    return replace(budget, sources=(*budget.sources, source))
