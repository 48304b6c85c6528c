# SPDX-License-Identifier: Apache-2.0
"""Is the tracker noisier, slower or heavier-tailed than specified? Judged in standstills."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.effects import REGISTRY, Effect
from otf_core.effects.catalogue.tracker_noise import TrackerNoise
from otf_core.noise.departure import Departure, as_simulated, noise_departure
from otf_core.noise.noise_model import QUANTITIES, NoiseModel, sample_variance
from otf_core.noise.standstill import find_standstills, standstill_noise
from otf_core.pieces.runs import Run

NAMED = 0.5
"""Probability from which on a departure is named: the more likely of two."""
SURE = 0.95
"""The same of slow noise: it makes no gap, as the simulation has the colour of the run's own
standstills, so nothing calls for a name."""
SLOW, CORRELATED = 'correlation_time', 'correlated over'
"""Slow noise as a parameter of the effect, and in words."""


@dataclass(frozen=True)
class NoiseFinding:
    """Noise other than specified.

    Attributes
    ----------
    parameters : dict
        Of the effect: what departs from the specification.
    confidence : float
        Probability of what departs most clearly; see ``noise.departure``.
    variance_ratio : float
        Mean variance of the rows with the measured levels over that with the specified ones.
    """

    parameters: dict[str, float]
    confidence: float
    variance_ratio: float
    words: str

    @property
    def level(self) -> float:
        """Mean standard deviation over the specified one."""
        return float(np.sqrt(self.variance_ratio))

    @property
    def effect(self) -> Effect:
        """The effect that stands for it."""
        return REGISTRY[TrackerNoise.name]


def _parameters(seen: Departure) -> dict[str, tuple[float, float]]:
    """Value and probability of every parameter of the effect."""
    # the effect has one factor for both angles
    angle = float(np.sqrt(np.mean(seen.level[1:] ** 2)))
    return {
        'level_range': (float(seen.level[0]), float(seen.of_level[0])),
        'level_angle': (angle, float(seen.of_level[1:].max())),
        'correlation_time': (seen.time, seen.of_time),
        'dof': (seen.dof, seen.of_dof),
    }


def _words(seen: Departure) -> list[str]:
    found = [
        f'noise of the {name} {level:.2f} times as specified'
        for name, level, p in zip(QUANTITIES, seen.level, seen.of_level, strict=True)
        if p > NAMED
    ]
    if seen.of_time > SURE:
        found.append(f'{CORRELATED} {seen.time:.1f} s')
    if seen.of_dof > NAMED:
        found.append(f"heavy tails (Student's t, {seen.dof:.1f} degrees of freedom)")
    return found


def check_noise(
    rows: Rows, speed: float, exclude: Sequence[str] = (), *, gap: bool = True
) -> NoiseFinding | None:
    """Compare the noise in standstills with machine.yaml; None if it is as specified.

    Without a ``gap``, and no louder than specified, only slow noise is looked for: the simulation
    has the colour of the run's own standstills, so slow noise makes no gap. Tails are of no
    consequence then.
    """
    gap = gap or any(np.any(run.noise.level > _specified(run)) for run in rows.runs)
    if TrackerNoise.name in exclude or TrackerNoise.name not in REGISTRY:
        return None
    found: dict[str, tuple[float, float]] = {}
    words: list[str] = []
    for run in rows.runs:
        seen = noise_departure(run.recording.samples, run.machine.tracker, speed)
        if seen is None:
            continue
        for name, (value, probability) in _parameters(seen).items():
            if not gap and name != SLOW:
                continue
            least = SURE if name == SLOW else NAMED
            if probability > max(least, found.get(name, (0.0, 0.0))[1]):
                found[name] = (value, probability)
        words += [w for w in _words(seen) if gap or w.startswith(CORRELATED)]
    if not found:
        return None
    return NoiseFinding(
        {name: value for name, (value, _) in found.items()},
        max(probability for _, probability in found.values()),
        _variance_ratio(rows),
        '; '.join(dict.fromkeys(words)),
    )


def with_measured_noise(run: Run, speed: float) -> Run:
    """Return a run with the noise of its standstills where that is clearly louder than specified.

    Up to ``noise.departure.LEVEL`` it passes as specified, and a solution takes it as specified;
    but what is left of a gap has to be compared with the noise that was there.
    """
    samples = run.recording.samples
    seen = noise_departure(samples, run.machine.tracker, speed)
    measured = standstill_noise(samples, find_standstills(samples, speed))
    if seen is None or measured is None:
        return run
    parts = zip(run.noise, measured.noise, seen.least > 1.0, strict=True)
    return replace(run, noise=NoiseModel(*(own if loud else old for old, own, loud in parts)))


def _specified(run: Run) -> Array:
    tracker = run.machine.tracker
    return np.array([tracker.u_range, tracker.u_angle, tracker.u_angle])


def _variance_ratio(rows: Rows) -> float:
    measured, specified = 0.0, 0.0
    for run, solved in zip(rows.runs, rows.done.runs, strict=True):
        shares = solved.system.shares
        measured += float(sample_variance(run.noise, shares).sum())
        spec = as_simulated(run.noise, run.machine.tracker)
        specified += float(sample_variance(spec, shares).sum())
    return measured / specified
