# SPDX-License-Identifier: Apache-2.0
"""Centre growth: the line of a rotary axis shifts as its housing warms up.

delta = sum over k and axes a of D_k_a g(t) J_ka, J_ka the displacement per unit of the shift of
axis a along k, that is along the directions of what carries it; g as in ``drift``, zero at
``since``: when the first reflector that the axis moves came into view. What the line had shifted
before is in the location errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from otf_core.effects import drift
from otf_core.effects.base import Coefficients, Shape, Size, State, Terms
from otf_core.effects.sizes import vector_size
from otf_core.model.frames import XYZ

LATEST = 0.95
"""Share of the run after which a first pass leaves no time to grow."""


class CentreGrowth(drift.DriftingEffect):
    """Slow shift of the line about which an axis turns."""

    name: ClassVar[str] = 'centre_growth'
    cause: ClassVar[str] = 'bearings, drive and housing of a rotary axis warm up'
    equation: ClassVar[str] = 'D_k_a g(t) J_ka, k = X, Y, Z'
    coefficients: ClassVar[str] = (
        'D_k_a: shift of the line of axis a along k from since to until; D_k_a_2, ...: further '
        'functions of time; shape: time constant tau, until (0: end of the run), order of the '
        'last function, since (0: start of the run)'
    )
    typical: ClassVar[str] = '5 um/h to 30 um/h while it warms up'
    source: ClassVar[str] = 'ISO 230-3:2020 (thermal distortion by rotating and linear motion)'
    signature: ClassVar[str] = (
        'targets on the axis shift with time, in directions that turn with what carries it; '
        'targets elsewhere do not'
    )
    needs: ClassVar[str] = 'one pass of the axis repeated at the end of the run'
    shape_names: ClassVar[tuple[str, ...]] = (*drift.SHAPE_NAMES, 'since')
    shape_units: ClassVar[tuple[str, ...]] = (*drift.SHAPE_UNITS, 's')
    shape_defaults: ClassVar[Mapping[str, float]] = MappingProxyType(
        {**drift.SHAPE_DEFAULTS, 'since': 0.0}
    )

    def shapes(self, state: State) -> Sequence[Shape]:
        """Courses in time from the first sample that a rotary axis moves."""
        since = 0.0
        if state.turning is not None:
            places = [state.machine.column(a) for a in state.machine.rotary_names]
            acts = state.turning.motions[:, :, places, :3].any(axis=(1, 2, 3))
            first = float(state.time[acts].min(initial=state.end))
            since = first if first < LATEST * state.end else 0.0
        return [{**shape, 'since': since} for shape in drift.drift_shapes(state)]

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Shift of every axis that takes part, while its reflectors were in view."""
        since, until = (fitted.shape.get(n, 0.0) for n in ('since', 'until'))
        within = f'within {(until - since) / 60.0:.0f} min, from its first pass on'
        return tuple(
            vector_size(
                fitted,
                [drift.value_reached(f'D_{k}_{a}', fitted.shape) for k in XYZ],
                'm',
                within if since and until else drift.REACHED,
                f'of {a}',
            )
            for a in fitted.axes
        )

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return D_X_a, D_Y_a, D_Z_a of every rotary axis, for each function of time."""
        axes, turning = state.machine.rotary_names, state.turning
        functions = drift.time_functions(state, shape)
        names = [f'D_{k}_{a}{suffix}' for suffix, _ in functions for a in axes for k in XYZ]
        owners = tuple(a for _ in functions for a in axes for _ in XYZ)
        columns = np.zeros((len(state), 3, len(names)))
        if turning is not None:
            places = [state.machine.column(a) for a in axes]
            shifts = turning.motions[:, :, places, :3].reshape(len(state), 3, -1)
            columns = np.concatenate([g[:, None, None] * shifts for _, g in functions], axis=2)
        return Terms(tuple(names), ('m',) * len(names), owners, columns)
