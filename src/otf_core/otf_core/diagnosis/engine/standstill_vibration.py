# SPDX-License-Identifier: Apache-2.0
"""Noise of the tracker, where a vibration shakes the target in its standstills as well.

Levels and colour of the noise are those of the standstills of a run. What swings there looks like
louder noise that is gone after a fraction of its period: the slow part of the noise is then taken
for a gap, and the tracker for louder than specified. So once a steady vibration is found, it is
taken off the samples, and the noise is measured again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.noise_check import with_measured_noise
from otf_core.diagnosis.engine.residual_rows import Rows, build_rows
from otf_core.diagnosis.engine.search import Cause, fit_jointly, places_of
from otf_core.effects.applied_effect import AppliedEffect
from otf_core.effects.free_form import FreeForm
from otf_core.effects.state import state_of_travel
from otf_core.model.observation import Samples
from otf_core.noise.noise_model import NoiseModel
from otf_core.noise.standstill import noise_model
from otf_core.pieces.runs import Run

SHORTEST = 1e-3
"""s; a shorter correlation time is none."""
OTHER_LEVEL, OTHER_TIME = 1.1, 1.5
"""Factors on level and correlation time from which on noise is another one."""


def remove_steady_vibration(
    rows: Rows, causes: Sequence[Cause], config: CalibrationConfig
) -> Rows | None:
    """Rows with the noise of standstills less the steady vibrations found; None if it is the same.

    The samples of their runs are without these vibrations, the pieces still hold them.
    """
    if not rows.runs or not any(_is_steady(c) for c in causes):
        return None
    value, places = fit_jointly(causes, rows).value, places_of(causes)
    pairs = zip(causes, places, strict=True)
    found = [_applied(cause, value[own]) for cause, own in pairs if _is_steady(cause)]
    calm = [
        remeasure_noise(run, found, solved.pose.rotation, config)
        for run, solved in zip(rows.runs, rows.done.runs, strict=True)
    ]
    if all(_same(one.noise, run.noise) for one, run in zip(calm, rows.runs, strict=True)):
        return None
    return build_rows(calm, rows.done, rows.limit)


def _is_steady(cause: Cause) -> bool:
    """Tell whether a cause swings all the time: at rest as well."""
    effect = cause.option.effect
    return effect.wave is not None and effect.wave.in_time and not isinstance(effect, FreeForm)


def _applied(cause: Cause, value: Array) -> AppliedEffect:
    option = cause.option
    names = [option.terms.names[k] for k in option.take]
    parameters = dict(zip(names, value.tolist(), strict=True))
    return AppliedEffect(option.effect, {**option.shape, **parameters})


def remeasure_noise(
    run: Run, found: Sequence[AppliedEffect], rotation: Array, config: CalibrationConfig
) -> Run:
    """Return a run with samples that do not swing, and the noise of their standstills.

    ``rotation`` turns tracker coordinates to those of the machine.
    """
    samples, speed = _without(run.samples, run, found, rotation), config.standstill_speed
    noise = noise_model(samples, run.machine.tracker, speed)
    return with_measured_noise(replace(run, samples=samples, noise=noise), speed)


def _without(
    samples: Samples, run: Run, found: Sequence[AppliedEffect], rotation: Array
) -> Samples:
    """Samples less what swings."""
    nothing = np.zeros((len(samples), 3))
    state = state_of_travel(run.machine, nothing, nothing)
    state = replace(state, time=(samples.stamp_ns - samples.stamp_ns[0]) * 1e-9)
    moved = sum((one.effect.displacement(state, one.parameters) for one in found), nothing)
    return replace(samples, xyz=samples.xyz - moved @ rotation)


def _same(one: NoiseModel, other: NoiseModel) -> bool:
    """Tell whether two noises are alike."""
    pairs = list(zip(one, other, strict=True))
    levels = [abs(np.log(a.level / b.level)) for a, b in pairs]
    times = [_factor(a.correlation_time, b.correlation_time) for a, b in pairs]
    return bool(max(levels) < np.log(OTHER_LEVEL) and max(times) < np.log(OTHER_TIME))


def _factor(one: float, other: float) -> float:
    """Size of the logarithm of a ratio of times, either of which may be 0 for white noise."""
    return abs(float(np.log(max(one, SHORTEST) / max(other, SHORTEST))))
