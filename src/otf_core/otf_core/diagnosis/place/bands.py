# SPDX-License-Identifier: Apache-2.0
"""Residual by frequency: bands along time and along the position of each axis.

Every leg is turned into waves (orthonormal real Fourier basis, pieces taken as evenly spaced), so
the squares of all bands add up to the square of the residual, and the noise is turned alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.place.groups import (
    Group,
    LegRows,
    LegSums,
    leg_rows,
    leg_sums,
    make_groups,
)
from otf_core.diagnosis.place.views import RunView

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TIME_BANDS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Hz; edges of the bands along time."""
WAVE_BANDS = (0.4, 0.2, 0.1, 0.05, 0.025)
"""m; edges of the bands along an axis: lengths of waves."""
FEWEST_PIECES = 6
"""Legs with fewer pieces tell nothing of frequencies."""
WELL_ALONG = 0.2
"""Direction component from which an axis counts as moving along."""


@cache
def fourier_basis(count: int) -> tuple[Array, Index]:
    """Orthonormal real Fourier basis.

    Returns
    -------
    basis : ndarray, shape (count, count)
        One wave per row.
    cycles : ndarray of int, shape (count,)
        Cycles of each over the count.
    """
    place = np.arange(count)
    cycles = (np.arange(count) + 1) // 2
    phase = 2.0 * np.pi * cycles[:, None] * place / count
    odd = (np.arange(count) % 2 == 1)[:, None]
    basis = np.where(odd, np.cos(phase), np.sin(phase))
    basis[0] = 1.0
    return basis / np.linalg.norm(basis, axis=1)[:, None], cycles


def _band_sums(rows: Sequence[LegRows], frequency: float, edges: Array) -> LegSums:
    """Sums by band; ``frequency`` belongs to one cycle over the leg."""
    count = len(rows[0].values)
    basis, cycles = fourier_basis(count)
    band = np.searchsorted(edges, cycles * frequency * (1 + 1e-9), side='right')
    member = band[:, None] == np.arange(len(edges) + 1)
    turned = [LegRows(basis @ r.values, basis @ r.covariance @ basis.T) for r in rows]
    return leg_sums(turned, member, np.where(member.any(axis=0), count, 0))


def _span(values: Array) -> float:
    """Length covered by evenly spaced values, one spacing beyond the last."""
    steps = np.abs(np.diff(values))
    return float(np.median(steps)) * len(values)


def band_groups(
    views: Sequence[RunView],
    residuals: Sequence[Array],
    axis: int | None,
    edges: Array,
    labels: Sequence[str],
) -> list[Group]:
    """Groups by band.

    Parameters
    ----------
    views : sequence of RunView
    residuals : sequence of ndarray, shape (c, p), m
    axis : int, optional
        0 to 2 for waves along an axis; along time where not given.
    edges : ndarray, shape (b,)
        Rising; Hz, or waves per m.
    labels : sequence of str, b + 1
    """
    sums = []
    for view, residual in zip(views, residuals, strict=True):
        for part, rows in leg_rows(view, residual):
            along = view.time[part] if axis is None else view.q[part, axis]
            if part.stop - part.start < FEWEST_PIECES:
                continue
            if axis is not None and np.abs(view.direction[part, axis]).min() < WELL_ALONG:
                continue
            sums.append(_band_sums(rows, 1.0 / max(_span(along), 1e-9), edges))
    kind = 'frequency' if axis is None else f'waves along {views[0].axis_names[axis]}'
    return make_groups(labels, kind, sums) if sums else []


def time_bands(views: Sequence[RunView], residuals: Sequence[Array]) -> list[Group]:
    """Groups by frequency along time."""
    low = (f'{a:g} Hz to {b:g} Hz' for a, b in pairwise(TIME_BANDS))
    labels = [f'0 Hz to {TIME_BANDS[0]:g} Hz', *low, f'{TIME_BANDS[-1]:g} Hz and more']
    return band_groups(views, residuals, None, np.array(TIME_BANDS), labels)


def wave_bands(views: Sequence[RunView], residuals: Sequence[Array], axis: int) -> list[Group]:
    """Groups by length of waves along an axis."""
    mm = [f'{1e3 * w:g} mm' for w in WAVE_BANDS]
    middle = (f'{b} to {a}' for a, b in pairwise(mm))
    name = views[0].axis_names[axis]
    labels = [f'{name}: {text}' for text in (f'above {mm[0]}', *middle, f'below {mm[-1]}')]
    return band_groups(views, residuals, axis, 1.0 / np.array(WAVE_BANDS), labels)
