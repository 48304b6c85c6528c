# SPDX-License-Identifier: Apache-2.0
"""Smooth functions of time that slow effects share: exponential approach, then a general drift.

g_1(t) = (1 - exp(-t / tau)) / (1 - exp(-until / tau)), so its coefficient is the size reached at
``until``; g_k(t) = P_k(2 t / until - 1) - P_k(-1) for k = 2 to ``order``, Legendre polynomials
less their value at the start. A time constant of many durations makes g_1 a straight line. Where a
shape has ``since``, both are less their value there instead, and g_1 is one at ``until`` again.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.polynomial import legendre

from otf_core.arrays import Array
from otf_core.effects.base import Effect, ShapeParameter
from otf_core.effects.terms import Shape, State, Terms

ORDER = 4
TIME_CONSTANTS = (0.1, 0.3, 1.0)
"""Time constants worth trying, in durations of the recording."""
REACHED = 'by the end of the run'
"""When a drift has its size."""
LINEAR = 100.0
"""In durations of the recording; bends the line by less than 0.2 % of its end."""
STRAIGHT = 10.0
"""Time constants of so many durations and more make a straight line, whatever they are."""

SHAPE = (
    ShapeParameter('tau', 's', width=1.0),
    ShapeParameter('until', 's', 0.0),
    ShapeParameter('order', '', float(ORDER)),
)
"""``until`` 0 stands for the end of the recording; a time constant was found on a raster."""


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


def bends(shape: Shape) -> bool:
    """Whether the time constant bends the course."""
    return shape['tau'] < STRAIGHT * shape.get('until', 0.0)


def over_time(state: State, shape: Shape, base: Terms) -> Terms:
    """Terms times each function of time, one function after the other."""
    functions = time_functions(state, shape)
    names = tuple(name + suffix for suffix, _ in functions for name in base.names)
    columns = np.concatenate([g[:, None, None] * base.columns for _, g in functions], axis=2)
    count = len(functions)
    return Terms(names, base.units * count, base.axes * count, columns)


drifting = partial(Effect, shape=SHAPE, shapes=drift_shapes, shape_matters=bends, own_per_run=True)
"""Effects whose course in time is one of these functions."""
