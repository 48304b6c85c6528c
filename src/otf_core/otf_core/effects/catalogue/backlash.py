# SPDX-License-Identifier: Apache-2.0
"""Backlash: half the reversal value of an axis, with the sign of its travel.

delta = 1/2 B_a sign(d_a) e_a, added over the axes a; d is the travel direction. An axis that
stands stays on the side of its last travel if it is held there by friction (shape ``held`` 1), or
lies in the middle of its play (0).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import BelongsTo, Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.free import Free
from otf_core.model.path import MOVING

HELD = 'held'
"""Shape parameter: 1 if an axis that stands stays on the side of its last travel, else 0."""


def travel_sign(state: State, shape: Shape) -> Array:
    """Sign of travel of each axis, shape (n, 3); where it stands that of its last, or 0."""
    if shape[HELD] > 0.5:
        return state.side
    return np.where(np.abs(state.direction) > MOVING, np.sign(state.direction), 0.0)


class Backlash(Effect):
    """Reversal error that does not depend on position."""

    name: ClassVar[str] = 'backlash'
    cause: ClassVar[str] = 'play and wind-up between drive and slide, not visible to the encoder'
    equation: ClassVar[str] = '1/2 B_a sign(d_a) e_a'
    coefficients: ClassVar[str] = (
        'B_a: reversal value of axis a; shape: held 1 if an axis at rest stays on the side of '
        'its last travel, otherwise 0'
    )
    typical: ClassVar[str] = '1 um to 10 um on production machines'
    source: ClassVar[str] = 'ISO 230-2:2014, 2.16 (reversal value)'
    signature: ClassVar[str] = (
        'a constant offset on every diagonal that changes sign with the direction of travel; '
        'none on lines along the axis itself'
    )
    needs: ClassVar[str] = (
        'every line driven forward and backward, and lines that are not space diagonals'
    )
    belongs_to: ClassVar[BelongsTo] = BelongsTo.REVERSAL
    any_axes: ClassVar[bool] = True
    shape_names: ClassVar[tuple[str, ...]] = (HELD,)
    shape_units: ClassVar[tuple[str, ...]] = ('',)
    shape_defaults: ClassVar[Mapping[str, float]] = MappingProxyType({HELD: 0.0})

    free: ClassVar[tuple[Free, ...]] = (
        Free(
            ('time',),
            (4,),
            'the backlash changes during the run',
            own_per_run=True,
            belongs_to=BelongsTo.EFFECTS,
        ),
        Free(
            ('since_reversal_{axis}',),
            (5,),
            'the backlash is traversed over some distance after a reversal',
            belongs_to=BelongsTo.EFFECTS,
        ),
        Free(('feed',), (2,), 'the backlash depends on the feed', belongs_to=BelongsTo.EFFECTS),
    )

    def shapes(self, state: State) -> Sequence[Shape]:
        """Return to the middle at standstill, and held."""
        return ({HELD: 0.0}, {HELD: 1.0})

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Reversal value of every axis that takes part."""
        unit = {n: a.unit for n, a in fitted.machine.axes.items()}
        return tuple(Size(f'of {a}', ({f'B_{a}': 1.0},), unit[a]) for a in fitted.axes)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return B_X, B_Y, B_Z, and those of rotary axes."""
        columns = state.by_axes(0.5 * travel_sign(state, shape))
        axes = state.machine.axis_names
        units = tuple(state.machine.axes[a].unit for a in axes)
        return Terms(tuple(f'B_{a}' for a in axes), units, axes, columns)
