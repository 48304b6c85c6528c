# SPDX-License-Identifier: Apache-2.0
"""Lines that touch the same unknowns, and the whitened columns of these on them.

A line touches the splines along it: on a run of three axes half of the unknowns, mean over its
pieces. Products with the columns of effects leave out the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index


@dataclass(frozen=True, eq=False)
class Touched:
    """Some lines of a run.

    Attributes
    ----------
    unknowns : ndarray of int64, shape (b,)
        Those that the lines touch.
    base : ndarray, shape (c m, b)
        Their whitened columns on the m pieces of the lines, component by component.
    """

    lines: list[int]
    unknowns: Index
    base: Array


def touched(base: Array, bounds: Sequence[tuple[int, int]]) -> list[Touched]:
    """Sort lines by the unknowns that they touch.

    Parameters
    ----------
    base : ndarray, shape (c, p, b)
        Whitened columns of all unknowns on the pieces of a run.
    bounds : sequence of (int, int)
        First piece and one past the last of every line.
    """
    alike: dict[bytes, list[int]] = {}
    for line, touches in enumerate(acts_on_lines(base, bounds)):
        alike.setdefault(touches.tobytes(), []).append(line)
    found = []
    for touches, lines in alike.items():
        unknowns = np.flatnonzero(np.frombuffer(touches, np.bool_))
        pieces = np.concatenate([np.arange(*bounds[line]) for line in lines])
        own = base[:, pieces[:, None], unknowns]
        found.append(Touched(lines, unknowns, own.reshape(-1, len(unknowns))))
    return found


def acts_on_lines(values: Array, bounds: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Tell which columns (c, p, k) are not zero on a line, shape (lines, k)."""
    starts = [low for low, _ in bounds]
    return np.logical_or.reduceat((values != 0.0).any(axis=0), starts, axis=0)
