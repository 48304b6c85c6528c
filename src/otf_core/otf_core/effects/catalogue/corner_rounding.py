# SPDX-License-Identifier: Apache-2.0
"""Corner rounding: near a corner the path is cut to the inside.

delta = A exp(-s / l) b, at both ends of every leg: s is the path length to the corner, b the unit
vector along (direction after - direction before), which points to the inside of the corner.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.free import Free

LENGTHS = (0.002, 0.004, 0.008, 0.016, 0.032)
"""m; about v^2 / 2a, from 0.1 m/s to 0.4 m/s at 2 m/s^2 and more."""
STRAIGHT = 1e-6
"""Change of direction below which there is no corner."""


def _inside(before: Array, after: Array) -> Array:
    turn = after - before
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    return np.where(size > STRAIGHT, turn / np.maximum(size, STRAIGHT), 0.0)


def both_ends(state: State, shape: Shape) -> Terms:
    """``from`` and ``to``: to the inside of the corner behind and of the corner ahead."""
    inside = _inside(state.before, state.direction), _inside(state.direction, state.after)
    return Terms(('from', 'to'), ('m',) * 2, ('',) * 2, np.stack(inside, axis=2))


class CornerRounding(Effect):
    """Path cut short at corners."""

    name: ClassVar[str] = 'corner_rounding'
    cause: ClassVar[str] = 'look-ahead with path tolerance, filtered set points, inertia'
    equation: ClassVar[str] = 'A exp(-s / l) b, b the inside bisector of the corner'
    coefficients: ClassVar[str] = (
        'A: distance from the corner point; shape: length l over which it falls to 1/e'
    )
    typical: ClassVar[str] = '5 um to 50 um within about v^2 / 2a of the corner'
    source: ClassVar[str] = (
        'path tolerance of contouring controls, e.g. LinuxCNC G-code reference, G64 P (path '
        'blending with tolerance)'
    )
    signature: ClassVar[str] = 'both ends of every leg bend towards the inside of the corners'
    needs: ClassVar[str] = 'samples close to the corners, with a small corner exclusion'
    shape_names: ClassVar[tuple[str, ...]] = ('l',)
    refine: ClassVar[str] = 'l'
    refine_width: ClassVar[float] = 0.5
    shape_units: ClassVar[tuple[str, ...]] = ('m',)

    free: ClassVar[tuple[Free, ...]] = (
        Free(
            ('{term}_corner',),
            (8,),
            'the rounding does not decay exponentially with the distance',
            (1,),
            both_ends,
            zero_at=1.0,
        ),
        Free(
            ('{term}_corner', '{term}_turn'),
            (6, 2),
            'the rounding depends on the angle of the corner',
            (1, 0),
            both_ends,
            zero_at=1.0,
        ),
        Free(
            ('{term}_corner', 'feed'),
            (6, 2),
            'the rounding depends on the feed',
            (1, 0),
            both_ends,
            zero_at=1.0,
        ),
    )

    def shapes(self, state: State) -> Sequence[Shape]:
        """Lengths of a few millimetres to a few centimetres."""
        return tuple({'l': length} for length in LENGTHS)

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Distance from the corner point."""
        remark = f'at the corner; a third of that {1e3 * fitted.shape["l"]:.2g} mm away'
        return (Size('', ({'A': 1.0},), 'm', remark),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return A."""
        length = shape['l']
        start = np.exp(-state.from_corner / length)[:, None]
        end = np.exp(-state.to_corner / length)[:, None]
        column = start * _inside(state.before, state.direction)
        column = column + end * _inside(state.direction, state.after)
        return Terms(('A',), ('m',), ('',), column[:, :, None])
