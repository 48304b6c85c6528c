# SPDX-License-Identifier: Apache-2.0
"""The same samples given twice: they count as independent and make u too small."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.pieces.runs import Recording

SAME_PLACE = 1e-7
"""m; measured twice, a point differs by more: noise."""
SHARE = 0.002
"""Share of the shorter recording from which on common samples are no chance."""
COPIED = 0.5
"""The same where the stamps differ: rounded coordinates may be equal by chance."""


def check_same_samples(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that share samples; InputError names both."""
    for (i, a), (j, b) in combinations(enumerate(recordings, start=1), 2):
        shorter = min(len(a.samples), len(b.samples))
        common = same_stamp_and_place(a.samples, b.samples)
        restamped = 0
        if common <= SHARE * shorter:
            restamped = same_points(a.samples, b.samples)
        if common <= SHARE * shorter and restamped <= COPIED * shorter:
            continue
        first, second = a.name or f'run {i}', b.name or f'run {j}'
        count = max(common, restamped)
        how = ' under other stamps' if restamped else ''
        raise InputError(
            f'{second}: {100 * count / shorter:.0f} % of its samples are those of {first}{how} '
            f'({count} samples); counted twice they make the stated uncertainty too small; '
            f'give every recording once, and cut recordings that overlap'
        )


def same_stamp_and_place(a: Samples, b: Samples) -> int:
    """Count samples that both hold at the same stamp."""
    _, i, j = np.intersect1d(a.stamp_ns, b.stamp_ns, return_indices=True)
    if not i.size:
        return 0
    apart = np.abs(a.xyz[i] - b.xyz[j]).max(axis=1)
    return int(np.count_nonzero(apart < SAME_PLACE))


def same_points(a: Samples, b: Samples) -> int:
    """Count different points that both hold exactly, whatever their stamps."""
    return int(np.intersect1d(_keys(a.xyz), _keys(b.xyz)).size)


def _keys(xyz: NDArray[np.float64]) -> NDArray[np.void]:
    rows = np.ascontiguousarray(xyz + 0.0)
    return rows.view(np.dtype((np.void, rows.dtype.itemsize * 3))).ravel()
