# SPDX-License-Identifier: Apache-2.0
"""Causes that the catalogue does not hold: a jolt, and balls that pass under the slides."""

from functools import partial

import numpy as np

from otf_core.effects import Effect, Terms
from otf_core.effects.base import ShapeParameter


@partial(Effect, shape=(ShapeParameter('t0', 's'),))
def nameless_jolt(state, shape):
    """A vector (A_X, A_Y, A_Z) from a moment on."""
    columns = (state.time > shape['t0'])[:, None, None] * np.eye(3)
    return Terms.of(('A_X', 'A_Y', 'A_Z'), 'm', columns, 'XYZ')


@partial(Effect, shape=(ShapeParameter('p', 'm'),))
def nameless_ball_passage(state, shape):
    """Every slide lifts along the axis after it whenever a ball enters the load zone."""
    lift = np.abs(np.sin(np.pi * state.q / shape['p']))
    columns = lift[:, None, :] * np.roll(np.eye(3), 1, axis=0)
    return Terms.of(('A_X', 'A_Y', 'A_Z'), 'm', columns, 'XYZ')
