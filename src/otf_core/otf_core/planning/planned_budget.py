# SPDX-License-Identifier: Apache-2.0
"""Systematic contributions in the forecast of a plan: declared ones, and typical ones beside.

The sensitivities are those of the budget, for the pieces that the plan would give.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.systematic import (
    SYSTEMATIC,
    declared_sources,
    piece_states,
    systematic_sensitivities,
)
from otf_core.budget.typical import missing_keys, typical_runs
from otf_core.calibration.headline import Expected
from otf_core.model.declared import KEYS
from otf_core.model.expanded import COVERAGE_FACTOR
from otf_core.model.plan import Plan
from otf_core.model.presets import TYPICAL
from otf_core.model.tables import ErrorTables
from otf_core.pieces.observed import Observed
from otf_core.planning.forecast import Forecast, Setup, grid_uncertainty, tracker_pose
from otf_core.prediction.volumetric import length_sizes
from otf_core.solving.joint import JointSolution, SolvedRun, tables_of
from otf_core.solving.roughness import Roughness
from otf_core.solving.system import build_system
from otf_core.solving.tabulate import table_rows
from otf_core.solving.whitener import Whitener
from otf_core.tracking.curves import straight_shape

Planned = tuple[Observed, JointSolution, ErrorTables]
"""What a plan shows, and solution and tables with zero deviations."""


def planned_solution(plan: Plan, setup: Setup, found: Forecast) -> Planned:
    """What the plan shows, and solution and tables with zero deviations."""
    observed = Observed(
        machine=setup.machine,
        shape=straight_shape(plan.path.points),
        pieces=found.pieces,
        pose=tracker_pose(setup),
        noise=setup.noise,
    )
    return solution_of_pieces(observed, found)


def solution_of_pieces(observed: Observed, found: Forecast) -> Planned:
    """What pieces show, planned or recorded, and solution and tables with zero deviations."""
    machine = observed.machine
    system = build_system(machine, found.pieces, observed.pose, found.unknowns)
    whitener = Whitener.of(system, found.pieces, observed.noise)
    solved = SolvedRun(observed.pose, system, whitener, np.zeros_like(system.deviation))
    nothing = Roughness({}, np.zeros((found.unknowns.free,) * 2), np.zeros((0, 0)), 0.0, 0.0)
    done = JointSolution(found.unknowns, found.solution, nothing, found.normal, (solved,), 1)
    return observed, done, tables_of(machine, found.unknowns, found.solution)


@dataclass(frozen=True)
class PlannedSystematic:
    """Mean uncertainty of the grid vector, rigid motion taken out, by what it contains.

    Attributes
    ----------
    declared, missing : tuple of str
        Contributions as the budget calls them; ``missing``: at least one key is not declared.
    noise, with_declared, with_typical : float
        m, k = 1: of the noise alone; with the declared contributions; with typical values for
        the missing keys too.
    expected : Expected
        Expanded, with all of them: what a calibration would state first.
    """

    declared: tuple[str, ...]
    missing: tuple[str, ...]
    noise: float
    with_declared: float
    with_typical: float
    expected: Expected

    def to_dict(self) -> dict[str, Any]:
        """Entry of plan.json."""
        return {
            'declared': list(self.declared),
            'missing': list(self.missing),
            'typical': list(TYPICAL),
            'mean_grid_u_noise': self.noise,
            'mean_grid_u_with_declared': self.with_declared,
            'mean_grid_u_with_typical': self.with_typical,
            **self.expected.to_dict(),
        }


def planned_systematic(planned: Planned, found: Forecast) -> PlannedSystematic:
    """Forecast the grid with declared contributions, and with typical ones for the others.

    Parameters
    ----------
    planned : tuple of Observed, JointSolution, ErrorTables
        See ``planned_solution``.
    found : Forecast
        Of the same plan.
    """
    run, done, tables = planned
    rows = table_rows(found.unknowns, found.nodes)

    def added(sources: Sequence[Any], runs: Sequence[Observed]) -> Array:
        total = np.zeros_like(found.covariance)
        states = piece_states(runs, done, tables) if sources else []
        for free in systematic_sensitivities(sources, states, done):
            change = rows @ free
            total += change @ change.T
        return total

    def lengths(covariance: Array) -> Array:
        free = grid_uncertainty(run.machine, found.nodes, covariance, found.grid)[1]
        return np.asarray(np.linalg.norm(free, axis=1))

    keys = missing_keys([run])
    missing = [s for s in SYSTEMATIC if set(s.keys) & set(keys)]
    declared = declared_sources([run])
    own = found.covariance + added(declared, [run])
    noise = np.linalg.norm(found.grid_u_free, axis=1)
    stated = lengths(own) if declared else noise
    whole = lengths(own + added(missing, typical_runs([run], keys))) if missing else stated
    expected = Expected(
        expanded=length_sizes(COVERAGE_FACTOR * whole),
        observed=length_sizes(COVERAGE_FACTOR * noise),
        k=COVERAGE_FACTOR,
        assumed=tuple(s.source for s in missing),
        nothing_declared=len(keys) == len(KEYS),
    )
    return PlannedSystematic(
        tuple(s.source for s in declared),
        expected.assumed,
        found.mean_grid_u,
        float(stated.mean()),
        float(whole.mean()),
        expected,
    )
