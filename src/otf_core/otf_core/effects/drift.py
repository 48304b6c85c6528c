# SPDX-License-Identifier: Apache-2.0
"""Smooth functions of time that slow effects share: exponential approach, then a general drift.

g_1(t) = (1 - exp(-t / tau)) / (1 - exp(-until / tau)), so its coefficient is the size reached at
``until``; g_k(t) = P_k(2 t / until - 1) - P_k(-1) for k = 2 to ``order``, Legendre polynomials
less their value at the start. A time constant of many durations makes g_1 a straight line. Where a
shape has ``since``, both are less their value there instead, and g_1 is one at ``until`` again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.polynomial import legendre

from otf_core.arrays import Array
from otf_core.effects.base import Effect, Shape, State

ORDER = 4
SHAPE_NAMES = ('tau', 'until', 'order')
SHAPE_UNITS = ('s', 's', '')
SHAPE_DEFAULTS: Mapping[str, float] = MappingProxyType({'until': 0.0, 'order': float(ORDER)})
"""``until`` 0 stands for the end of the recording."""

TIME_CONSTANTS = (0.1, 0.3, 1.0)
"""Time constants worth trying, in durations of the recording."""
REACHED = 'by the end of the run'
"""When a drift has its size."""
LINEAR = 100.0
"""In durations of the recording; bends the line by less than 0.2 % of its end."""
STRAIGHT = 10.0
"""Time constants of so many durations and more make a straight line, whatever they are."""
TIME_CONSTANT_WIDTH = 1.0
"""Standard deviation of the logarithm of a time constant that a diagnosis found on a raster."""


def time_functions(state: State, shape: Shape) -> list[tuple[str, Array]]:
    """Functions of time with the suffix of their coefficients.

    Parameters
    ----------
    shape : mapping
        tau and until in s, order; since in s, 0 without it.

    Returns
    -------
    list of (str, ndarray of shape (n,))
        '' for the exponential approach, '_2' to '_order' for the polynomials.
    """
    until, tau = shape['until'] or state.end or 1.0, shape['tau']
    since = shape.get('since', 0.0)
    before = np.expm1(-since / tau)
    rise = np.expm1(-until / tau) - before
    functions = [('', (np.expm1(-state.time / tau) - before) / rise)]
    place = 2.0 * state.time / until - 1.0
    for k in range(2, round(shape['order']) + 1):
        unit = np.eye(k + 1)[k]
        start = legendre.legval(2.0 * since / until - 1.0, unit) if since else (-1.0) ** k
        functions.append((f'_{k}', legendre.legval(place, unit) - start))
    return functions


def drift_shapes(state: State) -> Sequence[Shape]:
    """Exponential approaches of several time constants, a line, and a general slow drift."""
    until = state.end or 1.0
    simple = [{'tau': f * until, 'until': until, 'order': 1.0} for f in (*TIME_CONSTANTS, LINEAR)]
    return (*simple, {'tau': LINEAR * until, 'until': until, 'order': float(ORDER)})


def value_reached(name: str, shape: Shape) -> dict[str, float]:
    """Sum of the coefficients of one quantity that it has reached at ``until``."""
    since, until = shape.get('since', 0.0), shape.get('until', 0.0)
    if since and until:
        orders = range(2, round(shape.get('order', 1.0)) + 1)
        start = [legendre.legval(2.0 * since / until - 1.0, np.eye(k + 1)[k]) for k in orders]
        return {name: 1.0, **{f'{name}_{k}': 1.0 - s for k, s in zip(orders, start, strict=True)}}
    odd = range(3, round(shape.get('order', 1.0)) + 1, 2)  # P_k(1) - P_k(-1): 0 for an even k
    return {name: 1.0, **{f'{name}_{k}': 2.0 for k in odd}}


class DriftingEffect(Effect):
    """Base of the effects whose course in time is one of these functions."""

    shape_names: ClassVar[tuple[str, ...]] = SHAPE_NAMES
    shape_units: ClassVar[tuple[str, ...]] = SHAPE_UNITS
    shape_defaults: ClassVar[Mapping[str, float]] = SHAPE_DEFAULTS
    own_per_run: ClassVar[bool] = True

    def loose(self, shape: Shape) -> dict[str, float]:
        """Time constant, where it bends the course."""
        bent = shape['tau'] < STRAIGHT * shape.get('until', 0.0)
        return {'tau': TIME_CONSTANT_WIDTH} if bent else {}

    def shapes(self, state: State) -> Sequence[Shape]:
        """Time constants around the duration, a line, and a general slow drift."""
        return drift_shapes(state)
