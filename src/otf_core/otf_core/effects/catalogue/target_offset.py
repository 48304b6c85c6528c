# SPDX-License-Identifier: Apache-2.0
"""Target offset: the target does not sit where machine.yaml says.

delta = sum over the axes a of r_a(q_a) x dT, with the rotations r_a of the error tables and the
wrong part dT of the offset. Without tables it is zero.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.effects.base import Coefficients, Contribution, Effect, Shape, Size, State, Terms
from otf_core.effects.sizes import vector_size
from otf_core.model.frames import XYZ


class TargetOffset(Effect):
    """Rotations act through a lever that is not the stated one."""

    name: ClassVar[str] = 'target_offset'
    cause: ClassVar[str] = 'wrong tool length or offset of the target entered'
    equation: ClassVar[str] = 'sum over a of r_a(q_a) x dT'
    coefficients: ClassVar[str] = 'dT_a: actual minus stated offset along a'
    typical: ClassVar[str] = '1 mm to 20 mm of offset: 0.2 um per 10 mm at 20 urad'
    source: ClassVar[str] = 'Bryan, Precision Engineering 1 (1979) 129 (Abbe principle)'
    signature: ClassVar[str] = 'no trace in one run: the straightness tables absorb it'
    needs: ClassVar[str] = 'runs with a second and a third target offset'
    contributions: ClassVar[tuple[Contribution, ...]] = (
        Contribution('target offset', ('target_offset',)),
    )

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Offset, with its direction where one component is most of it."""
        return (vector_size(fitted, [{f'dT_{a}': 1.0} for a in XYZ], 'm', ''),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return dT_X, dT_Y, dT_Z."""
        rotation = np.zeros((len(state.q), 3))
        if state.tables is not None:
            for k, letter in enumerate('ABC'):
                for a, axis in enumerate(state.machine.axis_names):
                    rotation[:, k] += state.tables.motions[f'E{letter}{axis}'].at(state.q[:, a])
        columns = np.stack([np.cross(rotation, e) for e in np.eye(3)], axis=2)
        return Terms(tuple(f'dT_{a}' for a in XYZ), ('m',) * 3, ('',) * 3, columns)
