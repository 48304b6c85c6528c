# SPDX-License-Identifier: Apache-2.0
"""Residual by frequency: bands along time and along the position of each axis.

Every leg is turned into waves (orthonormal real Fourier basis, pieces taken as evenly spaced), so
the squares of all bands add up to the square of the residual, and the noise is turned alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.diagnosis.place.groups import (
    Group,
    LegRows,
    LegSums,
    leg_sums,
    make_groups,
)
from otf_core.diagnosis.place.views import RunView

TIME_BANDS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Hz; edges of the bands along time."""
WAVE_BANDS = (0.4, 0.2, 0.1, 0.05, 0.025)
"""m; edges of the bands along an axis: lengths of waves."""
FEWEST_PIECES = 6
"""Legs with fewer pieces tell nothing of frequencies."""
WELL_ALONG = 0.2
"""Direction component from which an axis counts as moving along."""


@dataclass(frozen=True)
class Bands:
    """A division by frequency.

    Attributes
    ----------
    axis : int, optional
        0 to 2 for waves along an axis; along time where not given.
    edges : ndarray, shape (b,)
        Rising; Hz, or waves per m.
    labels : sequence of str, b + 1
    """

    axis: int | None
    edges: Array
    labels: Sequence[str]

    def member(self, view: RunView, part: slice) -> NDArray[np.bool_] | None:
        """Band of each wave of a leg, shape (n, b + 1); None if the leg does not count."""
        count, along = part.stop - part.start, view.time[part]
        if self.axis is not None:
            if np.abs(view.direction[part, self.axis]).min() < WELL_ALONG:
                return None
            along = view.q[part, self.axis]
        cycles = (np.arange(count) + 1) // 2
        frequency = cycles * (1.0 / max(_span(along), 1e-9))
        band = np.searchsorted(self.edges, frequency * (1 + 1e-9), side='right')
        return np.asarray(band[:, None] == np.arange(len(self.edges) + 1))


def as_waves(values: Array) -> Array:
    """Values (..., n) in the orthonormal real Fourier basis: mean, then cosine, sine of each."""
    count = values.shape[-1]
    spectrum = np.fft.rfft(values, norm='ortho')[..., 1:]
    waves = np.empty_like(values)
    waves[..., 0] = values.sum(axis=-1) / np.sqrt(count)
    waves[..., 1::2] = np.sqrt(2.0) * spectrum.real
    waves[..., 2::2] = -np.sqrt(2.0) * spectrum.imag[..., : (count - 1) // 2]
    if count % 2 == 0:
        waves[..., -1] /= np.sqrt(2.0)
    return waves


def _span(values: Array) -> float:
    """Length covered by evenly spaced values, one spacing beyond the last."""
    steps = np.abs(np.diff(values))
    return float(np.median(steps)) * len(values)


def band_groups(
    views: Sequence[RunView], states: Sequence[Sequence[Array]], bands: Sequence[Bands]
) -> list[list[list[Group]]]:
    """Groups of each state of the residual by each division.

    Parameters
    ----------
    states : sequence of (sequence of ndarray, shape (c, p), m)
        Residuals of all runs; the noise, which takes the time, is turned once for all.
    """
    sums: list[list[list[LegSums]]] = [[[] for _ in bands] for _ in states]
    for view, *residuals in zip(views, *states, strict=True):
        for (low, high), covariances in zip(view.bounds, view.covariances, strict=True):
            if high - low < FEWEST_PIECES:
                continue
            noise = [as_waves(as_waves(k).T) for k in covariances]
            waves = [as_waves(values[:, low:high]) for values in residuals]
            for number, own in enumerate(bands):
                member = own.member(view, slice(low, high))
                if member is None:
                    continue
                pieces = np.where(member.any(axis=0), high - low, 0)
                for state, values in zip(sums, waves, strict=True):
                    rows = [LegRows(v, k) for v, k in zip(values, noise, strict=True)]
                    state[number].append(leg_sums(rows, member, pieces))
    return [
        [_groups(views, own, legs) for own, legs in zip(bands, state, strict=True)]
        for state in sums
    ]


def _groups(views: Sequence[RunView], bands: Bands, legs: Sequence[LegSums]) -> list[Group]:
    if not legs:
        return []
    own = None if bands.axis is None else views[0].axis_names[bands.axis]
    return make_groups(bands.labels, f'waves along {own}' if own else 'frequency', legs)


def usual_bands(views: Sequence[RunView]) -> list[Bands]:
    """By frequency along time, and by length of waves along each axis."""
    low = (f'{a:g} Hz to {b:g} Hz' for a, b in pairwise(TIME_BANDS))
    labels = [f'0 Hz to {TIME_BANDS[0]:g} Hz', *low, f'{TIME_BANDS[-1]:g} Hz and more']
    mm = [f'{1e3 * w:g} mm' for w in WAVE_BANDS]
    words = [f'above {mm[0]}', *(f'{b} to {a}' for a, b in pairwise(mm)), f'below {mm[-1]}']
    waves = 1.0 / np.array(WAVE_BANDS)
    return [
        Bands(None, np.array(TIME_BANDS), labels),
        *(
            Bands(k, waves, [f'{name}: {text}' for text in words])
            for k, name in enumerate(views[0].axis_names)
        ),
    ]
