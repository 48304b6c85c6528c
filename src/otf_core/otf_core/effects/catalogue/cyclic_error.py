# SPDX-License-Identifier: Apache-2.0
"""Cyclic error: an error of an axis that repeats along it.

delta = (S_a sin(2 pi q_a / p) + C_a cos(2 pi q_a / p)) e_a, added over the axes a; p is the pitch
of the screw, the signal period of the scale or a whole-number part of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms, Wave
from otf_core.effects.free import Free

WAVES = 3
"""A period fits at least so often into the longest axis; longer waves are for the tables."""


def harmonics(state: State, shape: Shape) -> Terms:
    """S1_X ... C1_Z and S2_X ... C2_Z: the wave and its second harmonic."""
    phase = 2.0 * np.pi * state.q / shape['period']
    waves = [wave(k * phase) for k in (1, 2) for wave in (np.sin, np.cos)]
    columns = [wave[:, :, None] * np.eye(3) for wave in waves]
    axes = state.machine.axis_names
    names = tuple(f'{part}{k}_{a}' for k in (1, 2) for part in 'SC' for a in axes)
    return Terms(names, ('m',) * 12, axes * 4, np.concatenate(columns, axis=2))


class CyclicError(Effect):
    """Positioning error that repeats with screw or scale."""

    name: ClassVar[str] = 'cyclic_error'
    cause: ClassVar[str] = 'wobble of the screw per turn; interpolation within the scale period'
    equation: ClassVar[str] = '(S_a sin(2 pi q_a / p) + C_a cos(2 pi q_a / p)) e_a'
    coefficients: ClassVar[str] = (
        'S_a, C_a: amplitudes of sine and cosine, axis a; shape: period p'
    )
    typical: ClassVar[str] = '1 um to 5 um per turn of a screw; 0.2 um for a scale of 20 um'
    source: ClassVar[str] = (
        'HEIDENHAIN, Exposed Linear Encoders (position error within one signal period: +/- 1 %)'
    )
    signature: ClassVar[str] = (
        'waves of period p / d_a on diagonals, at fixed positions of the axis; none on lines '
        'along the axis'
    )
    needs: ClassVar[str] = (
        'samples closer than half a period; two feeds, as at one feed it looks like vibration'
    )
    shape_names: ClassVar[tuple[str, ...]] = ('period',)
    shape_units: ClassVar[tuple[str, ...]] = ('m',)
    refine: ClassVar[str] = 'period'
    refine_width: ClassVar[float] = 0.01
    wave: ClassVar[Wave | None] = Wave('period', in_time=False, probe=0.01)
    stays_in_place: ClassVar[bool] = True

    free: ClassVar[tuple[Free, ...]] = (
        Free(
            ('{axis}',),
            (2,),
            'the wave has harmonics, and its amplitude changes along the axis',
            acts=harmonics,
            of_shape=True,
        ),
    )

    def shapes(self, state: State) -> Sequence[Shape]:
        """Periods from four sample spacings up, as close as the longest axis can tell apart."""
        step = np.linalg.norm(np.diff(state.q, axis=0), axis=1)
        spacing = float(np.median(step[step > 1e-9])) if np.any(step > 1e-9) else 1e-3
        length = float(np.max(state.machine.upper - state.machine.lower))
        frequency = np.arange(WAVES / length, 0.25 / spacing, 0.5 / length)
        return tuple({'period': float(1.0 / f)} for f in frequency)

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Amplitude of every axis that takes part."""
        remark = f'amplitude, period {1e3 * fitted.shape["period"]:.3g} mm'
        return tuple(
            Size(f'of {a}', ({f'S_{a}': 1.0}, {f'C_{a}': 1.0}), 'm', remark) for a in fitted.axes
        )

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return S_X, S_Y, S_Z, C_X, C_Y, C_Z."""
        phase = 2.0 * np.pi * state.q / shape['period']
        columns = [wave[:, :, None] * np.eye(3) for wave in (np.sin(phase), np.cos(phase))]
        axes = state.machine.axis_names
        names = tuple(f'{part}_{a}' for part in 'SC' for a in axes)
        return Terms(names, ('m',) * 6, axes * 2, np.concatenate(columns, axis=2))
