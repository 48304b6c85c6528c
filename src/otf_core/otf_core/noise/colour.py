# SPDX-License-Identifier: Apache-2.0
"""Colour of measured noise: white and slow part (first-order Gauss-Markov), spectrum, peaks.

Half the mean square of the differences at lag k is w + s (1 - exp(-k dt / tau)) for white noise
of variance w and slow noise of variance s (variogram, Matheron 1963). Unlike the autocovariance it
needs no mean, which short windows do not determine. Lags are spaced by octaves and each counts by
its relative precision, so that a small white part beside a large slow one is still resolved. The
scatter of the fit is that of fits without a part of the windows (jackknife).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from otf_core.arrays import Array, Index
from otf_core.documents import Document, stated
from otf_core.noise.noise_model import QUANTITIES, NoiseComponent, NoiseModel

LAGS_PER_OCTAVE = 4
MAX_LAG = 0.75
"""Share of the longest window."""
TYPICAL_TIME, SPREAD = 0.3, 10.0
"""s and factor; what is known of correlation times before: recorded ones lie within
(docs/uncertainty.md). Decides only where the recording does not."""
MAX_ITERATIONS = 5
"""Of the fit; each weighs with the model of the one before."""
MIN_SLOW_SHARE = 0.02
"""Share of the variance below which a slow part is indistinguishable from none."""
SHORTEST_TIME, LONGEST_TIME = 0.01, 2.0
"""s; correlation times searched for, further limited by the interval and length of the windows."""


@dataclass(frozen=True)
class Variogram:
    """Half the mean square of differences.

    Attributes
    ----------
    lag : ndarray of int64, shape (m,)
    value : ndarray, shape (c, m)
    freedom : ndarray, shape (m,)
        Number of differences that do not overlap.
    """

    lag: Index
    value: Array
    freedom: Array


def variogram(windows: Sequence[Array]) -> Variogram:
    """Variogram over windows (n, c) of any lengths, at lags spaced by octaves."""
    longest = max(len(w) for w in windows)
    top = max(2, int(MAX_LAG * longest))
    steps = np.geomspace(1, top, int(LAGS_PER_OCTAVE * np.log2(top)) + 1)
    lags = np.unique(np.rint(steps)).astype(np.int64)
    values, counts = [], []
    for k in lags:
        parts = [w[k:] - w[:-k] for w in windows if len(w) > k]
        count = sum(len(p) for p in parts)
        values.append(sum(np.einsum('ij,ij->j', p, p) for p in parts) / (2.0 * count))
        counts.append(count / k)
    return Variogram(lags, np.array(values).T, np.array(counts))


def _weighted(value: Array, shape: Array, weight: Array) -> tuple[Array, Array]:
    """Non-negative white and slow parts by weighted least squares, for all times at once."""
    w, ws = weight.sum(axis=-1), (weight * shape).sum(axis=-1)
    wss, wv = (weight * shape**2).sum(axis=-1), (weight * value).sum(axis=-1)
    wsv = (weight * shape * value).sum(axis=-1)
    determinant = np.maximum(w * wss - ws**2, 1e-300)
    white, slow = (wss * wv - ws * wsv) / determinant, (w * wsv - ws * wv) / determinant
    # at the edge of what is allowed the other part is alone
    white, slow = np.where(slow < 0, wv / w, white), np.where(white < 0, wsv / wss, slow)
    return np.maximum(white, 0.0), np.maximum(slow, 0.0)


def _fits(seen: Variogram, step: float, times: Array) -> tuple[Array, Array, Array]:
    """Misfit of each correlation time, shape (t,), and the parts, each (t, c).

    The misfit is minus twice the logarithm of the posterior, less a constant. Mean squares follow
    chi-square distributions, so what the data add is their deviance. Weighted squares instead
    would take a model that is too large for a good one.
    """
    shape = 1.0 - np.exp(-seen.lag * step / times[:, None, None])
    least = 1e-3 * seen.value.max(axis=1, keepdims=True) + 1e-300
    value = np.maximum(seen.value, least)
    model = np.broadcast_to(value, (len(times), *value.shape))
    for _ in range(
        MAX_ITERATIONS
    ):  # the precision is that of the model, not of the value it has to fit
        scale = value.max(axis=1, keepdims=True)
        white, slow = _weighted(seen.value, shape, seen.freedom * (scale / model) ** 2)
        model = np.maximum(white[..., None] + slow[..., None] * shape, least)
    ratio = value / model
    misfit = np.sum(seen.freedom * (ratio - 1.0 - np.log(ratio)), axis=(1, 2))
    known = (np.log(times / TYPICAL_TIME) / np.log(SPREAD)) ** 2
    return misfit + known, white, slow


def longest_time(windows: Sequence[Array], step: float) -> float:
    """Longest correlation time that windows of values ``step`` seconds apart can show, s."""
    longest = min(LONGEST_TIME, max(len(w) for w in windows) * step)
    return max(longest, 2 * step)


def fit_colour(windows: Sequence[Array], step: float) -> tuple[NoiseComponent, ...]:
    """Fit white and slow noise, with one correlation time for all quantities.

    Short windows determine the time too poorly to fit one for each quantity.

    Parameters
    ----------
    windows : sequence of ndarray, each of shape (n, c)
        Standstills of any lengths; c quantities.
    step : float
        s, between values.

    Returns
    -------
    tuple of NoiseComponent
        One for each of the c quantities. Where the slow part of all is next to nothing, none
        has a correlation time.
    """
    seen = variogram(windows)

    times = np.geomspace(max(SHORTEST_TIME, step), longest_time(windows, step), 25)
    for _ in range(2):  # the second grid is finer, about the best time of the first
        best = int(np.argmin(_fits(seen, step, times)[0]))
        centre = times[best]
        times = np.geomspace(times[max(best - 1, 0)], times[min(best + 1, len(times) - 1)], 13)
    _, (white,), (slow,) = _fits(seen, step, np.array([centre]))
    total, time = white + slow, float(centre)
    if not np.any(slow > MIN_SLOW_SHARE * total):
        white, time = total, 0.0
    levels = zip(np.sqrt(total), np.sqrt(white), strict=True)
    return tuple(NoiseComponent(float(u), float(w), time) for u, w in levels)


GROUPS = 10
"""Groups of windows, each left out once."""
SHORTEST_PART = 0.2
"""s; fewer windows than groups are cut, but not shorter than this."""


def left_out_fits(windows: list[Array], step: float) -> list[NoiseModel]:
    """Noise without one group of windows, group by group; none if there is too little.

    Parameters
    ----------
    windows : list of ndarray, each of shape (n, 3), m, rad, rad
    step : float
        s, between values.
    """
    parts = -(-GROUPS // len(windows))
    cut = [p for w in windows for p in np.array_split(w, parts) if len(p) * step > SHORTEST_PART]
    windows = cut if parts > 1 else windows
    groups = min(GROUPS, len(windows))
    if groups < 2:
        return []
    groups_kept = [[w for k, w in enumerate(windows) if k % groups != g] for g in range(groups)]
    return [NoiseModel(*fit_colour(rest, step)) for rest in groups_kept]


def jackknife_u(values: Array) -> Array:
    """Standard uncertainty from values (g, ...) that each leave out one of g groups."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(np.std(values, axis=0) * np.sqrt(len(values) - 1.0))


