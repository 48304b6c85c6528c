# SPDX-License-Identifier: Apache-2.0
"""A specification of the tracker's noise that its samples contradict."""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.contradictions.quick_model import Model
from otf_core.model.observation import Samples
from otf_core.noise.standstill import find_standstills, standstill_noise
from otf_core.pieces.finding import GATE, WARNING, Finding
from otf_core.pieces.runs import Run

ABOVE, BELOW = 5.0, 1.0 / 15.0
"""Measured over specified noise that contradicts: trackers are often better than specified."""
FITS = 0.3
"""Residual over noise below which the noise is smaller than assumed."""
THIRD = np.sqrt(20.0)
"""Standard deviation of the third difference of white noise of unit variance."""
NORMAL_MEDIAN = 0.6745
QUANTILES = (5.0, 85.0)
"""Percentiles of the third differences; corners spoil the uppermost."""
TWO_LEVELS = 30.0
"""Their ratio from which on there are two kinds of samples; normal noise gives 4, Student's t of
three degrees of freedom 10."""
EVEN, FEWEST = 0.25, 100
"""Share by which intervals of stamps may differ from the usual one for differences from sample to
sample to be taken; fewest of these, else all are."""
RASTERS = (1e-3, 1e-4, 1e-5, 1e-6)
"""m; to what recordings are rounded."""
MANY, TOO_MANY = 0.1, 0.3
"""Share of outliers from which on they are named; from which on the result is not relied on."""


def measured_noise(samples: Samples, speed: float) -> tuple[Array, str]:
    """Level of range and two angles: at standstill, else from one sample to the next.

    Returns
    -------
    level : ndarray, shape (3,), m, rad, rad
    where : str
        In words.
    """
    seen = standstill_noise(samples, find_standstills(samples, speed))
    if seen is not None:
        return seen.noise.level, 'at standstill'
    third, middle = _third(samples)
    distance = np.linalg.norm(middle, axis=1)
    along = np.einsum('ij,ij->i', third, middle) / distance
    across = np.linalg.norm(np.cross(middle / distance[:, None], third), axis=1) / distance
    u_range = float(np.median(np.abs(along))) / NORMAL_MEDIAN / THIRD
    u_angle = float(np.median(across)) / 1.1774 / THIRD
    return np.array([u_range, u_angle, u_angle]), 'from sample to sample'


def _third(samples: Samples) -> tuple[Array, Array]:
    """Third differences (m, 3) of samples that follow each other evenly, and their samples, m."""
    third, middle = np.diff(samples.xyz, 3, axis=0), samples.xyz[1:-2]
    step = np.diff(samples.stamp_ns)
    usual = float(np.median(step))
    even = np.abs(step - usual) <= EVEN * usual
    even = even[:-2] & even[1:-1] & even[2:]
    return (third[even], middle[even]) if even.sum() >= FEWEST else (third, middle)


def rounded_to(samples: Samples) -> float:
    """Coarsest of ``RASTERS`` that all coordinates are multiples of, m; 0 if there is none."""
    for step in RASTERS:
        if all(_multiples(part, step) for part in (samples.xyz[:FEWEST], samples.xyz)):
            return step
    return 0.0


def _multiples(values: Array, step: float) -> bool:
    count = values / step
    return bool(np.all(np.abs(count - np.rint(count)) < 0.02))  # 0.01: single precision


def outlying(samples: Samples) -> tuple[float, float]:
    """Share of samples that stand out from noise, and by how much.

    Third differences of noise of one level scatter little; a bad sample spoils four of them.

    Returns
    -------
    share : float
        Zero where they look like noise of one level.
    size : float
        m; median length of what stands out.
    """
    third = np.linalg.norm(_third(samples)[0], axis=1) / THIRD
    low, high = np.percentile(third, QUANTILES)
    if high < TWO_LEVELS * low:
        return 0.0, 0.0
    far = third > np.sqrt(low * high)
    share = 1.0 - (1.0 - float(np.mean(far))) ** 0.25
    return share, float(np.median(third[far]) * THIRD / 3.0)


def _lever(samples: Samples) -> Array:
    """What takes range and two angles to lengths, shape (3,)."""
    distance = float(np.median(np.linalg.norm(samples.xyz, axis=1)))
    return np.array([1.0, distance, distance])


def check_noise_level(model: Model, config: CalibrationConfig) -> list[Finding]:
    """Compare noise as measured and as specified, run by run; said once for all alike."""
    found = [f for run in model.runs if (f := _check(model, run, config)) is not None]
    return found[:1]


def _check(model: Model, run: Run, config: CalibrationConfig) -> Finding | None:
    spec = run.machine.tracker
    level, where = measured_noise(run.recording.samples, config.standstill_speed)
    ratios = level / np.array([spec.u_range, spec.u_angle, spec.u_angle])
    name = f'{run.recording.name}: ' if run.recording.name else ''
    above = max(ratios) > ABOVE
    raster = rounded_to(run.recording.samples) if above else 0.0
    if raster and max(level * _lever(run.recording.samples)) < raster:
        return Finding('rounded', WARNING, (
            f'{name}coordinates are rounded to {1e6 * raster:g} um, more than the noise of the '
            f'tracker; record or export more digits'
        ))  # fmt: skip
    share, size = outlying(run.recording.samples) if above else (0.0, 0.0)
    if share > MANY:
        return Finding('outliers', GATE if share > TOO_MANY else WARNING, (
            f'{name}about {100 * share:.0f} % of the samples are outliers of about '
            f'{1e6 * size:.2g} um; look for reflections, a dirty target or a disturbed beam, and '
            f'record again'
        ))  # fmt: skip
    if above:
        kind = 'larger'
    elif min(ratios) < BELOW and model.fit.ratio < FITS:
        kind = 'smaller'
    else:
        return None
    return Finding('noise', WARNING, (
        f'{name}noise measured {where} is {1e6 * level[0]:.3g} um along the beam, '
        f'{1e6 * level[1]:.3g} urad and {1e6 * level[2]:.3g} urad across, much {kind} than '
        f'u_range {1e6 * spec.u_range:.3g} um and u_angle {1e6 * spec.u_angle:.3g} urad '
        f'of machine.yaml; check the unit there (m and rad), and the tracker'
    ))  # fmt: skip
