# SPDX-License-Identifier: Apache-2.0
"""Whether the machine drives the chords of a curve or the arcs through their ends.

A published curve is a polyline; the control may have driven circles (G2, G3) or a spline through
its points. Between two joints an arc of curvature k leaves its chord L by k s (L - s) / 2, at most
by the sagitta k L^2 / 8: 1 um for chords of 1 mm and a radius of 125 mm, 26 um for 5 mm and
120 mm. That profile repeats from chord to chord, as no error of a machine does, so the samples
tell how much of it was driven.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.tracking.curves import Lines, PathShape, shape_of

VISIBLE = 2e-7
"""m; flatter chords are as good as arcs."""
FINE = 5e-8
"""m; sagitta of the chords that stand for an arc."""
BLOCKS = 20
"""Parts of the run whose scatter gives the uncertainty."""
MATTERS = 2e-6
"""m; what is left of the sagitta is worth a remark."""
UNCLEAR = 0.2
"""Uncertainty of the share above which the samples do not tell."""
HALF = 0.5
"""Share from which on arcs are closer to what was driven than chords."""


@dataclass(frozen=True)
class Bulge:
    """How much of the arcs was driven.

    Attributes
    ----------
    share : float
        0 for chords, 1 for arcs.
    u : float
        Its standard uncertainty; infinite if the samples do not tell.
    sagitta : float
        Of the curves, largest, m.
    """

    share: float
    u: float
    sagitta: float

    @property
    def arcs(self) -> bool:
        """True if arcs are what was driven."""
        return self.share >= HALF and self.share > 3.0 * self.u

    @property
    def remark(self) -> str:
        """What the reader of a result should know; empty if all is clear."""
        left = min(abs(self.share), abs(1.0 - self.share)) * self.sagitta
        size = f'sagitta of the published chords: {1e6 * self.sagitta:.2g} um'
        if not self.u < UNCLEAR and self.sagitta > MATTERS:
            return (
                f'the samples do not tell whether curves were driven along chords or arcs '
                f'({size}); chords are assumed: publish finer chords'
            )
        if left > MATTERS and left > 3.0 * self.u * self.sagitta:
            return (
                f'curves were driven neither along their chords nor along arcs through their '
                f'joints ({100 * self.share:.0f} % of the way between, {size}): publish finer '
                f'chords or what the control makes of them'
            )
        return ''


def curvature(lines: Lines) -> Array:
    """Curvature vector at both ends of every chord, shape (m, 2, 3), 1/m; zero off curves.

    That of the circle through a joint and its two neighbours points to the centre; the ends of a
    curve take that of the next joint.
    """
    length, unit = lines.length, lines.unit
    inner = lines.shape.stretch[1:] == lines.shape.stretch[:-1]
    # (u2 - u1) / mean length is the curvature to first order of the turn
    joint = 2.0 * np.diff(unit, axis=0) / (length[1:] + length[:-1])[:, None]
    joint = np.where(inner[:, None], joint, 0.0)
    start = np.concatenate([np.zeros((1, 3)), joint])
    end = np.concatenate([joint, np.zeros((1, 3))])
    first = np.concatenate([[True], ~inner])
    last = np.concatenate([~inner, [True]])
    start[first], end[last] = end[first], start[last]
    return np.stack([start, end], axis=1)


def _offset(lines: Lines, bend: Array, chord: Index, along: Array) -> Array:
    """Offset of the arcs from their chords, shape (n, 3), m."""
    length = lines.length[chord]
    share = np.clip(along / length, 0.0, 1.0)[:, None]
    mean = (1.0 - share) * bend[chord, 0] + share * bend[chord, 1]
    return np.asarray(-0.5 * (np.clip(along, 0.0, length) * (length - along))[:, None] * mean)


def _freed(values: Array, width: int) -> Array:
    """Values less their running mean over ``width`` samples."""
    total = np.cumsum(np.concatenate([[0.0], values]))
    index = np.arange(len(values))
    low, high = np.maximum(index - width // 2, 0), np.minimum(index + width // 2 + 1, len(values))
    return np.asarray(values - (total[high] - total[low]) / (high - low))


def bulge_of(points: Array, chord: Index, lines: Lines, least: float) -> Bulge | None:
    """Tell how much of the arcs was driven; None if there is no curve or it cannot matter.

    Parameters
    ----------
    points : ndarray, shape (n, 3), m
        Samples on curves in order of time, machine frame.
    chord : ndarray of int64, shape (n,)
    lines : Lines
    least : float
        m; shorter curves do not count.
    """
    bend = curvature(lines)
    size = np.linalg.norm(bend, axis=2).mean(axis=1)
    sagitta = size * lines.length**2 / 8.0
    seen = (sagitta[chord] > VISIBLE) & (lines.total[chord] >= least)
    points, chord = points[seen], chord[seen]
    if not len(points):
        return None
    largest = float(sagitta[chord].max())
    along = lines.along(points, chord)
    offset = _offset(lines, bend, chord, along)
    outward = -bend[chord].mean(axis=1) / size[chord, None]
    local = points - lines.shape.corners[chord] - along[:, None] * lines.unit[chord]
    passed = max(1, int(np.count_nonzero(np.diff(chord))))
    width = max(7, int(np.ceil(3.0 * len(chord) / passed)))
    shape = _freed(np.einsum('ij,ij->i', offset, outward), width)
    seen_shape = _freed(np.einsum('ij,ij->i', local, outward), width)
    limit = 10.0 * float(np.median(np.abs(seen_shape)))  # jumps between curves are no profile
    shape = np.where(np.abs(seen_shape) < limit, shape, 0.0)
    block = np.arange(len(shape)) * BLOCKS // len(shape)
    weight = np.bincount(block, shape**2, BLOCKS)
    share = np.bincount(block, shape * seen_shape, BLOCKS) / np.maximum(weight, 1e-30)
    total = float(weight.sum())
    if total <= 0.0:
        return Bulge(0.0, np.inf, largest)
    mean = float(share @ weight) / total
    spread = float((share - mean) ** 2 @ weight**2) / total**2
    return Bulge(mean, float(np.sqrt(spread)), largest)


def with_arcs(lines: Lines) -> tuple[PathShape, Index, Index]:
    """Replace the chords of curves by finer ones along their arcs.

    Returns
    -------
    shape : PathShape
    start : ndarray of int64, shape (m,)
        The first of the chords that stand for each old one.
    parent : ndarray of int64, shape (m2,)
        The old chord of each new one.
    """
    bend, length = curvature(lines), lines.length
    sagitta = np.linalg.norm(bend, axis=2).max(axis=1) * length**2 / 8.0
    count = np.maximum(1, np.ceil(np.sqrt(sagitta / FINE))).astype(np.int64)
    parent = np.repeat(np.arange(len(length)), count)
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    along = (np.arange(len(parent)) - start[parent]) / count[parent] * length[parent]
    points = lines.shape.corners[parent] + along[:, None] * lines.unit[parent]
    points += _offset(lines, bend, parent, along)
    return shape_of(np.concatenate([points, lines.shape.corners[-1:]])), start, parent
