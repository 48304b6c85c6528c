# SPDX-License-Identifier: Apache-2.0
"""Target incidence: range error of a retroreflector hit at an angle.

delta = (k i^2 + k_u i_u + k_w i_w) e_R; i is the angle between the beam and the axis of the
target, (i_u, i_w) its parts to the side and up. The target keeps its orientation in the machine
frame and looks to the tracker from the middle of the volume; a mis-aimed target, offset i0, is the
linear terms: k |i - i0|^2 = k i^2 - 2 k i0 . i + constant.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.effects.base import Effect, Shape, State, Terms


class TargetIncidence(Effect):
    """Range error that grows with the angle of incidence."""

    name: ClassVar[str] = 'target_incidence'
    cause: ClassVar[str] = 'dihedral and centring errors of the reflector, hit off its axis'
    equation: ClassVar[str] = '(k i^2 + k_u i_u + k_w i_w) e_R'
    coefficients: ClassVar[str] = (
        'k: range error per square of the angle; k_u, k_w: linear parts, from a misaligned target'
    )
    typical: ClassVar[str] = '1 um to 10 um at 25 deg; 5 um/rad^2 to 50 um/rad^2'
    source: ClassVar[str] = (
        'FARO knowledge base, spherically mounted retroreflectors: dihedral errors shift the '
        'return beam'
    )
    signature: ClassVar[str] = (
        'range too long or too short towards the edges of the volume, and beam breaks beyond 25 '
        'deg'
    )
    needs: ClassVar[str] = (
        'the target turned about its axis between runs, or realigned at some positions'
    )

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return k, k_u, k_w."""
        machine = state.machine
        to_tracker = -state.beam / np.linalg.norm(state.beam, axis=1, keepdims=True)
        place = state.q - state.beam
        axis = place - 0.5 * (machine.lower + machine.upper)
        axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        up = np.broadcast_to(state.R_machine_tracker[:, 2], axis.shape)
        if np.min(np.linalg.norm(np.cross(up, axis), axis=1)) < 1e-6:
            up = np.broadcast_to(state.R_machine_tracker[:, 0], axis.shape)
        side = np.cross(up, axis)
        side = side / np.linalg.norm(side, axis=1, keepdims=True)
        upward = np.cross(axis, side)
        dot = [np.einsum('ij,ij->i', to_tracker, e) for e in (axis, side, upward)]
        off_axis = np.hypot(dot[1], dot[2])
        angle = np.arctan2(off_axis, dot[0])
        scale = np.where(off_axis > 1e-12, angle / np.maximum(off_axis, 1e-12), 1.0)
        factors = np.stack([angle**2, scale * dot[1], scale * dot[2]], axis=1)
        columns = -to_tracker[:, :, None] * factors[:, None, :]
        return Terms(('k', 'k_u', 'k_w'), ('m/rad^2', 'm/rad', 'm/rad'), ('',) * 3, columns)
