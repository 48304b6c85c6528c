# SPDX-License-Identifier: Apache-2.0
"""Backlash: half the reversal value of an axis, with the sign of its travel.

delta = 1/2 B_a sign(d_a) e_a, added over the axes a; d is the travel direction.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.effects.base import Effect, Shape, State, Terms
from otf_core.machine import AXES

MOVING = 1e-6
"""Direction component below which an axis stands."""


def travel_sign(state: State) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Sign of travel of each axis, shape (n, 3); 0 where the axis stands."""
    return np.where(np.abs(state.direction) > MOVING, np.sign(state.direction), 0.0)


class Backlash(Effect):
    """Reversal error that does not depend on position."""

    name: ClassVar[str] = 'backlash'
    cause: ClassVar[str] = 'play and wind-up between drive and slide; the encoder does not see it'
    equation: ClassVar[str] = '1/2 B_a sign(d_a) e_a'
    coefficients: ClassVar[str] = 'B_a: reversal value of axis a'
    typical: ClassVar[str] = '1 um to 10 um on production machines'
    source: ClassVar[str] = 'ISO 230-2:2014, 2.16 (reversal value)'
    signature: ClassVar[str] = (
        'a constant offset on every diagonal that flips with the sense of travel; none on lines '
        'along the axis itself'
    )
    needs: ClassVar[str] = (
        'every line driven forward and reverse, and lines that are no box diagonals'
    )

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return B_X, B_Y, B_Z."""
        columns = 0.5 * travel_sign(state)[:, :, None] * np.eye(3)
        return Terms(tuple(f'B_{a}' for a in AXES), ('m',) * 3, AXES, columns)
