# SPDX-License-Identifier: Apache-2.0
"""Facing incidence: range error of a reflector that turns with the table under the beam.

delta = (k i^2 + k_u i_u + k_w i_w) e_R: i is the angle between the beam and the axis of the
reflector, (i_u, i_w) its parts along two directions across that axis. The axis is fixed to the
link that carries the reflector and looked to the tracker when its part began; where it really
looked elsewhere, by i0, the linear terms hold that: k |i - i0|^2 = k i^2 - 2 k i0 . i + constant,
for every target its own.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms

SHOWN = np.radians(25.0)
"""rad; angle at which the size is stated."""


class FacingIncidence(Effect):
    """Range error by the angle of incidence in the frame of the reflector."""

    name: ClassVar[str] = 'facing_incidence'
    cause: ClassVar[str] = 'dihedral and centring errors of a reflector that turns with the table'
    equation: ClassVar[str] = '(k i^2 + k_u i_u + k_w i_w) e_R'
    coefficients: ClassVar[str] = (
        'k: range error per square of the angle; k_u_t, k_w_t: linear parts, from the facing of '
        'target t'
    )
    typical: ClassVar[str] = '1 um to 10 um at 25 deg; 5 um/rad^2 to 50 um/rad^2'
    source: ClassVar[str] = (
        'FARO knowledge base, spherically mounted retroreflectors: dihedral errors shift the '
        'return beam'
    )
    signature: ClassVar[str] = (
        'the range changes with the angles of the axes that turn the reflector, like radial and '
        'tilt motions, but for each target its own'
    )
    needs: ClassVar[str] = 'the same angles driven with two facings of the reflector'

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Range error at 25 deg."""
        return (Size('along the beam', ({'k': float(SHOWN**2)},), 'm', 'at 25 deg'),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return k, and k_u, k_w of every target."""
        known = list(state.machine.targets)
        names = ('k', *(f'{part}_{t}' for t in known for part in ('k_u', 'k_w')))
        units = ('m/rad^2', *('m/rad',) * (2 * len(known)))
        columns = np.zeros((len(state), 3, len(names)))
        turning = state.turning
        if turning is not None:
            beam = state.beam / np.linalg.norm(state.beam, axis=1, keepdims=True)
            axis = turning.facing
            across, other = (_across(turning.link[:, :, k], axis) for k in (0, 1))
            flat = np.linalg.norm(across, axis=1, keepdims=True) < 0.1
            across = np.where(flat, other, across)
            across = across / np.linalg.norm(across, axis=1, keepdims=True)
            up = np.cross(axis, across)
            towards, u, w = (-np.einsum('ni,ni->n', beam, e) for e in (axis, across, up))
            off = np.hypot(u, w)
            angle = np.arctan2(off, towards)
            scale = np.where(off > 1e-12, angle / np.maximum(off, 1e-12), 1.0)
            columns[:, :, 0] = beam * (angle**2)[:, None]
            for number in range(len(known)):
                own = turning.target == number
                columns[own, :, 1 + 2 * number] = beam[own] * (scale * u)[own, None]
                columns[own, :, 2 + 2 * number] = beam[own] * (scale * w)[own, None]
        return Terms(names, units, ('',) * len(names), columns)


def _across(vectors: Array, axis: Array) -> Array:
    """Parts of vectors (n, 3) across unit vectors (n, 3)."""
    return np.asarray(vectors - np.einsum('ni,ni->n', vectors, axis)[:, None] * axis)
