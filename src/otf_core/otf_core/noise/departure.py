# SPDX-License-Identifier: Apache-2.0
"""Does the noise depart from its specification? Levels, colour and tails, each with odds.

Two hypotheses share the evidence for each property. As specified: its logarithm is normal about
that of the specified (for the correlation time: the typical) value, the limit being two standard
deviations away. Otherwise: it lies between the limit and ``MAX_LIMIT_FACTOR`` limits, all
logarithms alike. What standstills show of a level or time is the logarithm of the fitted value,
with its jackknife uncertainty (Student's t, one degree of freedom less than groups): so number and
length of the standstills, colour and tails all enter. Tails have the likelihood of Student's t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, logsumexp, stdtr

from otf_core.arrays import Array
from otf_core.model.machine import TrackerSpec
from otf_core.model.observation import Samples
from otf_core.noise.colour import jackknife_u, left_out_fits
from otf_core.noise.noise_model import TYPICAL_CORRELATION_TIME, NoiseModel
from otf_core.noise.standstill import (
    FREEDOMS,
    MIN_TOTAL,
    fast_part,
    find_standstills,
    noise_of_windows,
    quiet_windows,
    student_likelihood,
)

MAX_LEVEL_RATIO = 1.6
"""Actual over specified standard deviation that still passes as specified."""
SLOW_TIME = 1.0
"""s; correlation times of recorded trackers reach it in the calmest air (docs/noise.md)."""
HEAVY_TAILS = 5.0
"""Degrees of freedom of Student's t below which tails count as heavy."""
MAX_LIMIT_FACTOR = 10.0
"""Factor on a limit beyond which nothing is expected."""
MIN_U_OF_LOGARITHM = 0.01
"""Standard uncertainty of a logarithm at best."""


@dataclass(frozen=True)
class Departure:
    """A property of the noise against its specification.

    Attributes
    ----------
    level : ndarray, shape (3,)
        Levels of range, horizontal and vertical angle over the specified ones.
    least : ndarray, shape (3,)
        The same, lower ends of intervals of two standard uncertainties.
    time : float
        s, correlation time.
    dof : float
        Degrees of freedom of the likeliest Student's t, of all three alike.
    of_level : ndarray, shape (3,)
        Probability that each level is beyond its limit.
    of_time, of_dof : float
        The same of correlation time and tails.
    """

    level: Array
    least: Array
    time: float
    dof: float
    of_level: Array
    of_time: float
    of_dof: float


def probability_beyond(seen: float, u: float, limit: float, freedom: float) -> float:
    """Probability that a quantity is beyond its limit; even odds before anything is seen.

    Parameters
    ----------
    seen : float
        Measured over specified value; what is below 1 or above ``MAX_LIMIT_FACTOR`` limits counts
        as these.
    u : float
        Standard uncertainty of its logarithm.
    limit : float
        Where the departure begins, above 1.
    freedom : float
        Degrees of freedom of ``u``.
    """
    edge, end = float(np.log(limit)), float(np.log(MAX_LIMIT_FACTOR * limit))
    at, u, spread = float(np.clip(np.log(seen), 0.0, end)), max(u, MIN_U_OF_LOGARITHM), 0.5 * edge
    # means of the likelihood over both priors
    y = np.arange(-5.0 * spread, end, 0.2 * MIN_U_OF_LOGARITHM)
    prior, seen_at = np.exp(-0.5 * (y / spread) ** 2), _student_density((y - at) / u, freedom) / u
    specified = float(np.sum(prior * seen_at) / np.sum(prior))
    inside = np.diff(stdtr(freedom, (np.array([edge, end]) - at) / u))[0]
    beyond = float(inside) / (end - edge)
    return beyond / (beyond + specified)


def _student_density(t: Array, freedom: float) -> Array:
    """Density of Student's t; ``scipy.stats`` has it too, and takes 0.4 s to import."""
    half = 0.5 * freedom
    size = np.exp(gammaln(half + 0.5) - gammaln(half)) / np.sqrt(freedom * np.pi)
    return np.asarray(size * (1.0 + t**2 / freedom) ** -(half + 0.5))


def _tails(windows: list[Array], step: float) -> tuple[float, float]:
    """Likeliest degrees of freedom, and probability that they are below ``HEAVY_TAILS``."""
    likelihoods = [student_likelihood(column) for column in fast_part(windows, step).T]
    student, normal = np.sum([s for s, _ in likelihoods], axis=0), sum(n for _, n in likelihoods)
    heavy = FREEDOMS < HEAVY_TAILS
    beyond = logsumexp(student[heavy]) - np.log(heavy.sum())
    specified = logsumexp([*student[~heavy], normal]) - np.log(1 + (~heavy).sum())
    return float(FREEDOMS[np.argmax(student)]), float(1.0 / (1.0 + np.exp(specified - beyond)))


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
    *level, time = _over_specified(seen, spec)
    freedom, limits = (
        len(parts) - 1.0,
        [MAX_LEVEL_RATIO] * 3 + [SLOW_TIME / TYPICAL_CORRELATION_TIME],
    )
    u = jackknife_u(np.log([_over_specified(p, spec) for p in parts]))
    *of_level, of_time = (
        probability_beyond(float(v), float(s), limit, freedom)
        for v, s, limit in zip((*level, time), u, limits, strict=True)
    )
    dof, of_dof = _tails(windows, step)
    time *= TYPICAL_CORRELATION_TIME
    least = np.array(level) * np.exp(-2.0 * u[:3])
    return Departure(np.array(level), least, float(time), dof, np.array(of_level), of_time, of_dof)


def _over_specified(noise: NoiseModel, spec: TrackerSpec) -> Array:
    """Three levels over the specified ones, and the correlation time over the typical one."""
    time = noise.range.correlation_time or TYPICAL_CORRELATION_TIME
    expected = [spec.u_range, spec.u_angle, spec.u_angle, TYPICAL_CORRELATION_TIME]
    return np.array([*noise.level, time]) / expected
