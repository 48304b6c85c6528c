# SPDX-License-Identifier: Apache-2.0
"""Re-seated target: a reflector that was taken out of its nest lies elsewhere afterwards.

delta = R (P_X, P_Y, P_Z) in one part whose target was used before, R the rotation of the link that
carries it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.sizes import vector_size
from otf_core.model.frames import XYZ

PART = 'part'


class ReseatedTarget(Effect):
    """Place of a target that differs from part to part."""

    name: ClassVar[str] = 'reseated_target'
    cause: ClassVar[str] = 'ball or nest not clean, or the ball turned to another facing'
    equation: ClassVar[str] = 'R (P_X, P_Y, P_Z) in one part'
    coefficients: ClassVar[str] = (
        'P_k: shift along k of what carries the target; shape: part, its number from 1 on'
    )
    typical: ClassVar[str] = '1 um to 6 um (centring of the ball), more with dirt'
    source: ClassVar[str] = 'centring of spherically mounted retroreflectors, some um'
    signature: ClassVar[str] = 'all points of one part shift with what carries the target'
    needs: ClassVar[str] = 'the target measured in two parts, the first passes repeated'
    shape_names: ClassVar[tuple[str, ...]] = (PART,)
    shape_units: ClassVar[tuple[str, ...]] = ('',)
    own_per_run: ClassVar[bool] = True

    def shapes(self, state: State) -> Sequence[Shape]:
        """Parts whose target was used before."""
        if state.turning is None:
            return ()
        parts = np.unique(state.turning.part[state.turning.again > 0])
        return tuple({PART: float(k + 1)} for k in parts)

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Shift, with its direction where one component is most of it."""
        remark = f'in part {fitted.shape[PART]:.0f}'
        return (vector_size(fitted, [{f'P_{k}': 1.0} for k in XYZ], 'm', remark),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return P_X, P_Y, P_Z."""
        columns = np.zeros((len(state), 3, 3))
        if state.turning is not None:
            own = state.turning.part == round(shape[PART]) - 1
            columns[own] = state.turning.link[own]
        return Terms(tuple(f'P_{k}' for k in XYZ), ('m',) * 3, ('',) * 3, columns)
