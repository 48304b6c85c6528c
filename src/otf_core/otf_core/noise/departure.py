# SPDX-License-Identifier: Apache-2.0
"""Does the noise depart from its specification? Levels, colour and tails, with their uncertainty.

What standstills show of a level or time is the logarithm of the fitted value, with its jackknife
uncertainty u (Student's t, one degree of freedom less than groups): so number and length of the
standstills, colour and tails all enter. A level departs where it is above ``MAX_LEVEL_RATIO``
times the specified one and less 2 u still above it; a correlation time where it is above
``SLOW_TIME`` less 2 u; tails where Student's t of few degrees of freedom is the likeliest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from otf_core.arrays import Array
from otf_core.model.machine import TrackerSpec
from otf_core.model.observation import Samples
from otf_core.noise.colour import jackknife_u, left_out_fits
from otf_core.noise.noise_model import TYPICAL_CORRELATION_TIME, NoiseModel
from otf_core.noise.standstill import (
    FREEDOMS,
    MIN_TOTAL,
    SLOW_TIME,
    fast_part,
    find_standstills,
    noise_of_windows,
    quiet_windows,
    student_likelihood,
)

MAX_LEVEL_RATIO = 1.6
"""Actual over specified standard deviation that still passes as specified."""
HEAVY_TAILS = 5.0
"""Degrees of freedom of Student's t below which tails count as heavy."""
MIN_EVIDENCE_OF_TAILS = 3.0
"""Log likelihood of Student's t over that of the normal distribution (95 %)."""
MIN_U_OF_LOGARITHM = 0.01
"""Standard uncertainty of a logarithm at best."""


@dataclass(frozen=True)
class Departure:
    """Properties of the noise against their specification.

    Attributes
    ----------
    level : ndarray, shape (3,)
        Levels of range, horizontal and vertical angle over the specified ones.
    u_level : ndarray, shape (3,)
        Standard uncertainties of their logarithms.
    time, u_time : float
        s, correlation time, and the standard uncertainty of its logarithm.
    freedom : float
        Degrees of freedom of these uncertainties.
    dof : float
        Degrees of freedom of the likeliest Student's t, of all three alike.
    tails : float
        Its log likelihood over that of the normal distribution.
    """

    level: Array
    u_level: Array
    time: float
    u_time: float
    freedom: float
    dof: float
    tails: float

    @property
    def louder(self) -> NDArray[np.bool_]:
        """Which levels are above the specified ones by more than two standard uncertainties."""
        return np.asarray(np.log(self.level) > 2.0 * self.u_level)

    @property
    def loud(self) -> NDArray[np.bool_]:
        """Which levels depart."""
        return self.louder & (self.level > MAX_LEVEL_RATIO)

    @property
    def slow(self) -> bool:
        """Whether the correlation time departs."""
        return bool(np.log(self.time / SLOW_TIME) > 2.0 * self.u_time)

    @property
    def heavy(self) -> bool:
        """Whether the tails depart."""
        return self.dof < HEAVY_TAILS and self.tails > MIN_EVIDENCE_OF_TAILS

    def probability(self, name: str) -> float:
        """Probability that a level is above the specified one, the time above ``SLOW_TIME``."""
        if name == 'dof':
            return float(1.0 / (1.0 + np.exp(-self.tails)))
        if name == 'correlation_time':
            sure = np.log(self.time / SLOW_TIME) / self.u_time
        else:
            own = slice(0, 1) if name == 'level_range' else slice(1, 3)
            sure = np.max(np.log(self.level[own]) / self.u_level[own])
        return float(stdtr(self.freedom, sure))


def simulated_noise(noise: NoiseModel, spec: TrackerSpec) -> NoiseModel:
    """Noise of a run as its simulation has it.

    Levels that pass as specified are those of the run; what is louder has the specified one, so
    that it shows as a gap.
    """
    limits = (spec.u_range, spec.u_angle, spec.u_angle)
    parts = zip(noise, limits, strict=True)
    return NoiseModel(*(c if c.level <= MAX_LEVEL_RATIO * u else c.at_most(u) for c, u in parts))


def noise_departure(samples: Samples, spec: TrackerSpec, speed: float) -> Departure | None:
    """Compare the noise in standstills with its specification.

    Parameters
    ----------
    speed : float
        m/s; slower counts as standstill.

    Returns
    -------
    Departure or None
        None with less than ``MIN_TOTAL`` of standstill: what is long enough to measure the noise
        is long enough to judge it, since the jackknife states how surely. Machines that do not
        stop at corners stand still at the two ends of a run alone.
    """
    runs = find_standstills(samples, speed)
    if len(runs) == 0:
        return None
    windows, _ = quiet_windows(samples, runs)
    step = float(np.median(np.diff(samples.stamp_ns))) * 1e-9
    if sum(len(w) for w in windows) * step < MIN_TOTAL:
        return None
    seen, parts = noise_of_windows(windows, step).noise, left_out_fits(windows, step)
    expected = np.array([spec.u_range, spec.u_angle, spec.u_angle, TYPICAL_CORRELATION_TIME])

    def over_expected(noise: NoiseModel) -> Array:
        time = noise.range.correlation_time or TYPICAL_CORRELATION_TIME
        return np.asarray(np.array([*noise.level, time]) / expected)

    *level, time = over_expected(seen)
    u = jackknife_u(np.log([over_expected(p) for p in parts]))
    u = np.maximum(u, MIN_U_OF_LOGARITHM)
    likelihoods = [student_likelihood(column) for column in fast_part(windows, step).T]
    student, normal = np.sum([s for s, _ in likelihoods], axis=0), sum(n for _, n in likelihoods)
    return Departure(
        level=np.array(level),
        u_level=u[:3],
        time=float(TYPICAL_CORRELATION_TIME * time),
        u_time=float(u[3]),
        freedom=len(parts) - 1.0,
        dof=float(FREEDOMS[np.argmax(student)]),
        tails=float(student.max() - normal),
    )
