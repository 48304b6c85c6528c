# SPDX-License-Identifier: Apache-2.0
"""Thermal expansion of the axes: screw or scale grows during the run.

delta = S_a g(t) (q_a - q0_a) e_a, added over the axes a; g as in ``drift``, q0_a the zero position
of the axis, else its minimum. S_a = expansion coefficient times warming.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.effects import drift
from otf_core.effects.action import Acting
from otf_core.effects.base import Coefficients, Contribution, Shape, Size, State, Terms
from otf_core.effects.free import Free
from otf_core.effects.position import travel_from_reference

AT_ONCE = 1e-6
"""s; time constant of a warming that is complete when the run starts."""


def strain_displacement(state: State, shape: Shape) -> Terms:
    """S_X, S_Y, S_Z: displacement by the strain of each axis."""
    columns = travel_from_reference(state)[:, :, None] * np.eye(3)
    axes = state.machine.axis_names
    return Terms(tuple(f'S_{a}' for a in axes), ('m/m',) * 3, axes, columns)


def strain_and_shift_displacement(state: State, shape: Shape) -> Terms:
    """The same and D_X, D_Y, D_Z: displacement of the reference position of each axis."""
    strain, shift = strain_displacement(state, shape), growth_displacement(state, shape)
    names = (*strain.names, *(f'D_{a}' for a in shift.axes))
    columns = np.concatenate([strain.columns, shift.columns], axis=2)
    return Terms(names, strain.units + shift.units, strain.axes + shift.axes, columns)


def growth_displacement(state: State, shape: Shape) -> Terms:
    """S_X, S_Y, S_Z: displacement of each axis along itself."""
    columns = np.broadcast_to(np.eye(3), (len(state), 3, 3))
    axes = state.machine.axis_names
    return Terms(tuple(f'S_{a}' for a in axes), ('m',) * 3, axes, columns)


def approach_displacement(state: State, shape: Shape) -> Terms:
    """S_X, S_Y, S_Z: displacement of each axis along itself that approaches its end."""
    _, course = drift.time_functions(state, shape)[0]
    terms = growth_displacement(state, shape)
    return Terms(terms.names, terms.units, terms.axes, terms.columns * course[:, None, None])


class ThermalAxisExpansion(drift.DriftingEffect):
    """Strain of each axis that grows with time."""

    name: ClassVar[str] = 'thermal_axis_expansion'
    cause: ClassVar[str] = 'screw, scale or bed of an axis warms up during the run'
    equation: ClassVar[str] = 'S_a g(t) (q_a - q0_a) e_a'
    coefficients: ClassVar[str] = (
        'S_a: strain of axis a reached at until; S_a_2, ...: further functions of time; shape: '
        'time constant tau, until (0: end of the run), order of the last function'
    )
    typical: ClassVar[str] = (
        '5 um/m to 50 um/m in a run: steel 11.7 um/(m K), time constants 10 min to 60 min'
    )
    source: ClassVar[str] = (
        'ISO 230-3:2020 (thermal distortion by moving linear axes); Mayr et al., '
        'CIRP Annals 61 (2012) 771'
    )
    signature: ClassVar[str] = (
        'diagonals rotate and bend increasingly with time; repeated lines differ by a slope'
    )
    needs: ClassVar[str] = (
        'one reference line repeated every few minutes, one line along the beam, axis temperatures'
    )
    contributions: ClassVar[tuple[Contribution, ...]] = (
        Contribution(
            'machine temperature',
            ('machine_temperature', 'expansion'),
            {'tau': AT_ONCE, 'until': 0.0, 'order': 1.0},
        ),
    )

    follows: ClassVar[tuple[Acting, ...]] = (strain_displacement, strain_and_shift_displacement)
    switches: ClassVar[tuple[Acting, ...]] = (strain_displacement,)
    free: ClassVar[tuple[Free, ...]] = (
        Free(
            ('time',),
            (10,),
            'the strain does not follow an exponential in time',
            (1,),
            acts=strain_displacement,
            zero_at=-1.0,
        ),
        Free(
            ('{axis}',),
            (2,),
            'the expansion is not proportional to the distance from the zero position of the axis',
            acts=approach_displacement,
            of_shape=True,
            essential=0,
        ),
        Free(
            ('time', '{axis}'),
            (6, 2),
            'the expansion is not proportional to the distance from the zero position of the '
            'axis and does not follow an exponential in time',
            (1, 0),
            acts=growth_displacement,
            zero_at=-1.0,
            essential=1,
        ),
    )

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Strain of every axis that takes part."""
        return tuple(
            Size(f'of {a}', (drift.value_reached(f'S_{a}', fitted.shape),), 'm/m', drift.REACHED)
            for a in fitted.axes
        )

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return S_X, S_Y, S_Z: strain at ``until``; S_X_2 ...: further functions of time."""
        travel = travel_from_reference(state)
        functions = drift.time_functions(state, shape)
        columns = [state.by_axes(travel * g[:, None]) for _, g in functions]
        axes, count = state.machine.axis_names, len(functions)
        if state.turning is not None:  # a uniform strain turns no axis
            axes = tuple(a for a in axes if a not in state.machine.rotary_names)
            places = [state.machine.column(a) for a in axes]
            columns = [own[:, :, places] for own in columns]
        names = tuple(f'S_{a}{suffix}' for suffix, _ in functions for a in axes)
        return Terms(names, ('m/m',) * 3 * count, axes * count, np.concatenate(columns, axis=2))
