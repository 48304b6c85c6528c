# SPDX-License-Identifier: Apache-2.0
"""Spectrum of noise and the peaks in it: vibration of the target or of the tracker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from otf_core.arrays import Array
from otf_core.noise.model import NoiseModel

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
class Peak:
    """A line in the spectrum: which quantity, frequency (Hz), root mean square (m or rad)."""

    quantity: int
    frequency: float
    rms: float


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
    noise : NoiseModel
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
    seen : Spectrum
    expected : ndarray, shape (c, m)
        Shape of the density without peaks, see ``expected_density``; its size does not matter.
    """
    from scipy.stats import chi2  # 0.4 s
    from scipy.stats import f as f_ratio

    bins = seen.frequency.size
    if bins < 2 * NEIGHBOURS:
        return ()
    freedom = 2.0 * max(1.0, seen.segments / 1.06)  # half overlap, Hann window
    # the background is a median over neighbours of which two out of three tell something new
    of_background = freedom * (2 * NEIGHBOURS + 1) * (2.0 / 3.0) * MEDIAN_EFFICIENCY
    chance = f_ratio.isf(FALSE_ALARM / (bins * len(seen.density)), freedom, of_background)
    chance *= freedom / chi2.median(freedom)
    width = seen.frequency[1]
    found = []
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
            found.append(Peak(quantity, float(seen.frequency[top]), float(np.sqrt(power))))
    return tuple(found)
