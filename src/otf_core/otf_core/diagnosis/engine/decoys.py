# SPDX-License-Identifier: Apache-2.0
"""Shapes outside the catalogue, so that an unknown effect need not be forced into it.

A jump at a moment and a slow wave in time are followed half-way by the smooth drifts of the
catalogue. Where one of them explains the run better than any effect, the gap has no known cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.engine.time_products import InTime
from otf_core.effects.action import Acting, rigid_tracker, vector
from otf_core.effects.base import Effect, Shape, State

MOMENTS = 40
"""Moments of a jump that are tried."""
PERIODS = 24
"""Periods of a slow wave that are tried."""
SHORTEST = 8.0
"""s; shortest period of a slow wave."""


class Jump(InTime):
    """Shift of the target or the tracker at a moment."""

    name: ClassVar[str] = 'jump'
    cause: ClassVar[str] = 'something slipped or was knocked'
    equation: ClassVar[str] = 'D [t > moment]'
    typical: ClassVar[str] = 'any'
    source: ClassVar[str] = 'not of the catalogue'
    signature: ClassVar[str] = 'everything lies shifted from a moment on'
    needs: ClassVar[str] = 'lines repeated before and after'
    shape_names: ClassVar[tuple[str, ...]] = ('moment',)
    shape_units: ClassVar[tuple[str, ...]] = ('s',)
    heads: ClassVar[tuple[str, ...]] = ('J',)
    refine: ClassVar[str] = 'moment'
    refine_width: ClassVar[float] = 0.02
    switches: ClassVar[tuple[Acting, ...]] = (vector,)

    def shapes(self, state: State) -> Sequence[Shape]:
        """Moments spread over the run."""
        return tuple({'moment': float(t)} for t in np.linspace(0, state.end, MOMENTS + 2)[1:-1])

    def course(self, state: State, shape: Shape) -> Array:
        """Return zero before the moment and one after it."""
        return (state.time > shape['moment']).astype(float)[:, None]


class Knock(Jump):
    """Turn and shift of the tracker, or of what carries it, at a moment."""

    name: ClassVar[str] = 'knock'
    cause: ClassVar[str] = 'somebody knocked against the tracker or its table'
    equation: ClassVar[str] = '(D + W x r) [t > moment]'
    signature: ClassVar[str] = 'everything lies shifted and turned from a moment on'
    switches: ClassVar[tuple[Acting, ...]] = (rigid_tracker,)


class SlowWave(InTime):
    """Shift that swings slowly in time."""

    name: ClassVar[str] = 'slow_wave'
    cause: ClassVar[str] = 'something switches or swings with a period'
    equation: ClassVar[str] = 'S sin(2 pi t / period) + C cos(2 pi t / period)'
    typical: ClassVar[str] = 'any'
    source: ClassVar[str] = 'not of the catalogue'
    signature: ClassVar[str] = 'a shift that comes and goes with a period'
    needs: ClassVar[str] = 'a run of several periods'
    shape_names: ClassVar[tuple[str, ...]] = ('period',)
    shape_units: ClassVar[tuple[str, ...]] = ('s',)
    heads: ClassVar[tuple[str, ...]] = ('S', 'C')
    refine: ClassVar[str] = 'period'
    refine_width: ClassVar[float] = 0.05
    switches: ClassVar[tuple[Acting, ...]] = (vector,)

    def shapes(self, state: State) -> Sequence[Shape]:
        """Periods evenly spaced in frequency, half a turn of the run apart."""
        slowest = 2.0 / max(state.end, SHORTEST)
        number = np.arange(slowest, 1.0 / SHORTEST, 0.5 / max(state.end, SHORTEST))
        step = max(1, len(number) // (4 * PERIODS))
        return tuple({'period': float(1.0 / f)} for f in number[::step])

    def course(self, state: State, shape: Shape) -> Array:
        """Return sine and cosine."""
        phase = 2.0 * np.pi * state.time / shape['period']
        return np.stack([np.sin(phase), np.cos(phase)], axis=1)


DECOYS: tuple[Effect, ...] = (Jump(), Knock(), SlowWave())
DECOY_NAMES = frozenset(d.name for d in DECOYS)
