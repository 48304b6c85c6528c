# SPDX-License-Identifier: Apache-2.0
"""Vibration: target and table swing against each other at a fixed frequency.

delta = S sin(2 pi f t) + C cos(2 pi f t) with vectors S and C; t on the clock of the tracker.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms, Wave
from otf_core.effects.free import Free
from otf_core.model.frames import XYZ

SECONDS = 2.0
"""Stretch over which the shapes to try keep their phase; a search refines them from there."""


def ringing_displacement(state: State, shape: Shape) -> Terms:
    """Sine and cosine along X, Y, Z of the time since the start of a leg."""
    since = state.more.get('since_stop', state.time)
    return _swing(shape['frequency'], since)


def _swing(frequency: float, time: Array) -> Terms:
    phase = 2.0 * np.pi * frequency * time
    columns = [wave[:, None, None] * np.eye(3) for wave in (np.sin(phase), np.cos(phase))]
    names = tuple(f'{part}_{a}' for part in 'SC' for a in XYZ)
    return Terms(names, ('m',) * 6, XYZ * 2, np.concatenate(columns, axis=2))


class Vibration(Effect):
    """Oscillation in time."""

    name: ClassVar[str] = 'vibration'
    cause: ClassVar[str] = 'pumps, fans, hydraulics, or a position loop that oscillates'
    equation: ClassVar[str] = 'S sin(2 pi f t) + C cos(2 pi f t)'
    coefficients: ClassVar[str] = (
        'S_a, C_a: amplitudes of sine and cosine along a; shape: frequency f'
    )
    typical: ClassVar[str] = '0.5 um to 5 um, 5 Hz to 200 Hz'
    source: ClassVar[str] = 'ISO/TR 230-8:2010 (vibrations of machine tools)'
    signature: ClassVar[str] = (
        'a narrow line in the spectrum of the samples, at standstill as well'
    )
    needs: ClassVar[str] = (
        'more than two samples per oscillation; two feeds, as at one feed a cyclic error looks '
        'like it'
    )
    shape_names: ClassVar[tuple[str, ...]] = ('frequency',)
    shape_units: ClassVar[tuple[str, ...]] = ('Hz',)
    refine: ClassVar[str] = 'frequency'
    refine_width: ClassVar[float] = 2e-4
    wave: ClassVar[Wave | None] = Wave('frequency', in_time=True, probe=10.0)

    free: ClassVar[tuple[Free, ...]] = (
        Free(
            ('since_stop',),
            (6,),
            'it is excited by every start and decays',
            (1,),
            ringing_displacement,
            of_shape=True,
            zero_at=1.0,
        ),
    )

    def shapes(self, state: State) -> Sequence[Shape]:
        """Frequencies up to half the sample rate, 1 / (2 * SECONDS) apart."""
        step = np.diff(state.time)
        rate = 1.0 / float(np.median(step)) if len(step) and np.median(step) > 0 else 1.0
        count = int(rate * SECONDS)
        return tuple({'frequency': k / (2.0 * SECONDS)} for k in range(1, count))

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Amplitude along every direction that takes part."""
        remark = f'amplitude, {fitted.shape["frequency"]:.4g} Hz'
        return tuple(
            Size(f'along {a}', ({f'S_{a}': 1.0}, {f'C_{a}': 1.0}), 'm', remark)
            for a in fitted.axes
        )

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return S_X, S_Y, S_Z, C_X, C_Y, C_Z; directions of the swing, no moving axis."""
        return _swing(shape['frequency'], state.time)
