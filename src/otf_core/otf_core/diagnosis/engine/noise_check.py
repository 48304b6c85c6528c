# SPDX-License-Identifier: Apache-2.0
"""Is the tracker noisier, slower or heavier-tailed than specified? Judged in standstills."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.diagnosis.engine.rows import Rows
from otf_core.effects import REGISTRY
from otf_core.noise.model import sample_variance
from otf_core.noise.rest import spherical_deviations
from otf_core.noise.standstill import find_standstills, standstill_noise
from otf_core.noise.tails import student_freedom
from otf_core.pieces.runs import Run

LEVEL = 1.6
"""Measured over specified standard deviation that still passes as specified."""
SLOW = 1.0
"""s; correlation times of recorded trackers reach it in the calmest air (docs/noise.md)."""
HEAVY = 5.0
"""Degrees of freedom of Student's t below which tails count as heavy."""
ENOUGH = 30
"""Standstills needed for a judgement."""


@dataclass(frozen=True)
class NoiseFinding:
    """Noise other than specified.

    Attributes
    ----------
    parameters : dict
        Of the effect ``tracker_noise``: what departs from the specification.
    variance_ratio : float
        Mean variance of the rows with the measured levels over that with the specified ones.
    words : str
    """

    parameters: dict[str, float]
    variance_ratio: float
    words: str


def _freedom(run: Run, speed: float) -> float | None:
    """Degrees of freedom of the tails over all standstills, from successive differences."""
    parts = []
    for first, last in find_standstills(run.recording.samples, speed):
        deviations = spherical_deviations(run.recording.samples.xyz[first:last])
        step = np.diff(deviations, axis=0)[::2]
        parts.append(step)
    if len(parts) < ENOUGH:
        return None
    steps = np.concatenate(parts)
    scaled = (steps / np.median(np.abs(steps), axis=0)).reshape(-1)
    return student_freedom(scaled)


def check_noise(rows: Rows, speed: float, exclude: Sequence[str] = ()) -> NoiseFinding | None:
    """Compare the noise in standstills with machine.yaml; None if it is as specified."""
    if 'tracker_noise' in exclude or 'tracker_noise' not in REGISTRY:
        return None
    found: dict[str, float] = {}
    words: list[str] = []
    for run in rows.runs:
        samples, spec = run.recording.samples, run.machine.tracker
        seen = standstill_noise(samples, find_standstills(samples, speed))
        if seen is None or seen.windows < ENOUGH:
            continue
        levels = {
            'level_range': float(seen.noise.level[0]) / spec.u_range,
            'level_angle': float(np.sqrt(np.mean(seen.noise.level[1:] ** 2))) / spec.u_angle,
        }
        for key, level in levels.items():
            if level > LEVEL:
                found[key] = level
                words.append(f'{key[6:]} noise {level:.2f} times as specified')
        time = seen.noise.range.correlation_time
        if time > SLOW:
            found['correlation_time'] = time
            words.append(f'correlated over {time:.1f} s')
        freedom = _freedom(run, speed)
        if freedom is not None and freedom < HEAVY:
            found['dof'] = max(freedom, 2.2)
            words.append(f"heavy tails (Student's t, {freedom:.1f} degrees of freedom)")
    if not found:
        return None
    return NoiseFinding(found, _variance_ratio(rows), '; '.join(dict.fromkeys(words)))


def _variance_ratio(rows: Rows) -> float:
    measured, specified = 0.0, 0.0
    for run, solved in zip(rows.runs, rows.done.runs, strict=True):
        shares = solved.system.shares
        measured += float(sample_variance(run.noise, shares).sum())
        spec = run.noise.at_most(run.machine.tracker)
        specified += float(sample_variance(spec, shares).sum())
    return measured / specified