SEGMENT = 2.0
"""s; longest segment, which sets the resolution in frequency."""
NEIGHBOURS = 12
"""bins on either side whose median is the background."""
SKIPPED = 3
"""lowest bins, where slow noise is no peak."""
FALSE_ALARM = 0.01
"""Probability that noise without peaks shows any."""
MEDIAN_EFFICIENCY = 2.0 / np.pi
MIN_RATIO = 3.0
"""A peak stands out of the background by at least this factor, however long the recording."""


@dataclass(frozen=True)
class Spectrum:
    """Power spectral density.

    Attributes
    ----------
    frequency : ndarray, shape (m,), Hz
    density : ndarray, shape (c, m)
        m^2/Hz or rad^2/Hz.
    segments : int
        Number averaged.
    """

    frequency: Array
    density: Array
    segments: int


@dataclass(frozen=True)
class Peak(Document):
    """A line in the spectrum."""

    of: str = stated('range, horizontal angle or vertical angle')
    frequency: float = stated('frequency', 'Hz')
    rms: float = stated('root mean square', 'm or rad')


def spectrum(windows: Sequence[Array], step: float) -> Spectrum:
    """Averaged spectrum of windows (n, c) by Welch's method, half-overlapping segments."""
    from scipy.signal import welch  # 0.3 s

    lengths = np.array([len(w) for w in windows])
    size = int(min(SEGMENT / step, np.median(lengths)))
    long = [w for w in windows if len(w) >= size]
    parts = [welch(w, 1.0 / step, nperseg=size, detrend='linear', axis=0) for w in long]
    number = [1 + 2 * (len(w) - size) // size for w in long]
    density = np.average([p[1] for p in parts], axis=0, weights=number)
    return Spectrum(parts[0][0], np.asarray(density.T), int(sum(number)))


def expected_density(frequency: Array, noise: NoiseModel) -> Array:
    """One-sided density of range and two angles sampled fast, shape (3, m).

    Parameters
    ----------
    frequency : ndarray, shape (m,), Hz
        From zero to half the sampling rate.
    """
    rows = []
    for c in noise:
        turn = 2.0 * np.pi * frequency * c.correlation_time
        slow = 4.0 * c.slow**2 * c.correlation_time / (1.0 + turn**2)
        rows.append(c.white**2 / frequency[-1] + slow)
    return np.array(rows)


def find_peaks(seen: Spectrum, expected: Array) -> tuple[Peak, ...]:
    """Lines that stand out of their neighbourhood more than chance allows.

    Parameters
    ----------
    expected : ndarray, shape (c, m)
        Shape of the density without peaks, see ``expected_density``; its size does not matter.
    """
    from scipy.stats import chi2  # 0.4 s
    from scipy.stats import f as f_ratio

    bins = seen.frequency.size
    if bins < 2 * NEIGHBOURS:
        return ()
    freedom = 2.0 * max(1.0, seen.segments / 1.06)  # half overlap, Hann window
    # the background is a median over neighbours of which two out of three are independent
    of_background = freedom * (2 * NEIGHBOURS + 1) * (2.0 / 3.0) * MEDIAN_EFFICIENCY
    chance = f_ratio.isf(FALSE_ALARM / (bins * len(seen.density)), freedom, of_background)
    chance *= freedom / chi2.median(freedom)
    width = seen.frequency[1]
    peaks = []
    for quantity, density in enumerate(seen.density):
        shape = np.maximum(expected[quantity], 1e-9 * expected[quantity].max() + 1e-300)
        background = shape * median_filter(density / shape, 2 * NEIGHBOURS + 1, mode='nearest')
        excess = density > max(chance, MIN_RATIO) * background
        excess[:SKIPPED] = False
        edges = np.flatnonzero(np.diff(np.concatenate([[False], excess, [False]]).astype(int)))
        for low, high in edges.reshape(-1, 2):
            top = low + int(density[low:high].argmax())
            near = slice(max(low - 1, 0), high + 1)
            power = float(np.sum(density[near] - background[near])) * width
            name = QUANTITIES[quantity]
            peaks.append(Peak(name, float(seen.frequency[top]), float(np.sqrt(power))))
    return tuple(peaks)
