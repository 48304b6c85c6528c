# SPDX-License-Identifier: Apache-2.0
"""Rows of a calibration of a machine with rotary axes, as the search for effects takes them.

The pieces of the joint solution without reversal, whitened for the noise of the standstills alone;
places of the tracker and of the targets, location errors and motions are projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from otf_core.arrays import Array
from otf_core.calibration.axis_budget import ObservedParts
from otf_core.calibration.axis_calibration import AxisCalibration
from otf_core.diagnosis.engine.gap_sizes import replace_louder
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.model.nodes import table_nodes
from otf_core.noise.noise_model import NoiseComponent, NoiseModel
from otf_core.noise.standstill import noise_model
from otf_core.pieces.runs import Recording
from otf_core.rotary.axis_solution import tables_of
from otf_core.rotary.rows import AxisRows, piece_state
from otf_core.solving.joint import SolvedRun
from otf_core.solving.residuals import fold_of, leg_numbers
from otf_core.solving.solution import free_columns, identifiable_blocks
from otf_core.solving.whitener import Whitener


def rows_of_axes(recordings: Sequence[Recording], result: AxisCalibration) -> Rows:
    """Set up the rows.

    Parameters
    ----------
    recordings : sequence of Recording
    result : AxisCalibration
        Of these recordings, without reversal.
    """
    nodes = table_nodes(result.machine, *result.driven)
    joint, limit = result.solution, result.config.unidentifiable_above
    speed = result.config.standstill_speed
    observed = [
        ObservedParts(
            recording,
            recording.machine,
            solved.run.pieces,
            _at_most(_measured_noise(recording, speed), solved.noise),
        )
        for recording, solved in zip(recordings, joint.runs, strict=True)
    ]
    whiteners = [
        Whitener.of(cast(Any, solved.system), cast(Any, one.pieces), one.noise)
        for solved, one in zip(joint.runs, observed, strict=True)
    ]
    tables = tables_of(joint.machine, joint.unknowns, joint.solution.value)
    seen = identifiable_blocks(joint.normal, joint.unknowns, limit)
    numbers = leg_numbers(cast(Any, joint))
    return Rows(
        observed=cast(Any, tuple(observed)),
        done=cast(Any, joint),
        whiteners=tuple(whiteners),
        tables=tables,
        states=tuple(piece_state(s.run, s.system.q, nodes, tables) for s in joint.runs),
        plain_deviation=np.concatenate([s.system.deviation.reshape(-1) for s in joint.runs]),
        fold=np.concatenate(
            [
                np.tile(fold_of(n), len(s.system.axes))
                for n, s in zip(numbers, joint.runs, strict=True)
            ]
        ),
        limit=limit,
        use=free_columns(joint.unknowns, seen),
    )


def _measured_noise(recording: Recording, speed: float) -> NoiseModel:
    """Noise of the standstills; as specified up to what passes as that."""
    noise = noise_model(recording.samples, recording.machine.tracker, speed)
    return replace_louder(noise, recording, speed)


def _at_most(noise: NoiseModel, seen: NoiseModel) -> NoiseModel:
    """Noise of the standstills, where the residuals of a run do not show less.

    Stops of a second tell its slow part to some ten percent only.
    """
    components = []
    for own, other in zip(noise, seen, strict=True):
        white = min(own.white, other.white)
        slow = min(own.level**2 - own.white**2, other.level**2 - other.white**2)
        time = min(own.correlation_time, other.correlation_time)
        level = float(np.sqrt(white**2 + max(slow, 0.0)))
        components.append(NoiseComponent(level, white, time, own.dof))
    return NoiseModel(*components)


def simulated_um(rows: Rows) -> float:
    """Expected residual that the solution leaves of the noise of the standstills alone, um.

    With A the rows of a run, W the weights and C the covariance of the solution, S the covariance
    of the noise, what is left is (1 - A C A'W) n, and its variances are the diagonal of

        S - 2 A C A'W S + A C (A'W S W A) C A'
    """
    cover, inner = rows.done.solution.covariance, []
    for whitener, solved in zip(rows.whiteners, rows.done.runs, strict=True):
        weighted = solved.whitener.weighted(_dense(solved))
        inner.append(np.einsum('cpi,cpj->ij', weighted, whitener.covaried(weighted)))
    spread = cover @ np.sum(inner, axis=0) @ cover
    square, pieces = 0.0, 0
    for whitener, solved in zip(rows.whiteners, rows.done.runs, strict=True):
        own = _dense(solved)
        noise = whitener.covaried(solved.whitener.weighted(own))
        square += float(np.sum(whitener.expected**2))
        square += float(np.sum(own * (own @ spread)) - 2.0 * np.sum(noise * (own @ cover)))
        pieces += own.shape[1]
    return float(1e6 * np.sqrt(square / pieces))


def _dense(solved: SolvedRun) -> Array:
    """All rows of a run, shape (c, p, full)."""
    rows = cast(AxisRows, solved.system.rows)
    return rows.dense(slice(None))
