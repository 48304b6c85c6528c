# SPDX-License-Identifier: Apache-2.0
"""Table tilt: the moving weight of an axis tilts table and tracker.

delta = c (q_a - q0_a) e_k x r, added over rotations k about X, Y and Z and axes a; r is the beam
from the tracker to the target, q0_a the zero position of the axis, else its minimum. Where the
rotation has another centre, a shift by a function of q_a is added, which is straightness and
positioning of that axis. It is the same for all places of the tracker if the centre is fixed to
the machine: from several places, a table that tilts beside the tracker differs from one that
carries it.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.effects.action import turned_about_zero_by_axis, turned_by_axis
from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.free import Free
from otf_core.effects.position import travel_from_reference
from otf_core.model.frames import XYZ


class TableTilt(Effect):
    """Rotation of all that is measured, in proportion to axis positions."""

    name: ClassVar[str] = 'table_tilt'
    cause: ClassVar[str] = 'a moving mass shifts the load on levelling elements or foundation'
    equation: ClassVar[str] = 'c (q_a - q0_a) e_k x r, k = X, Y, Z'
    coefficients: ClassVar[str] = 'c as tilt_k_by_a: tilt about k per travel of axis a'
    typical: ClassVar[str] = '1 urad to 20 urad over the travel'
    source: ClassVar[str] = (
        'Sanders et al., J. Manuf. Mater. Process. 2023, 7, 60, section 1.2.2 (why the tracker '
        'stands on the table)'
    )
    signature: ClassVar[str] = 'like an angular error of the axis, but about the tracker'
    needs: ClassVar[str] = 'a second tracker place, or a level sensor on the table'
    rigid: ClassVar[bool] = True

    free: ClassVar[tuple[Free, ...]] = (
        Free(
            ('{axis}',),
            (10,),
            'the tilt is not proportional to the position',
            (1,),
            turned_by_axis,
        ),
        *(
            Free(
                ('{axis}',),
                (order,),
                words,
                (1,),
                turned_about_zero_by_axis,
                several_places=True,
            )
            for order, words in (
                (1, 'the table tilts about a point of the machine, not about the tracker'),
                (10, 'it tilts about a point of the machine, not in proportion to the position'),
            )
        ),
    )

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Tilt over the range of the axis, of the coefficient that displaces most."""
        name, machine = fitted.strongest, fitted.machine
        _, about, _, axis = name.split('_')
        place = machine.axis_names.index(axis)
        range_m = float(machine.upper[place] - machine.lower[place])
        remark = f'over the {1e3 * range_m:.4g} mm of {axis}'
        return (Size(f'about {about} by {axis}', ({name: range_m},), 'rad', remark),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return tilt_X_by_X ... tilt_Z_by_Z: axis of the tilt, axis that moves."""
        travel, axes = travel_from_reference(state), state.machine.axis_names
        names, columns = [], []
        for k, e in zip(XYZ, np.eye(3), strict=True):
            turned = np.cross(e, state.beam)
            for a, axis in enumerate(axes):
                names.append(f'tilt_{k}_by_{axis}')
                columns.append(travel[:, a, None] * turned)
        return Terms(tuple(names), ('rad/m',) * 9, axes * 3, np.stack(columns, axis=2))
