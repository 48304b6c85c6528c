# SPDX-License-Identifier: Apache-2.0
"""Inputs that a smooth function may depend on, by name, and how they are scaled to [-1, 1].

Time, axis positions, sense of travel, feed, what happened since the last stop or reversal, place
in the path, direction and length of the beam, signals recorded beside the samples, and those with
numbers of their own (``located_inputs``). A distance or a time since something is compressed to
s / (s + s0), so that what dies out needs few functions. Functions are Legendre polynomials; of a
phase they are harmonics, of what switches its responses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial import legendre

from otf_core.arrays import Array
from otf_core.effects.located_inputs import cycle_period, found_kind, numbers_of
from otf_core.effects.switching import Switching
from otf_core.effects.terms import State
from otf_core.errors import ConfigError
from otf_core.model.frames import XYZ
from otf_core.model.path import MOVING

SIGNAL = 'signal:'
"""Head of the names of signals recorded beside the samples."""
CORNER_LENGTH, REVERSAL_LENGTH, STOP_TIME = 0.03, 0.03, 0.5
"""m, m or rad, and s; s0 of distances from corners, of travel since a reversal, of time since a
stop."""
UNITS = {
    'time': 's', 'feed': 'm/s', 'acceleration': 'm/s^2', 'since_stop': 's', 'lap': '', 'leg': '',
    'range': 'm', 'azimuth': 'rad', 'elevation': 'rad', 'from_corner': 'm', 'to_corner': 'm',
    'from_turn': '', 'to_turn': '',
}  # fmt: skip
"""Units of the inputs that do not belong to an axis."""
OF_AXIS = {'sense': '', 'since_reversal': 'm'}
"""The same for inputs such as ``sense_x``; positions are ``x``, ``y``, ``z``, and ``a``, ``b``,
``c`` of rotary axes, for which m stands for rad."""
_LINEAR = tuple(a.lower() for a in XYZ)
LETTERS = (*_LINEAR, 'a', 'b', 'c')


def known_input(name: str) -> bool:
    """Return whether a name is one of an input."""
    head, _, axis = name.rpartition('_')
    own = (head in OF_AXIS and axis in LETTERS) or found_kind(name) is not None
    return own or name in UNITS or name in LETTERS or name.startswith(SIGNAL)


def unit_of_input(name: str) -> str:
    """Unit of an input; signals have those of their topic, which are not known here."""
    if name in LETTERS:
        return 'm' if name in _LINEAR else 'rad'
    if kind := found_kind(name):
        return kind.unit
    return UNITS.get(name, OF_AXIS.get(name.rpartition('_')[0], ''))


def label_of(name: str) -> str:
    """Name of an input for pictures."""
    kind = found_kind(name)
    return kind.label if kind else name


def compression(name: str) -> float:
    """Distance, time or angle s0 over which an input is compressed; 0 for none."""
    if kind := found_kind(name):
        return kind.length
    if name.endswith('_corner'):
        return CORNER_LENGTH
    if name.startswith('since_reversal'):
        return REVERSAL_LENGTH
    return STOP_TIME if name == 'since_stop' else 0.0


def input_values(state: State, name: str) -> Array:
    """Values of an input, shape (n,), SI.

    Raises
    ------
    ConfigError
        If the name is unknown, or a signal is not in the recording.
    """
    axes = [a.lower() for a in state.machine.axis_names]
    if name in axes:
        return np.asarray(state.q[:, axes.index(name)])
    head, _, axis = name.rpartition('_')
    if head == 'sense' and axis in axes:
        own = state.direction[:, axes.index(axis)]
        return np.where(np.abs(own) > MOVING, np.sign(own), 0.0)
    if name in state.more:
        return state.more[name]
    if kind := found_kind(name):
        return kind.values(state, numbers_of(name))
    if name in _PLAIN:
        return np.asarray(_PLAIN[name](state))
    if name.startswith(SIGNAL):
        raise ConfigError(f'{name}: not among the signals of this run')
    raise ConfigError(f"input '{name}' is unknown")


def _turn(first: Array, second: Array) -> Array:
    return np.asarray(np.linalg.norm(second - first, axis=1))


_PLAIN: dict[str, Callable[[State], Array]] = {
    'time': lambda s: s.time,
    'feed': lambda s: s.speed,
    'from_corner': lambda s: s.from_corner,
    'to_corner': lambda s: s.to_corner,
    'from_turn': lambda s: _turn(s.before, s.direction),
    'to_turn': lambda s: _turn(s.direction, s.after),
    'range': lambda s: np.asarray(np.linalg.norm(s.beam, axis=1)),
    'azimuth': lambda s: np.arctan2(s.beam[:, 1], s.beam[:, 0]),
    'elevation': lambda s: np.arctan2(s.beam[:, 2], np.hypot(s.beam[:, 0], s.beam[:, 1])),
}

Span = tuple[float, float]
"""Smallest and largest value of an input for which a function is known."""


def span_of(states: Sequence[State], name: str) -> Span:
    """Range of an input over runs; of an azimuth about its mean direction."""
    if compression(name):
        return 0.0, float(max(input_values(s, name).max(initial=0.0) for s in states))
    if name in LETTERS:
        axis = states[0].machine.axes[name.upper()]
        return axis.min, axis.max
    if period := cycle_period(name):
        return 0.0, period
    if name == 'time' or Switching.of(name):
        return 0.0, max(s.end for s in states)
    values = np.concatenate([input_values(s, name) for s in states])
    if name == 'azimuth':
        middle = float(np.angle(np.exp(1j * values).mean()))
        values = middle + np.angle(np.exp(1j * (values - middle)))
    return float(values.min(initial=0.0 if not len(values) else np.inf)), float(values.max())


def scaled_input(name: str, values: Array, span: Span) -> Array:
    """Values scaled so that the range becomes [-1, 1]; beyond it the ends."""
    low, high = span
    if name == 'azimuth':
        middle = 0.5 * (low + high)
        values = middle + np.angle(np.exp(1j * (values - middle)))
    bend = compression(name)
    if bend:
        low, high = low / (low + bend), 1.0
        values = values / (values + bend)
    width = high - low
    if width <= 0.0:
        return np.zeros_like(values)
    return np.clip(2.0 * (values - low) / width - 1.0, -1.0, 1.0)


def unscaled_input(name: str, place: Array, span: Span) -> Array:
    """Values of an input at places in [-1, 1]: the inverse of ``scaled_input``."""
    low, high = span
    bend = compression(name)
    if bend:
        share = 0.5 * (place + 1.0)
        return np.asarray(np.minimum(share * bend / np.maximum(1.0 - share, 1e-9), high))
    return np.asarray(low + 0.5 * (place + 1.0) * (high - low))


def functions_of(name: str, place: Array, order: int, span: Span = (-1.0, 1.0)) -> Array:
    """Functions up to an order of an input at places in [-1, 1], shape (n, order + 1).

    Legendre polynomials; of a phase 1, cosine, sine, cosine of twice the phase ...; of what
    switches those of the times that ``span`` says.
    """
    if switching := Switching.of(name):
        return switching.functions(unscaled_input(name, place, span), order)
    if not cycle_period(name):
        return np.asarray(legendre.legvander(place, order))
    return harmonics(np.pi * place, order)


def harmonics(phase: Array, order: int) -> Array:
    """1, cosine, sine, cosine of twice the phase (n,) ..., shape (n, order + 1)."""
    number = np.arange(order + 1)
    angle = phase[:, None] * ((number + 1) // 2)
    return np.where(number % 2, np.cos(angle), np.sin(angle) + (number == 0))


def shown_places(name: str, count: int) -> Array:
    """Places in [-1, 1] at which a function of an input is shown: those that it can have."""
    if name.startswith('sense_'):
        return np.array([-1.0, 0.0, 1.0])
    kind = found_kind(name)
    return np.linspace(-1.0, 1.0, 2 if kind and kind.order == 1 else count)


def nodes_of(name: str, order: int) -> Array:
    """Places in [-1, 1] that determine functions up to an order.

    Chebyshev-Lobatto points; of a phase evenly spaced ones.
    """
    if cycle_period(name):
        return np.asarray(2.0 * np.arange(order + 1) / (order + 1) - 1.0)
    if not order:
        return np.zeros(1)
    return np.asarray(-np.cos(np.pi * np.arange(order + 1) / order))
