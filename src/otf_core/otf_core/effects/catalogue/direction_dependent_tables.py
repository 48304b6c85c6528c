# SPDX-License-Identifier: Apache-2.0
"""Direction-dependent tables: errors that differ between forward and backward travel.

delta = 1/2 sign(d_a) sum_k c_k P_k(u_a) J_m(q), added over the six motions m of every axis a; u_a
is the position scaled to [-1, 1] over the axis range, P_k are Legendre polynomials and J_m is the
displacement per unit of the motion. The functions of an endless axis are 1, cos q, sin q, cos 2q
... instead. The constant of the own axis' positioning is backlash.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.polynomial import legendre

from otf_core.arrays import Array
from otf_core.effects.base import BelongsTo, Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.catalogue.backlash import HELD, travel_sign
from otf_core.effects.free import Free
from otf_core.effects.inputs import harmonics
from otf_core.model.chain import Sight
from otf_core.model.machine import Axis
from otf_core.model.motions import DIRECTIONS, ErrorMotion

ORDER = 3


def functions_along(axis: Axis, q: Array, order: int) -> Array:
    """Functions up to an order at positions q (n,) of an axis, m or rad, shape (n, order + 1)."""
    if axis.endless:
        return harmonics(q, order)
    place = (2.0 * q - axis.min - axis.max) / (axis.max - axis.min)
    return np.asarray(legendre.legvander(place, order))


def influence_of(state: State, motion: ErrorMotion) -> Array:
    """Displacement of the target per unit of a motion, shape (n, 3)."""
    if state.turning is None:
        return Sight.of_tool(state.machine).at(state.q).influence(motion)
    column = state.machine.column(motion.axis)
    return state.turning.motions[:, :, column, DIRECTIONS.index(motion.direction)]


def reversed_motions(state: State, shape: Shape) -> Terms:
    """Half of each motion with the sign of the travel of its axis: m per m or rad of reversal."""
    sign, machine = 0.5 * travel_sign(state, {HELD: 0.0}), state.machine
    motions = machine.motions
    columns = [sign[:, machine.column(m.axis), None] * influence_of(state, m) for m in motions]
    names, units = tuple(str(m) for m in motions), tuple(m.unit for m in motions)
    return Terms(names, units, tuple(m.axis for m in motions), np.stack(columns, axis=2))


class DirectionDependentTables(Effect):
    """Reversal errors of all six motions of an axis that change along it."""

    name: ClassVar[str] = 'direction_dependent_tables'
    cause: ClassVar[str] = (
        'local wear of a screw, play in guideways: the slide shifts and turns when travel reverses'
    )
    equation: ClassVar[str] = '1/2 sign(d_a) c_k P_k(u_a) J_m(q), motion m of axis a'
    coefficients: ClassVar[str] = (
        'c_k of motion m as m_k, EXX_1 to ECZ_3; of an endless axis c_k of 1, cos q, sin q, '
        'cos 2q; shape: highest order of the polynomials, held as for backlash'
    )
    typical: ClassVar[str] = '1 um to 5 um, 1 urad to 10 urad between forward and backward travel'
    source: ClassVar[str] = (
        'ISO 230-2:2014 (reversal value at each position); forward and backward columns of '
        'compensation files, e.g. LinuxCNC [JOINT_n]COMP_FILE'
    )
    signature: ClassVar[str] = (
        'forward and backward passes of one line differ by a smooth function of position'
    )
    needs: ClassVar[str] = 'every line driven forward and backward'
    belongs_to: ClassVar[BelongsTo] = BelongsTo.REVERSAL
    any_axes: ClassVar[bool] = True
    shape_names: ClassVar[tuple[str, ...]] = ('order', HELD)
    shape_units: ClassVar[tuple[str, ...]] = ('', '')
    shape_defaults: ClassVar[Mapping[str, float]] = MappingProxyType(
        {'order': float(ORDER), HELD: 0.0}
    )

    free: ClassVar[tuple[Free, ...]] = (
        Free(
            ('{axis}',),
            (7,),
            'the reversal error varies along the axis more than a cubic',
            acts=reversed_motions,
        ),
    )

    def shapes(self, state: State) -> Sequence[Shape]:
        """Linear along the axis and the full order, each as for backlash."""
        orders = (1.0, float(ORDER))
        return tuple({'order': k, HELD: held} for k in orders for held in (0.0, 1.0))

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Root mean square along its axis of each motion that displaces much."""
        found_sizes = []
        for head, names in fitted.groups().items():
            motion = ErrorMotion.of(head)
            orders = {n: int(n.rsplit('_', 1)[1]) for n in names}
            wave = fitted.machine.axes[motion.axis].endless
            square = {n: 1.0 / (2 if wave and k else 2 * k + 1) for n, k in orders.items()}
            parts = tuple({n: float(np.sqrt(of))} for n, of in square.items())
            along = f'rms along {motion.axis}'
            found_sizes.append(Size(f'of {motion}', parts, motion.unit, along))
        return tuple(found_sizes)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return EXX_1 ... ECZ_3: motion and order of its function."""
        half, machine, order = (
            0.5 * travel_sign(state, shape),
            state.machine,
            round(shape['order']),
        )
        axes = zip(machine.axis_names, state.q.T, strict=True)
        along = [functions_along(machine.axes[a], values, order) for a, values in axes]
        named = [(m, k) for m in machine.motions for k in range(m.is_positioning, order + 1)]
        columns, start = np.empty((len(state), 3, len(named))), 0
        for motion in machine.motions:
            axis = machine.column(motion.axis)
            own = along[axis][:, None, int(motion.is_positioning) :]
            influence = half[:, axis, None] * influence_of(state, motion)
            end = start + own.shape[2]
            np.multiply(influence[:, :, None], own, out=columns[:, :, start:end])
            start = end
        names = tuple(f'{motion}_{k}' for motion, k in named)
        units, axes_of = tuple(m.unit for m, _ in named), tuple(m.axis for m, _ in named)
        return Terms(names, units, axes_of, columns)
