# SPDX-License-Identifier: Apache-2.0
"""Where the pieces of a curve end, and which of its joints are left out.

A piece of a curve has one direction, the mean of its samples', and one origin, the mean of their
feet on the chords. Deviations across the path of samples at small angles f to that direction sum
up to the deviation of the mean but for a share <f^2> of it, at most MAX_TURN^2 / 12: no sagitta
enters.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.model.path import MOVING, Legs
from otf_core.tracking.curves import Lines, turns

MAX_TURN = 0.1
"""rad; a piece turns no more, so that its deviation is true to 0.1 %."""
ROUNDING = 2e-6
"""m; a joint that rounding could move by less is not left out."""


def joint_rounding(lines: Lines) -> Array:
    """Most that rounding could move the path at the joints of chords, shape (m - 1,), m.

    An arc that touches both chords no further away than half of the shorter one leaves their
    joint by a quarter of that half times the turn.
    """
    shorter = np.minimum(lines.length[:-1], lines.length[1:])
    return np.asarray(shorter * turns(lines.unit) / 8.0)


def near_joints(
    lines: Lines, chord: NDArray[np.int64], along: Array, exclusion: float
) -> NDArray[np.bool_]:
    """Samples so near a joint of a curve that its rounding could matter.

    Parameters
    ----------
    lines : Lines
    chord : ndarray of int64, shape (n,)
    along : ndarray, shape (n,), m
        From the start of the chord.
    exclusion : float
        m; at most a quarter of the chord.
    """
    coarse = joint_rounding(lines) > ROUNDING
    inner = lines.shape.stretch[1:] == lines.shape.stretch[:-1]
    before = np.concatenate([[False], coarse & inner])
    after = np.concatenate([coarse & inner, [False]])
    margin = np.minimum(exclusion, 0.25 * lines.length)[chord]
    rest = lines.length[chord] - along
    return np.asarray((before[chord] & (along < margin)) | (after[chord] & (rest < margin)))


def curve_boundaries(corners: Array, nodes: tuple[Array, ...], size: float) -> Array:
    """Piece boundaries along chords, m from the start of the first.

    They lie at node crossings and where an axis turns round, and between them in equal parts no
    longer than ``size`` that turn by no more than ``MAX_TURN``.

    Parameters
    ----------
    corners : ndarray, shape (k + 1, 3), m
    nodes : three ndarrays, m
    size : float
        m.
    """
    legs = Legs(corners)
    step, length, done, unit = legs.step, legs.length, legs.reach, legs.unit
    cuts = [done[[0, -1]]]
    for axis in range(3):
        moving = np.flatnonzero(np.abs(step[:, axis]) > 1e-9)
        place = (nodes[axis] - corners[moving, axis, None]) / step[moving, axis, None]
        chord, node = np.nonzero((place >= 0) & (place <= 1))
        cuts.append(done[moving[chord]] + place[chord, node] * length[moving[chord]])
        sense = np.where(np.abs(unit[:, axis]) > MOVING, np.sign(unit[:, axis]), 0.0)
        cuts.append(done[1:-1][np.diff(sense) != 0])
    marks = np.unique(np.concatenate(cuts))
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-6])]
    # the direction between the middles of chords, as if the curve turned evenly
    turned = np.concatenate([[0.0], np.cumsum(turns(unit))])
    angle = np.interp(marks, 0.5 * (done[1:] + done[:-1]), turned)
    counts = np.maximum(np.diff(marks) / size, np.diff(angle) / MAX_TURN)
    parts = [
        np.linspace(a, b, max(1, int(np.ceil(count))), endpoint=False)
        for (a, b), count in zip(pairwise(marks), counts, strict=True)
    ]
    return np.concatenate([*parts, [done[-1]]])
