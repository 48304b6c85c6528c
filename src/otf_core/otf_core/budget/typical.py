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

from collections.abc import Mapping, Sequence
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
    piece_states,
    systematic_pulls,
)
from otf_core.model.declared import KEYS, DeclaredUncertainty
from otf_core.model.evaluation import driven_grid, free_rows
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.presets import TYPICAL, typical_values
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Observed
from otf_core.prediction.uncertainty import prediction_rows
from otf_core.solving.joint import JointSolution, tables_of
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
    squareness : mapping of name to (float, float), rad
        u as stated and with them, of those that are identifiable.
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
    squareness: Mapping[str, tuple[float, float]]
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
    return {k: typical[k] for k in KEYS if k not in declared}


def _missing(assumed: Mapping[str, float]) -> list[Systematic]:
    """Contributions of which at least one key is among these."""
    return [s for s in SYSTEMATIC if set(s.keys) & set(assumed)]


def typical_pulls(runs: Sequence[Observed], joint: JointSolution) -> Array:
    """A^T W c of typical contributions, shape (full, coefficients); see ``systematic_pulls``."""
    assumed = missing_keys(runs)
    tables = tables_of(runs[0].machine, joint.unknowns, joint.solution)
    states = piece_states(typical_runs(runs, assumed), joint, tables) if assumed else []
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
        grid = driven_grid(tables)
        nodes: dict[str, Array] = {m: tables.motions[m].position for m in MOTIONS}
        rows = prediction_rows(tables.machine, nodes, grid)
        free = free_rows(rows.reshape(-1, rows.shape[2]), grid)
        # three components a point: the u of the vector is the root of their sum
        before = 3.0 * np.maximum(np.einsum('ij,ij->i', free @ covariance, free), 0.0).mean()
        after = before + 3.0 * np.mean(np.sum((free @ change) ** 2, axis=1))
    motions: dict[str, Array] = {}
    start = len(SQUARENESS)
    for name in MOTIONS:
        stop = start + len(nodes[name])
        motions[name] = u[start:stop] * float(tables.motions[name].identifiable)
        start = stop
    return TypicalSystematic(
        missing=tuple(s.source for s in sources),
        nothing_declared=len(assumed) == len(KEYS),
        assumed=assumed,
        squareness={
            n: (float(np.sqrt(stated[k])), float(u[k]))
            for k, n in enumerate(SQUARENESS)
            if n in joint.solution.accepted
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
    return {
        'missing': list(typical.missing),
        'presets': list(TYPICAL),
        'assumed': dict(typical.assumed),
        'squareness': {n: {'u': u} for n, (_, u) in typical.squareness.items()},
        'motions': {n: {'u': u.tolist()} for n, u in typical.motions.items()},
        'grid': {'unit': 'm', 'u_stated': typical.grid[0], 'u': typical.grid[1]},
    }
