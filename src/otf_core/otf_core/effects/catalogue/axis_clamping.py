# SPDX-License-Identifier: Apache-2.0
"""Axis clamping: a rotary axis shifts and turns when its brake closes.

delta = sum over the six motions m of axis a of K_m J_m while the axis stands, else zero; J_m is
the displacement per unit of the motion.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.terms import POSITIONING

STANDS = 1e-6
"""rad/s; a slower axis is clamped."""


class AxisClamping(Effect):
    """Step in the motions of a rotary axis while it is clamped."""

    name: ClassVar[str] = 'axis_clamping'
    cause: ClassVar[str] = 'a clamp or brake pulls table and bearing to one side'
    equation: ClassVar[str] = 'K_m J_m while the axis stands, m its six motions'
    coefficients: ClassVar[str] = 'K_m: change of motion m, EXA to ECC, when the axis is clamped'
    typical: ClassVar[str] = '1 um to 10 um, 5 urad to 20 urad'
    source: ClassVar[str] = 'rotary tables with a brake: position clamped less position free'
    signature: ClassVar[str] = (
        'at rest the axis lies elsewhere than in motion at the same position'
    )
    needs: ClassVar[str] = 'the same position of the axis, passed in motion and at rest'

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """The change that displaces most."""
        motion = fitted.strongest.split('_')[1]
        unit = 'm' if motion[1] in 'XYZ' else 'rad'
        return (Size(f'of {motion}', ({fitted.strongest: 1.0},), unit, 'when clamped'),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return K_EXa to K_ECa of every rotary axis a."""
        axes, turning = state.machine.rotary_names, state.turning
        names = tuple(f'K_E{d}{a}' for a in axes for d in POSITIONING)
        units = tuple('m' if d in 'XYZ' else 'rad' for _ in axes for d in POSITIONING)
        owners = tuple(a for a in axes for _ in POSITIONING)
        columns = np.zeros((len(state), 3, len(names)))
        if turning is not None:
            places = [state.machine.column(a) for a in axes]
            stands = np.abs(turning.rates[:, places]) < STANDS
            own = turning.motions[:, :, places] * stands[:, None, :, None]
            columns = own.reshape(len(state), 3, -1)
        return Terms(names, units, owners, columns)
