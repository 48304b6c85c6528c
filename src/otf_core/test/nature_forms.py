# SPDX-License-Identifier: Apache-2.0
"""Forms of error motions that know nothing of tables: random curves over an axis.

Every form draws a curve of unit size (peak about 1) over 0 <= s <= 1, the share of the range. A
curve is held as points so dense (1/4000 of the range) that straight lines between them are off by
less than a nanometre at 60 um; 'polygon' is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

DENSE = 4001
GAUSS_POINTS = 161
"""Points at which a Gaussian process is drawn; a cubic spline runs through them."""


@dataclass(frozen=True)
class Curve:
    """One error motion over its axis: ``position`` in m, ``value`` in m or rad, both (k,).

    ``length`` is the correlation length in m of a 'matern' curve, ``deviation`` its standard
    deviation in the unit of the value; nan for other forms.
    """

    position: np.ndarray
    value: np.ndarray
    length: float = np.nan
    deviation: float = np.nan

    def __call__(self, q):
        """Error at axis positions q, any shape, m."""
        return np.interp(q, self.position, self.value)


def matern(distance, length):
    """Correlation of the Matern process with nu = 5/2."""
    r = np.sqrt(5.0) * np.abs(distance) / length
    return (1.0 + r + r * r / 3.0) * np.exp(-r)


def _waves(rng, s, shortest=1.4):
    curve = rng.normal() * 0.5 * (s - 0.5)
    for k in range(1, 5):
        waves = 0.5 * k * rng.uniform(shortest - 0.6, shortest)
        curve = curve + 0.55 / k * np.sin(2 * np.pi * (waves * s + rng.uniform()))
    return curve


def _swell(rng, s):
    return _waves(rng, s, shortest=1.0)


def _bumps(rng, s):
    curve = rng.normal() * 0.5 * (s - 0.5)
    for _ in range(4):
        width = rng.uniform(0.06, 0.2)
        curve = curve + 0.5 * rng.normal() * np.exp(-0.5 * ((s - rng.uniform()) / width) ** 2)
    return curve + 0.35 * rng.normal() * np.tanh((s - rng.uniform(0.2, 0.8)) / 0.06)


def _chirp(rng, s):
    first, last = rng.uniform(0.3, 0.8), rng.uniform(2.0, 3.5)
    phase = first * s + 0.5 * (last - first) * s * s
    if rng.uniform() < 0.5:
        phase = phase[::-1]
    return 0.5 * np.sin(2 * np.pi * (phase + rng.uniform())) + rng.normal() * 0.5 * (s - 0.5)


def _kinked(rng, s):
    curve = 0.6 * rng.normal() * (s - 0.5)
    for k in range(1, 4):
        waves = 0.5 * k * rng.uniform(0.8, 1.2)
        curve = curve + 0.4 / k * np.sin(2 * np.pi * (waves * s + rng.uniform()))
    for low, high in ((0.15, 0.45), (0.55, 0.85)):
        at = np.round(rng.uniform(low, high) * (DENSE - 1)) / (DENSE - 1)
        curve = curve + 2.0 * rng.choice((-1, 1)) * rng.uniform(0.4, 1.0) * np.maximum(s - at, 0)
    return curve - curve.mean()


def _legendre(rng, s):
    weights = np.array([0.0, 0.5, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15]) * rng.standard_normal(8)
    return np.polynomial.legendre.legval(2 * s - 1, weights)


SMOOTH_FORMS = {
    'waves': _waves,
    'swell': _swell,
    'bumps': _bumps,
    'chirp': _chirp,
    'kinked': _kinked,
    'legendre': _legendre,
}
FORMS = (*SMOOTH_FORMS, 'matern', 'polygon')


def nodes_of(low, high, pitch):
    """Table nodes of docs/conventions.md: from low in steps of the pitch, the last at high."""
    nodes = np.arange(low, high - 1e-6 * pitch, pitch)
    return np.append(nodes, high)


def draw_curve(rng, form, low, high, size, pitch):
    """Draw one error motion of the given form and size over [low, high]; a ``Curve``."""
    s = np.linspace(0.0, 1.0, DENSE)
    q = low + s * (high - low)
    if form == 'polygon':
        nodes = nodes_of(low, high, pitch)
        share = (nodes - low) / (high - low)
        value = _waves(rng, share) + 0.05 * rng.standard_normal(len(nodes))
        return Curve(nodes, size * value)
    if form == 'matern':
        length, deviation = rng.uniform(0.1, 0.4), 0.5
        coarse = np.linspace(0.0, 1.0, GAUSS_POINTS)
        root = np.linalg.cholesky(
            matern(coarse[:, None] - coarse, length) + 1e-10 * np.eye(GAUSS_POINTS)
        )
        value = CubicSpline(coarse, deviation * (root @ rng.standard_normal(GAUSS_POINTS)))(s)
        return Curve(q, size * value, length * (high - low), size * deviation)
    return Curve(q, size * SMOOTH_FORMS[form](rng, s))
