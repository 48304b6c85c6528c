# SPDX-License-Identifier: Apache-2.0
"""Rows of a calibration of a machine with rotary axes, as the search for effects takes them.

The pieces of the joint solution without reversal, whitened for the noise of the standstills alone;
places of the tracker and of the targets, location errors and motions are projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from scipy import linalg

from otf_core.arrays import Array
from otf_core.calibration.calibrate import SolvedRecordings
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.residual_rows import NOISE_RANGE, Rows
from otf_core.noise.noise_model import NoiseModel
from otf_core.noise.standstill import (
    MIN_TOTAL,
    find_standstills,
    level_scatter,
    noise_model,
    standstill_noise,
)
from otf_core.pieces.runs import Recording
from otf_core.solving.joint import SolvedRun, tables_of
from otf_core.solving.residuals import fold_of, leg_numbers
from otf_core.solving.sensitivity import piece_state
from otf_core.solving.solution import free_columns, identifiable_blocks
from otf_core.solving.whitener import Whitener


def rows_of_axes(found: SolvedRecordings, config: CalibrationConfig) -> Rows:
    """Set up the rows of recordings that were solved without reversal."""
    joint, nodes = found.solution.joint, found.nodes
    recordings = [run.recording for run in found.solution.runs]
    limit, speed = config.unidentifiable_above, config.rest_speed
    observed = [
        replace(
            solved.run,
            machine=recording.machine,
            noise=_floor(recording, speed, solved),
            fitted=None,
        )
        for recording, solved in zip(recordings, joint.runs, strict=True)
    ]
    whiteners = [
        Whitener.of(cast(Any, solved.system), cast(Any, one.pieces), one.noise)
        for solved, one in zip(joint.runs, observed, strict=True)
    ]
    tables = tables_of(joint.machine, joint.unknowns, joint.solution)
    seen = identifiable_blocks(joint.normal, joint.unknowns, limit)
    numbers = leg_numbers(cast(Any, joint))
    return Rows(
        observed=cast(Any, tuple(observed)),
        done=cast(Any, joint),
        whiteners=tuple(whiteners),
        tables=tables,
        states=tuple(piece_state(s.run, s, nodes, tables) for s in joint.runs),
        plain_deviation=np.concatenate([s.system.deviation.reshape(-1) for s in joint.runs]),
        fold=np.concatenate(
            [
                np.tile(fold_of(n), len(s.system.axes))
                for n, s in zip(numbers, joint.runs, strict=True)
            ]
        ),
        limit=limit,
        use=free_columns(joint.unknowns, seen),
        noise_range=_noise_range(recordings, speed),
    )


def _noise_range(recordings: Sequence[Recording], speed: float) -> tuple[float, float]:
    """Variances over those of the standstills; the wider, the less standstill there is."""
    low, high = NOISE_RANGE
    for samples in (r.samples for r in recordings):
        still = float(np.diff(find_standstills(samples, speed), axis=1).sum()) * samples.step
        high = max(high, level_scatter(max(still, MIN_TOTAL)) ** 2)
    return low, high


def _floor(recording: Recording, speed: float, solved: SolvedRun) -> NoiseModel:
    """Noise that the simulation of a recording has.

    That of the standstills where they are louder than specified, however little; or less where all
    that the residuals hold is less: stops of a second tell the slow part to some ten percent only.
    """
    samples, spec = recording.samples, recording.machine.tracker
    runs = find_standstills(samples, speed)
    mean = float(np.mean(runs[:, 1] - runs[:, 0])) * samples.step if len(runs) else 0.0
    noise, measured = noise_model(samples, spec, speed), standstill_noise(samples, runs)
    if measured is not None:
        pairs = zip(noise, measured.noise, strict=True)
        noise = NoiseModel(*(max(pair, key=lambda c: c.level) for pair in pairs))
    fitted = solved.run.noise_and_misfit[0]
    noise = with_slow_part(noise, fitted, mean)
    expected = Whitener.of(cast(Any, solved.system), cast(Any, solved.run.pieces), noise).expected
    less = np.sum(solved.whitener.expected**2) < np.sum(expected**2)
    return at_most(noise, fitted) if less else noise


def with_slow_part(noise: NoiseModel, fitted: NoiseModel, length: float) -> NoiseModel:
    """Noise of standstills with the correlation time that they are too short to show.

    A stop hides correlation over more than its length (s): up to that, the time is the fitted
    one, which comes from pieces of lines that are longer than any stop.
    """
    pairs = zip(noise, fitted, strict=True)
    times = [(own, min(f.correlation_time, max(own.correlation_time, length))) for own, f in pairs]
    return NoiseModel(*(replace(own, correlation_time=time) for own, time in times))


def at_most(noise: NoiseModel, fitted: NoiseModel) -> NoiseModel:
    """Noise of standstills, with variances of fitted noise where these are smaller."""
    components = []
    for own, other in zip(noise, fitted, strict=True):
        white = min(own.white, other.white)
        level = float(np.hypot(white, min(own.slow, other.slow)))
        components.append(replace(own, level=level, white=white))
    return NoiseModel(*components)


def simulated_um(rows: Rows) -> float:
    """Expected residual that tables and poses leave of the noise of the standstills alone, um.

    With A the rows of a run, S the covariance of the noise, R what is known before the data and
    N = A'S^-1 A + R, the variances of what is left (``Rows.left``) are the diagonal of

        S - A (N^-1 + N^-1 R N^-1) A'
    """
    inverse = linalg.cho_solve((rows.factor, True), np.eye(len(rows.use)))
    scale = rows.done.unknowns.gauge[:, rows.use] * rows.limit
    followed = scale @ (inverse + inverse @ rows.ridge @ inverse) @ scale.T
    square, pieces = 0.0, 0
    for whitener, solved in zip(rows.whiteners, rows.done.runs, strict=True):
        own = _dense(solved)
        square += float(np.sum(whitener.expected**2)) - float(np.sum(own * (own @ followed)))
        pieces += own.shape[1]
    return float(1e6 * np.sqrt(square / pieces))


def _dense(solved: SolvedRun) -> Array:
    """All rows of a run, shape (c, p, full)."""
    return solved.system.rows.dense(slice(None))
