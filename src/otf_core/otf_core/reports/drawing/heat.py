# SPDX-License-Identifier: Apache-2.0
"""Sizes as colours: a few classes from light to dark, and their key."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.reports.drawing.scale import round_step

Array = NDArray[np.float64]

LEVELS = 6


def heat_step(values: Array) -> float:
    """Width of a class for values (n,): a round number of which six reach the largest."""
    top = float(np.max(values, initial=0.0))
    return round_step(top / LEVELS) if top > 0 else 1.0


def heat_classes(values: Array, step: float) -> NDArray[np.int64]:
    """Class of every value, 0 to 5, shape (n,)."""
    return np.clip((values / step).astype(np.int64), 0, LEVELS - 1)


def _spans(step: float, top: float) -> list[tuple[int, str]]:
    digits = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    used = min(LEVELS, int(top / step) + 1)
    return [(k, f'{k * step:.{digits}f} to {(k + 1) * step:.{digits}f}') for k in range(used)]


def heat_words(step: float, length: Array) -> list[tuple[int, str]]:
    """Classes up to the longest of lengths (n,), m, and what they stand for, um."""
    top = 1e6 * float(np.max(length, initial=0.0))
    return [(k, f'{said} µm') for k, said in _spans(step, top)]


def heat_key(step: float, top: float, unit: str) -> str:
    """Key of the classes up to ``top``, as markup."""
    keys = ''.join(
        f'<span class="h{k}"><span class="key"></span>{said} {unit}</span> '
        for k, said in _spans(step, top)
    )
    return f'<p class="soft keys">{keys}</p>'
