# SPDX-License-Identifier: Apache-2.0
"""Model of the tracker noise: from range and angle noise of samples to the covariance of pieces.

Along the beam acts the noise of the range, across it the noise of two angles times the range
(paper Eq. 8-10, derived anew in docs/formulation.md since Eq. 4 prints the path direction where
the beam direction belongs). Samples are not independent: each of range and two angles has a white
part and a part that is correlated in time (first-order Gauss-Markov). ``NoiseModel`` is what
specification, standstills, noise.json, simulator and weights share.

In noise.json ``u_range``, ``u_angle`` and ``white_range``, ``white_angle`` are standard
deviations, of both angles in the order horizontal, vertical; ``correlation_time`` is one number,
or three where range and angles differ; ``tails`` holds degrees of freedom by quantity.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import read_json, value_text
from otf_core.model.frames import RigidTransform, beam_frame
from otf_core.model.machine import TrackerSpec

Windows = tuple[Array, Array, Index]
"""Mean time, duration (s) and number of samples of pieces."""

QUANTITIES = ('range', 'horizontal angle', 'vertical angle')
TYPICAL_WHITE_SHARE = 0.5
TYPICAL_CORRELATION_TIME = 0.3
"""Taken where a run has too little standstill to show it: real trackers show 0.1 s to 0.5 s."""


MODEL_FLOOR = 5e-8
"""m; independent uncertainty of every piece at least: tables are not better than that."""
MISFIT_TIME = 3.0
"""s; about a line of the path."""


@dataclass(frozen=True)
class NoiseComponent:
    """Noise of the range or of one angle, in single samples.

    Attributes
    ----------
    level : float
        m or rad, total standard deviation over a second or more.
    white : float
        m or rad, standard deviation of the part that is independent from sample to sample.
    correlation_time : float
        s, of the rest; zero where there is none.
    dof : float, optional
        Degrees of freedom of Student's t that the white part follows; None: normal.
    """

    level: float
    white: float
    correlation_time: float = TYPICAL_CORRELATION_TIME
    dof: float | None = None

    @property
    def white_share(self) -> float:
        """Share of the variance that is independent from sample to sample."""
        return (self.white / self.level) ** 2 if self.level > 0 else 1.0

    @property
    def slow(self) -> float:
        """Standard deviation of the part that is correlated in time, m or rad."""
        return math.sqrt(max(self.level**2 - self.white**2, 0.0))

    def times(self, white: float, slow: float, time: float) -> NoiseComponent:
        """Return the noise with factors on both variances and on the correlation time."""
        own, rest = self.white**2 * white, self.slow**2 * slow
        return NoiseComponent(
            math.sqrt(own + rest), math.sqrt(own), self.correlation_time * time, self.dof
        )

    def at_most(self, level: float) -> NoiseComponent:
        """Return the same noise, no louder than a level."""
        factor = min(1.0, level / self.level) if self.level > 0 else 1.0
        return replace(self, level=self.level * factor, white=self.white * factor)


@dataclass(frozen=True)
class NoiseModel:
    """Noise of single samples: range and two angles, independent of each other.

    Attributes
    ----------
    range : NoiseComponent
        m, along the beam.
    horizontal, vertical : NoiseComponent
        rad, of the beam itself about the two axes across it (``frames.beam_frame``).
    """

    range: NoiseComponent
    horizontal: NoiseComponent
    vertical: NoiseComponent

    @classmethod
    def from_spec(
        cls,
        spec: TrackerSpec,
        white_share: float = TYPICAL_WHITE_SHARE,
        correlation_time: float = TYPICAL_CORRELATION_TIME,
    ) -> NoiseModel:
        """Levels as specified in machine.yaml, colour as typical if not given, no tails."""
        parts = [
            NoiseComponent(u, u * math.sqrt(white_share), correlation_time)
            for u in (spec.u_range, spec.u_angle)
        ]
        return cls(parts[0], parts[1], parts[1])

    def __iter__(self) -> Iterator[NoiseComponent]:
        """Range, horizontal angle, vertical angle."""
        return iter((self.range, self.horizontal, self.vertical))

    @property
    def level(self) -> Array:
        """Total standard deviations, shape (3,), m, rad, rad."""
        return np.array([c.level for c in self])

    @property
    def white(self) -> Array:
        """Standard deviations of the white parts, shape (3,), m, rad, rad."""
        return np.array([c.white for c in self])

    def __str__(self) -> str:
        """Return the components in words."""
        return '; '.join(
            f'{name} {1e6 * c.level:.2f} {unit}, {100 * c.white_share:.0f} % white'
            + (f', rest over {c.correlation_time:.2f} s' if c.slow else '')
            + (f", tails of Student's t({c.dof:.0f})" if c.dof else '')
            for name, unit, c in zip(QUANTITIES, ('um', 'urad', 'urad'), self, strict=True)
        )


@dataclass(frozen=True)
class Misfit:
    """What the model leaves besides the noise of the tracker, alike in all directions.

    Attributes
    ----------
    independent : float
        m, of every piece on its own.
    slow : float
        m, correlated over ``MISFIT_TIME``: shared by the pieces of a line.
    """

    independent: float = MODEL_FLOOR
    slow: float = 0.0


WHITE, SLOW, TIME, INDEPENDENT, LASTING = range(5)
"""Places of five logarithms: factors on the white and on the slow variance of the tracker's noise,
its correlation times, variances of the misfit (m^2)."""


def scale_noise(noise: NoiseModel, logs: Array) -> NoiseModel:
    """Noise with its white and slow variances and its correlation times multiplied."""
    white, slow, time = (float(f) for f in np.exp(logs[:INDEPENDENT]))
    return NoiseModel(*(c.times(white, slow, time) for c in noise))


def misfit_of(logs: Array) -> Misfit:
    """Misfit for the logarithms of its variances."""
    return Misfit(float(np.exp(0.5 * logs[INDEPENDENT])), float(np.exp(0.5 * logs[LASTING])))


def noise_and_misfit(noise: NoiseModel, fitted: Array | None) -> tuple[NoiseModel, Misfit]:
    """Noise of single samples, and what a model leaves besides, for logarithms that were fitted.

    Parameters
    ----------
    fitted : ndarray, shape (5,), optional
        See ``scale_noise`` and ``misfit_of``; the noise as it is, and no misfit, without them.
    """
    if fitted is None:
        return noise, Misfit()
    return scale_noise(noise, fitted), misfit_of(fitted)


def path_frame(direction: Array, beam: Array) -> tuple[Array, Array]:
    """The two axes of the path coordinate system perpendicular to the path (paper Eq. 1).

    a2 is the beam direction less its part along the path, a3 = a1 x a2. Eq. 1 prints
    b - b . a1, which subtracts a number from a vector; meant is b - (b . a1) a1.

    Parameters
    ----------
    direction : ndarray, shape (n, 3)
        Unit direction of the path, a1.
    beam : ndarray, shape (n, 3)
        Unit direction of the beam in the same frame.

    Returns
    -------
    a2, a3 : ndarray, shape (n, 3)
        Where the beam runs along the path, any two perpendicular unit vectors.
    """
    across = beam - direction * np.einsum('ij,ij->i', beam, direction)[:, None]
    size = np.linalg.norm(across, axis=1)
    parallel = size < 1e-6
    if np.any(parallel):
        helper = np.eye(3)[np.argmin(np.abs(direction[parallel]), axis=1)]
        across[parallel] = np.cross(direction[parallel], helper)
        size[parallel] = np.linalg.norm(across[parallel], axis=1)
    a2 = across / size[:, None]
    return a2, np.cross(direction, a2)


def beam_shares(xyz: Array, pose: RigidTransform, axes: Array) -> Array:
    """How the noise of range and two angles enters the rows of pieces.

    Parameters
    ----------
    xyz : ndarray, shape (p, 3), m
        Points in the tracker frame.
    pose : RigidTransform
        Tracker to machine.
    axes : ndarray, shape (c, p, 3)
        Directions of the rows in the machine frame.

    Returns
    -------
    ndarray, shape (3, c, p)
        Row per m of range noise (paper Eq. 4 with the beam direction), and in m per rad of
        horizontal and of vertical angle noise.
    """
    distance, along, horizontal, vertical = beam_frame(xyz)
    reach = distance[:, None]
    directions = np.stack([along, horizontal * reach, vertical * reach])
    return np.asarray(np.einsum('cpi,kpi->kcp', axes, pose.rotate(directions)))


def sample_variance(noise: NoiseModel, shares: Array) -> Array:
    """Variance of single samples, shape (c, p), m^2, for the shares of ``beam_shares``."""
    return np.asarray(np.einsum('k,kcp->cp', noise.level**2, shares**2))


def noise_covariance(
    noise: NoiseModel, shares: Array, other: Array, windows: Windows
) -> tuple[Array, Array]:
    """Covariance of tracker noise between two rows of the pieces of a line.

    Parameters
    ----------
    shares, other : ndarray, shape (3, ..., m)
        Of the one and of the other row, see ``beam_shares``; of one line, or of several alike.
    windows : tuple of time, duration (s) and count, each of shape (..., m)
        See ``mean_covariance``.

    Returns
    -------
    white : ndarray, shape (..., m), m^2
        Of every piece; none between pieces.
    slow : ndarray, shape (..., m, m), m^2
    """
    time, duration, count = windows
    white = np.einsum('k,k...m,k...m->...m', noise.white**2, shares, other) / count
    slow = np.zeros((*shares.shape[1:], time.shape[-1]))
    for tau in sorted({c.correlation_time for c in noise if c.slow}):
        level = np.array([c.slow if c.correlation_time == tau else 0.0 for c in noise])
        one, two = (np.moveaxis(s, 0, -1) * level for s in (shares, other))
        amplitude = one @ np.swapaxes(two, -1, -2)
        amplitude *= mean_covariance(0.0, tau, time, duration, count)
        slow += amplitude
    return white, slow


def covariance_parts(
    noise: NoiseModel, misfit: Misfit, shares: Array, windows: Windows
) -> tuple[Array, Array, Array, Array]:
    """Covariance of the pieces of a line in one row, part by part.

    Parameters
    ----------
    shares : ndarray, shape (3, ..., m)
        Of range and angle noise, see ``beam_shares``; of one line, or of several alike.
    windows : tuple of time, duration (s) and count, each of shape (..., m)
        See ``mean_covariance``.

    Returns
    -------
    white, slow : ndarray, shape (..., m) and (..., m, m), m^2
        Noise of the tracker, see ``noise_covariance``.
    independent, lasting : ndarray, shape (..., m) and (..., m, m), m^2
        The parts of the misfit.
    """
    return (
        *noise_covariance(noise, shares, shares, windows),
        *misfit_covariance(misfit, windows),
    )


def misfit_covariance(misfit: Misfit, windows: Windows) -> tuple[Array, Array]:
    """Covariance of the misfit of the pieces of a line, the same in every row.

    Parameters
    ----------
    windows : tuple of time, duration (s) and count, each of shape (..., m)
        See ``mean_covariance``.

    Returns
    -------
    independent : ndarray, shape (..., m), m^2
        Of every piece; none between pieces.
    lasting : ndarray, shape (..., m, m), m^2
    """
    time, duration, count = windows
    lasting = np.zeros((*time.shape, time.shape[-1]))
    if misfit.slow:
        lasting = misfit.slow**2 * mean_covariance(0.0, MISFIT_TIME, time, duration, count)
    return np.full(time.shape, misfit.independent**2), lasting


def add_to_diagonal(matrices: Array, *values: Array) -> Array:
    """Add values (..., m) to the diagonals of matrices (..., m, m), in place."""
    place = np.arange(matrices.shape[-1])
    for value in values:
        matrices[..., place, place] += value
    return matrices


def mean_covariance(
    white: float, correlation_time: float, time: Array, duration: Array, count: Index
) -> Array:
    """Covariance of means over time windows for noise of unit variance.

    Parameters
    ----------
    white : float
        White share of the variance.
    correlation_time : float
        s, of the rest.
    time, duration : ndarray, shape (..., m), s
        Centres and lengths of the windows, which do not overlap.
    count : ndarray, shape (..., m)
        Samples in each.

    Returns
    -------
    ndarray, shape (..., m, m)
        Exact for windows sampled densely.
    """
    x = np.maximum(duration / correlation_time, 1e-6)
    half = np.sinh(np.minimum(0.5 * x, 50.0)) / (0.5 * x)
    gap = time[..., :, None] - time[..., None, :]
    np.abs(gap, out=gap)
    gap /= correlation_time
    matrix = np.negative(gap)
    np.exp(matrix, out=matrix)
    matrix *= half[..., :, None] * half[..., None, :]
    diagonal = np.arange(time.shape[-1])
    matrix[..., diagonal, diagonal] = 0.0
    over = matrix > np.exp(-0.001 * gap.max(initial=0.0))  # only windows that overlap by rounding
    if np.any(over):
        matrix[over] = np.minimum(matrix[over], np.exp(-0.001 * gap[over]))
    own = np.where(x < 1e-3, 1.0 - x / 3.0, 2.0 * (x - 1.0 + np.exp(-x)) / x**2)
    matrix *= 1.0 - white
    matrix[..., diagonal, diagonal] = (1.0 - white) * own + white / count
    return matrix


FREEDOM = 'student_freedom'


def noise_to_fields(noise: NoiseModel) -> dict[str, Any]:
    """Return a noise model in the layout of noise.json."""
    level, white = noise.level.tolist(), noise.white.tolist()
    times = [c.correlation_time for c in noise]
    return {
        'u_range': level[0],
        'u_angle': level[1:],
        'white_range': white[0],
        'white_angle': white[1:],
        'correlation_time': times[0] if len(set(times)) == 1 else times,
        'tails': {n: {FREEDOM: c.dof} for n, c in zip(QUANTITIES, noise, strict=True)},
    }


def noise_from_fields(data: Mapping[str, Any]) -> NoiseModel:
    """Build a noise model from such fields; without ``tails`` it is normal.

    Raises
    ------
    ValueError
        If a value is impossible; KeyError or TypeError if one is missing or no number.
    """
    level = np.array([data['u_range'], *data['u_angle']], dtype=float)
    white = np.array([data['white_range'], *data['white_angle']], dtype=float)
    time = np.array(data['correlation_time'], dtype=float)
    if level.shape != (3,) or white.shape != (3,):
        raise ValueError('u_angle and white_angle are two values each')
    if time.shape not in ((), (3,)):
        raise ValueError('correlation_time is one value, or three')
    if not (np.all(level > 0) and np.all(np.isfinite(level))):
        raise ValueError('levels must be above 0')
    if not np.all((white >= 0) & (white <= level)):
        raise ValueError('the white part lies between 0 and the level')
    if not np.all((time > 0) | ((time == 0) & (white == level))):
        raise ValueError('correlation_time is 0 beside a slow part')
    freedom = [data.get('tails', {}).get(name, {}).get(FREEDOM) for name in QUANTITIES]
    dof = [None if f is None else float(f) for f in freedom]
    if any(f is not None and not f > 2 for f in dof):
        raise ValueError(f'{FREEDOM} must be above 2')
    parts = zip(level, white, np.broadcast_to(time, 3), dof, strict=True)
    return NoiseModel(*(NoiseComponent(float(u), float(w), float(t), f) for u, w, t, f in parts))


def read_noise(path: str | Path) -> NoiseModel:
    """Read a noise.json of ``otf noise``; ConfigError if it is none."""
    try:
        return noise_from_fields(read_json(path))
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise ConfigError(f'{path}: not a noise.json ({value_text(error)})') from None
