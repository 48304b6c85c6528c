# SPDX-License-Identifier: Apache-2.0
"""Causes that the catalogue does not hold: a jolt, and balls that pass under the slides."""

from typing import ClassVar

import numpy as np

from otf_core.effects import Effect, Terms


class Nameless(Effect):
    """A vector (A_X, A_Y, A_Z) times columns (n, 3, 3)."""

    cause: ClassVar[str] = 'made for tests'
    equation: ClassVar[str] = 'see ``columns``'
    typical: ClassVar[str] = '1 um to 10 um'
    source: ClassVar[str] = 'none'
    signature: ClassVar[str] = ''
    needs: ClassVar[str] = ''

    def terms(self, state, shape):
        return Terms(('A_X', 'A_Y', 'A_Z'), ('m',) * 3, tuple('XYZ'), self.columns(state, shape))


class Jolt(Nameless):
    name: ClassVar[str] = 'nameless_jolt'
    shape_names: ClassVar[tuple[str, ...]] = ('t0',)
    shape_units: ClassVar[tuple[str, ...]] = ('s',)

    def columns(self, state, shape):
        return (state.time > shape['t0'])[:, None, None] * np.eye(3)


class BallPassage(Nameless):
    """Every slide lifts along the axis after it whenever a ball enters the load zone."""

    name: ClassVar[str] = 'nameless_ball_passage'
    shape_names: ClassVar[tuple[str, ...]] = ('p',)
    shape_units: ClassVar[tuple[str, ...]] = ('m',)

    def columns(self, state, shape):
        lift = np.abs(np.sin(np.pi * state.q / shape['p']))
        return lift[:, None, :] * np.roll(np.eye(3), 1, axis=0)
