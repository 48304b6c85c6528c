# SPDX-License-Identifier: Apache-2.0
"""Thermal drift of the structure: the target shifts against the table as the machine warms up.

delta = sum over k of D_k g_k(t), the same vector at every place; g as in ``drift``.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects import drift
from otf_core.effects.action import Acting, vector
from otf_core.effects.base import Coefficients, Shape, Size, State, Terms
from otf_core.effects.free import Free
from otf_core.effects.sizes import vector_size
from otf_core.model.frames import XYZ


def translation_columns(functions: list[tuple[str, Array]]) -> Array:
    """Columns of a shift along X, Y, Z with each function of time, shape (n, 3, 3 k)."""
    return np.concatenate([g[:, None, None] * np.eye(3) for _, g in functions], axis=2)


class ThermalStructureDrift(drift.DriftingEffect):
    """Slow shift of the target that does not depend on position."""

    name: ClassVar[str] = 'thermal_structure_drift'
    cause: ClassVar[str] = 'column, spindle and bed grow as the machine warms up or the room cools'
    equation: ClassVar[str] = 'D_k g_k(t)'
    coefficients: ClassVar[str] = (
        'D_a: shift along a reached at until; D_a_2, ...: further functions of time; shape: '
        'time constant tau, until (0: end of the run), order of the last function'
    )
    typical: ClassVar[str] = '10 um/h to 50 um/h, mostly along the spindle'
    source: ClassVar[str] = (
        'ISO 230-3:2020 (environmental temperature variation error); Mayr et al., '
        'CIRP Annals 61 (2012) 771'
    )
    signature: ClassVar[str] = (
        'the same shift everywhere at any given time; a line repeated later is displaced'
    )
    needs: ClassVar[str] = (
        'lines repeated at other times; a fixed second target on the table distinguishes it '
        'from a drift of the tracker, which has exactly the same effect'
    )
    any_axes: ClassVar[bool] = True

    follows: ClassVar[tuple[Acting, ...]] = (vector,)
    switches: ClassVar[tuple[Acting, ...]] = (vector,)
    free: ClassVar[tuple[Free, ...]] = (
        Free(
            ('time',),
            (14,),
            'the drift does not follow an exponential in time',
            (1,),
            vector,
            zero_at=-1.0,
        ),
    )

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Shift, with its direction where one component is most of it."""
        parts = [drift.value_reached(f'D_{a}', fitted.shape) for a in XYZ]
        return (vector_size(fitted, parts, 'm', drift.REACHED),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return D_X, D_Y, D_Z: shift at ``until``; D_X_2 ...: further functions of time."""
        functions = drift.time_functions(state, shape)
        names = tuple(f'D_{a}{suffix}' for suffix, _ in functions for a in XYZ)
        count = len(functions)
        return Terms(names, ('m',) * 3 * count, XYZ * count, translation_columns(functions))
