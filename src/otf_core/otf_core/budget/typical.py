# SPDX-License-Identifier: Apache-2.0
"""What typical systematic contributions would make of u, where machine.yaml declares none.

A calibration without declared contributions states the noise of the tracker and the misfit of the
model, often a tenth of what a repetition with another tracker on another day would show. The
sensitivities S of the tables to the missing contributions are those of the budget
(``systematic``); only their sizes are typical ones (``presets.TYPICAL``) instead of declared:

    u_with^2 = u^2 + diag( S S^T )

Nothing of this enters the covariance: what is not declared stays out, but not out of sight.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import (
    SYSTEMATIC,
    TYPICAL_SOURCE,
    Budget,
    Source,
    Systematic,
    systematic_pulls,
)
from otf_core.effects import State
from otf_core.model.motions import is_location
from otf_core.model.presets import TYPICAL, typical_values
from otf_core.model.sections import DeclaredUncertainty, declarable_keys
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Observed
from otf_core.prediction.volumetric import table_places
from otf_core.solving.joint import JointSolution
from otf_core.threads import one_thread


@dataclass(frozen=True)
class TypicalSystematic:
    """u as stated, and with typical values for what nobody declared.

    Attributes
    ----------
    missing : tuple of str
        Contributions of which at least one key is not declared, as the budget calls them.
    assumed : mapping of key to float
        Typical standard uncertainty of every missing key.
    scalars : mapping of name to (float, float), rad or m
        u as stated and with them, of squareness and location errors that are identifiable.
    motions : mapping of name to ndarray, shape (k,), m or rad
        u with them at every node; zero where not identifiable.
    grid : tuple of two floats, m
        Root mean square over a grid of the u of the error vector, rigid motion removed: as
        stated and with them.
    change : ndarray, shape (full, k), m and rad
        Of all unknowns, per typical standard uncertainty of each coefficient.
    """

    missing: tuple[str, ...]
    nothing_declared: bool
    assumed: Mapping[str, float]
    scalars: Mapping[str, tuple[float, float]]
    motions: Mapping[str, Array]
    grid: tuple[float, float]
    change: Array

    @property
    def warning(self) -> str:
        """One line for the user."""
        return (
            f'machine.yaml declares nothing for {", ".join(self.missing)}: U includes typical '
            f'values for them (presets {", ".join(TYPICAL)}), u in the files does not; declare '
            f'them in the section uncertainty'
        )


def typical_runs(runs: Sequence[Observed], values: Mapping[str, float]) -> list[Observed]:
    """Runs of machines that declare these values and nothing else."""
    declared = DeclaredUncertainty(values)
    return [replace(r, machine=replace(r.machine, uncertainty=declared)) for r in runs]


def missing_keys(runs: Sequence[Observed]) -> dict[str, float]:
    """Keys that no run declares, with their typical values."""
    declared = {k for r in runs if r.machine.uncertainty for k in r.machine.uncertainty.values}
    typical = typical_values()
    possible = declarable_keys(bool(runs[0].machine.rotary_names))
    return {k: typical[k] for k in possible if k not in declared}


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
    runs: Sequence[Observed],
    joint: JointSolution,
    tables: ErrorTables,
    rows: Array,
    covariance: Array,
    pulls: Array,
    grid_rows: Callable[[], Array],
    hidden: Collection[str],
) -> TypicalSystematic | None:
    """Compute what typical contributions would add.

    Parameters
    ----------
    joint : JointSolution
        Of the same runs.
    tables : ErrorTables
        As solved.
    rows : ndarray, shape (m, full)
        Squareness and nodes from all unknowns, see ``tabulate.Tabulation``.
    covariance : ndarray, shape (m, m)
        As stated, of squareness and nodes in the order of predictions.
    pulls : ndarray, shape (full, coefficients)
        See ``typical_pulls``.
    grid_rows : callable
        Rows (3 n, m) of the error vectors of a grid, the best rigid motion removed.
    hidden : collection of str
        Squareness and location errors that the data do not show.

    Returns
    -------
    TypicalSystematic or None
        None if everything is declared.
    """
    assumed = missing_keys(runs)
    sources = _missing(assumed)
    if not sources:
        return None
    with one_thread():
        whole = joint.solution.covariance @ pulls
        change = rows @ whole
        stated = np.maximum(np.diag(covariance), 0.0)
        u = np.sqrt(stated + np.sum(change**2, axis=1))
        free = grid_rows()
        # three components a point: the u of the vector is the root of their sum
        before = 3.0 * np.maximum(np.einsum('ij,ij->i', free @ covariance, free), 0.0).mean()
        after = before + 3.0 * np.mean(np.sum((free @ change) ** 2, axis=1))
    places, machine = table_places(tables), tables.machine
    motions: dict[str, Array] = {
        m: u[places[m]] * float(tables.motions[m].identifiable) for m in machine.motions
    }
    return TypicalSystematic(
        missing=tuple(s.source for s in sources),
        nothing_declared=len(assumed) == len(declarable_keys(bool(machine.rotary_names))),
        assumed=assumed,
        scalars={
            n: (float(np.sqrt(stated[k])), float(u[k]))
            for k, n in enumerate(machine.scalars)
            if n not in hidden
        },
        motions=motions,
        grid=(float(np.sqrt(before)), float(np.sqrt(after))),
        change=whole,
    )


def with_typical(budget: Budget, typical: TypicalSystematic | None) -> Budget:
    """The budget with typical values where nothing is declared: what is stated first."""
    if typical is None:
        return budget
    source = Source(TYPICAL_SOURCE, typical.change @ typical.change.T, np.inf)
    return replace(budget, sources=(*budget.sources, source))


def typical_warnings(typical: TypicalSystematic | None) -> tuple[str, ...]:
    """What the user should read above the tables; nothing if everything is declared."""
    return () if typical is None else (typical.warning,)


def typical_to_dict(typical: TypicalSystematic | None) -> dict[str, Any] | None:
    """Entry ``typical_systematic`` of error_tables.json; None if everything is declared."""
    if typical is None:
        return None
    scalars = {n: {'u': u} for n, (_, u) in typical.scalars.items()}
    return {
        'missing': list(typical.missing),
        'presets': list(TYPICAL),
        'assumed': dict(typical.assumed),
        'squareness': {n: u for n, u in scalars.items() if not is_location(n)},
        'location': {n: u for n, u in scalars.items() if is_location(n)},
        'motions': {n: {'u': u.tolist()} for n, u in typical.motions.items()},
        'grid': {'unit': 'm', 'u_stated': typical.grid[0], 'u': typical.grid[1]},
    }
