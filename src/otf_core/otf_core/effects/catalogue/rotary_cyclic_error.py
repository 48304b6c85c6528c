# SPDX-License-Identifier: Apache-2.0
"""Cyclic error of a rotary axis: an angular error that repeats n times per turn.

delta = (S_a sin(n q_a) + C_a cos(n q_a)) J_a, added over the rotary axes a; J_a is the
displacement per rad of the angular positioning of the axis. n is the number of turns of the worm
or of the gear stage per turn of the table, its teeth, or a harmonic of the encoder. Points that
stand for a stretch of the path have the mean over it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.terms import rotary_columns

PER_TURN = 'per_turn'
HIGHEST = 180
"""Waves per turn that are tried at most."""
NODES_PER_WAVE = 4
"""Longer waves are errors at the nodes of a table, which leaves next to nothing of them."""


class RotaryCyclicError(Effect):
    """Angular positioning error that repeats with worm, gear or encoder."""

    name: ClassVar[str] = 'rotary_cyclic_error'
    cause: ClassVar[str] = 'run-out of worm, gear or encoder disc: once or twice per turn of each'
    equation: ClassVar[str] = '(S_a sin(n q_a) + C_a cos(n q_a)) J_a'
    coefficients: ClassVar[str] = (
        'S_a, C_a: amplitudes of sine and cosine, rotary axis a; shape: per_turn, the number n of '
        'waves per turn'
    )
    typical: ClassVar[str] = '5 urad to 30 urad, n the number of teeth; 1 urad for direct drives'
    source: ClassVar[str] = 'eccentricity e of a worm or gear of radius r: e / r, once per turn'
    signature: ClassVar[str] = (
        'waves at fixed angles of the axis where it moves together with another one; none on '
        'circles of the axis alone'
    )
    needs: ClassVar[str] = (
        'legs that drive the axis together with another one, with samples closer than half a '
        'period, or stops closer than that'
    )
    shape_names: ClassVar[tuple[str, ...]] = (PER_TURN,)
    shape_units: ClassVar[tuple[str, ...]] = ('',)
    stays_in_place: ClassVar[bool] = True
    held_by_tables: ClassVar[bool] = True

    def shapes(self, state: State) -> Sequence[Shape]:
        """Every whole number of waves per turn that tables cannot follow."""
        axes = state.machine.axes
        pitch = min((axes[n].table_pitch for n in state.machine.rotary_names), default=np.pi)
        lowest = max(2, math.ceil(2.0 * np.pi / (NODES_PER_WAVE * pitch)))
        return tuple({PER_TURN: float(n)} for n in range(lowest, HIGHEST + 1))

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Amplitude of every axis that takes part."""
        remark = f'amplitude, {fitted.shape[PER_TURN]:.0f} per turn'
        return tuple(
            Size(f'of {a}', ({f'S_{a}': 1.0}, {f'C_{a}': 1.0}), 'rad', remark) for a in fitted.axes
        )

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return S and C of every rotary axis."""
        turning, axes = state.turning, state.machine.rotary_names
        n = shape[PER_TURN]
        phase = n * state.q
        held = np.ones_like(phase)
        if turning is not None:  # mean over what is passed at an even speed
            held = np.sinc(np.sqrt(3.0) * n * turning.spread / np.pi)
        columns = [rotary_columns(state, held * wave) for wave in (np.sin(phase), np.cos(phase))]
        names = tuple(f'{part}_{a}' for part in 'SC' for a in axes)
        return Terms(names, ('rad',) * len(names), axes * 2, np.concatenate(columns, axis=2))
