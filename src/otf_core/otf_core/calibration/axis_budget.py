# SPDX-License-Identifier: Apache-2.0
"""Uncertainty budget of a machine with rotary axes: that of ``budget``, and places of targets.

What machine.yaml states of the places of targets is prior knowledge like smoothness; what it
leaves in the covariance is a source of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

from otf_core.arrays import Array
from otf_core.budget.budget import PLACES, Budget, make_budget, noise_parts, whole_check
from otf_core.budget.typical import TypicalSystematic, typical_pulls, typical_systematic
from otf_core.effects import State
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.noise.noise_model import Misfit, NoiseModel
from otf_core.pieces.runs import Recording
from otf_core.prediction.volumetric import driven_rows
from otf_core.rotary.axis_solution import AxisSolution, place_equations, tables_of
from otf_core.rotary.reduction import AxisPieces
from otf_core.rotary.rows import piece_state
from otf_core.rotary.tabulation import AxisTables
from otf_core.solving.residuals import ResidualCheck
from otf_core.solving.whitener import NO_MISFIT


@dataclass(frozen=True)
class ObservedParts:
    """Pieces of one run and how they are seen; see ``pieces.runs.Observed``.

    Attributes
    ----------
    machine : Machine
        As set up in this run.
    noise, misfit : NoiseModel, Misfit
        Of single samples, and what the model leaves besides.
    """

    recording: Recording
    machine: Machine
    pieces: AxisPieces
    noise: NoiseModel
    misfit: Misfit = NO_MISFIT

    @property
    def samples(self) -> Samples:
        """Of the whole run."""
        return self.recording.samples

    @property
    def noise_and_misfit(self) -> tuple[NoiseModel, Misfit]:
        """Both."""
        return self.noise, self.misfit


def observed_parts(recordings: Sequence[Recording], joint: AxisSolution) -> list[ObservedParts]:
    """Runs of a solution with their noise as the residuals show it."""
    return [
        ObservedParts(recording, recording.machine, s.run.pieces, s.noise, s.misfit)
        for recording, s in zip(recordings, joint.runs, strict=True)
    ]


def piece_states(
    runs: Sequence[ObservedParts], joint: AxisSolution, nodes: Mapping[str, Array]
) -> list[State]:
    """State of the pieces of every run, with what its machine declares."""
    tables = tables_of(joint.machine, joint.unknowns, joint.solution.value)
    return [
        piece_state(replace(s.run, machine=run.machine), s.system.q, nodes, tables)
        for run, s in zip(runs, joint.runs, strict=True)
    ]


def budget_of_axes(
    runs: Sequence[ObservedParts],
    joint: AxisSolution,
    nodes: Mapping[str, Array],
    speed: float,
    freedom: float,
) -> Budget:
    """Set up the budget of the unknowns of a calibration.

    Parameters
    ----------
    joint : AxisSolution
        Of the same runs.
    nodes : mapping of axis to ndarray, m and rad
    speed : float
        m/s; slower counts as standstill.
    freedom : float
        Number of combinations of the unknowns that the data decide.
    """
    observed, solved = cast(Any, runs), cast(Any, joint)
    residuals = [s.residual for s in joint.runs]
    check = whole_check(observed, solved, residuals)
    size = sum(r.size for r in residuals)
    scale = max(size - joint.solution.rank, 1.0) / max(size - freedom, 1.0)
    return make_budget(
        observed,
        solved,
        noise_parts(observed, solved),
        partial(piece_states, runs, joint, nodes),
        speed,
        ResidualCheck(scale * check.variance_ratio, check.correlation_factor),
        {PLACES: place_equations(joint.machine, joint.unknowns, joint.places).matrix},
    )


def typical_of_axes(
    runs: Sequence[ObservedParts],
    joint: AxisSolution,
    nodes: Mapping[str, Array],
    made: AxisTables,
) -> TypicalSystematic | None:
    """Compute what typical contributions would add; None if everything is declared.

    Parameters
    ----------
    joint : AxisSolution
        Of the same runs.
    nodes : mapping of axis to ndarray, m and rad
    made : AxisTables
        Of the same solution.
    """
    observed, solved = cast(Any, runs), cast(Any, joint)
    pulls = typical_pulls(
        observed, solved, lambda some: piece_states(cast(Any, some), joint, nodes)
    )
    return typical_systematic(
        observed,
        solved,
        made.tables,
        made.rows,
        made.covariance,
        pulls,
        partial(driven_rows, made.tables),
        made.hidden,
    )
