# SPDX-License-Identifier: Apache-2.0
"""Inputs that a smooth function may depend on, by name, and how they are scaled to [-1, 1].

Time, axis positions, sense of travel, feed, what happened since the last stop or reversal, place
in the path, direction and length of the beam, signals recorded beside the samples, and those with
numbers of their own, found in data: the phase of a cycle in time or along an axis, before and
after a moment, the distance from a place, the angle of the beam from a direction, time as what
switches feels it. Their names hold the numbers: ``cycle:30``, ``cycle_x:0.01``, ``after:341.5``,
``near:0.1,0.25,-0.2``, ``aside:0.7,0.2``, ``switched:58@0,146``.

A distance or a time since something is compressed to s / (s + s0), so that what dies out needs few
functions. Functions are Legendre polynomials; of a phase they are harmonics, of what switches

    f_1 = r_1 - r_2 + r_3 - ...,    f_k = r_k for k > 1,    r_k(t) = 1 - exp(-(t - t_k) / lag)

after t_k, 0 before: the response of first order to something that is on and off in turn, and to
the later moments one by one, where it is not the same each time. A lag of 0 stands for jumps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from otf_core.arrays import Array
from otf_core.effects.terms import State
from otf_core.errors import ConfigError
from otf_core.model.frames import XYZ
from otf_core.model.path import MOVING

SIGNAL = 'signal:'
"""Head of the names of signals recorded beside the samples."""
CYCLE, MOMENT, PLACE, DIRECTION = 'cycle:', 'after:', 'near:', 'aside:'
"""Heads of the names; the numbers follow: period in s; moment in s; axis positions in m; azimuth
and elevation in rad."""
TURNS = {f'cycle_{axis.lower()}:': k for k, axis in enumerate(XYZ)}
"""Heads of the names of cycles along axes, and number of the axis; the period in m follows."""
CORNER_LENGTH, REVERSAL_LENGTH, STOP_TIME = 0.03, 0.03, 0.5
"""m, m or rad, and s; s0 of distances from corners, of travel since a reversal, of time since a
stop."""
PLACE_LENGTH, DIRECTION_ANGLE = 0.05, 0.1
"""m and rad; s0 of distances from a place and of angles from a direction."""
LETTERS = (*(a.lower() for a in XYZ), 'a', 'b', 'c')
"""Positions of axes, for which m stands for rad where they are rotary."""


SWITCHED = 'switched:'
"""Head of the name of such an input; lag and moments in s follow."""


@dataclass(frozen=True)
class Switching:
    """Moments at which something switches, and the lag with which it is followed.

    Attributes
    ----------
    lag : float, s
    moments : tuple of float, s
        Ascending, since the start of the recording.
    """

    lag: float
    moments: tuple[float, ...]

    @classmethod
    def of(cls, name: str) -> Switching | None:
        """Read the name of an input; None if it is no such name."""
        if not name.startswith(SWITCHED):
            return None
        lag, _, moments = name.removeprefix(SWITCHED).partition('@')
        try:
            switching = cls(float(lag), tuple(float(m) for m in moments.split(',')))
        except ValueError:
            return None
        steps = np.diff((0.0, *switching.moments))
        sound = 0.0 <= switching.lag < np.inf and steps[0] >= 0.0 and np.all(steps[1:] > 0.0)
        return switching if sound and switching.moments[-1] < np.inf else None

    @property
    def name(self) -> str:
        """Name as an input."""
        return f'{SWITCHED}{self.lag:.4g}@{",".join(f"{m:.5g}" for m in self.moments)}'

    @property
    def words(self) -> str:
        """What happens, for the report."""
        *first, last = (f'{m:.3g} s' for m in self.moments)
        when = f'{", ".join(first)} and {last}' if first else last
        return f'something switches at {when}, which it follows with a lag of {self.lag:.3g} s'

    def responses(self, time: Array) -> Array:
        """Responses r_k at times (n,), shape (n, k)."""
        return responses(time, np.array(self.moments), np.array(self.lag))

    def functions(self, time: Array, order: int) -> Array:
        """One and the functions up to an order at times (n,), shape (n, order + 1)."""
        single = self.responses(time)
        signs = (-1.0) ** np.arange(len(self.moments))
        whole = np.column_stack([np.ones(len(time)), single @ signs, single[:, 1:]])
        return whole[:, : order + 1]


def responses(time: Array, moments: Array, lags: Array) -> Array:
    """Responses of first order to switches at moments (k,), at times (n,), shape (n, k).

    Lags (k,) or () of 0 are those of jumps.
    """
    since = np.maximum(time[:, None] - moments, 0.0)
    jumps = lags == 0.0
    slow = -np.expm1(-since / np.where(jumps, 1.0, lags))
    return np.asarray(np.where(jumps, since > 0.0, slow))


def beam_direction(azimuth: float, elevation: float) -> Array:
    """Unit vector of a direction, shape (3,)."""
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def _angle(state: State, numbers: Sequence[float]) -> Array:
    reach = np.maximum(np.linalg.norm(state.beam, axis=1), 1e-12)
    cosine = state.beam @ beam_direction(*numbers) / reach
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


@dataclass(frozen=True)
class Input:
    """One input.

    Attributes
    ----------
    unit : str
        Of its values; signals have those of their topic, which are not known here.
    values : callable(state) -> ndarray, shape (n,), SI, optional
        None for what the state holds under the name of the input alone.
    length : float
        Value s0 over which it is compressed; 0 for none.
    label, words : str
        For pictures and in sentences, of those with numbers.
    stands_for : tuple of str
        Plain inputs that it says more of, where it has numbers.
    order : int
        Highest order of a function of it that says anything; 0 for any.
    """

    unit: str
    values: Callable[[State], Array] | None
    length: float = 0.0
    label: str = ''
    words: str = ''
    stands_for: tuple[str, ...] = ()
    order: int = 0


def _norm(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1))


_PLAIN = {
    'time': Input('s', lambda s: s.time),
    'feed': Input('m/s', lambda s: s.speed),
    'acceleration': Input('m/s^2', None),
    'since_stop': Input('s', None, STOP_TIME),
    'lap': Input('', None),
    'leg': Input('', None),
    'range': Input('m', lambda s: _norm(s.beam)),
    'azimuth': Input('rad', lambda s: np.arctan2(s.beam[:, 1], s.beam[:, 0])),
    'elevation': Input(
        'rad', lambda s: np.arctan2(s.beam[:, 2], np.hypot(s.beam[:, 0], s.beam[:, 1]))
    ),
    'from_corner': Input('m', lambda s: s.from_corner, CORNER_LENGTH),
    'to_corner': Input('m', lambda s: s.to_corner, CORNER_LENGTH),
    'from_turn': Input('', lambda s: _norm(s.direction - s.before)),
    'to_turn': Input('', lambda s: _norm(s.after - s.direction)),
}


def _sense(state: State, axis: int) -> Array:
    own = state.direction[:, axis]
    return np.where(np.abs(own) > MOVING, np.sign(own), 0.0)


def _of_axis(name: str) -> Input | None:
    letter = name[-1:]
    if letter not in LETTERS:
        return None

    def column(state: State) -> int:
        return state.machine.column(letter.upper())

    unit = 'm' if letter.upper() in XYZ else 'rad'
    return {
        '': Input(unit, lambda s: np.asarray(s.q[:, column(s)])),
        'sense_': Input('', lambda s: _sense(s, column(s))),
        'since_reversal_': Input('m', None, REVERSAL_LENGTH),
    }.get(name.removesuffix(letter))


def _found(name: str, *numbers: float) -> Input:
    """An input with numbers of its own."""
    head = name.partition(':')[0] + ':'
    first = numbers[0]
    if head == SWITCHED:
        words = f'time: {Switching(first, numbers[1:]).words}'
        return Input('s', lambda s: s.time, 0.0, 'time', words, ('time',))
    if head == CYCLE:
        words = f'time, over and over every {first:.3g} s'
        return Input(
            's', lambda s: np.mod(s.time, first), 0.0, 'time in the cycle', words, ('time',)
        )
    if head == MOMENT:
        words = f'time, before and after {first:.0f} s'
        label = 'after the moment'
        return Input('', lambda s: (s.time > first).astype(float), 0.0, label, words, ('time',), 1)
    if head == PLACE:
        x, y, z = (1e3 * v for v in numbers)
        words = f'the distance from X {x:.0f}, Y {y:.0f}, Z {z:.0f} mm'
        label = 'distance from the place'
        return Input(
            'm', lambda s: _norm(s.point - np.array(numbers)), PLACE_LENGTH, label, words,
            ('x', 'y', 'z'),
        )  # fmt: skip
    if head == DIRECTION:
        azimuth, elevation = np.degrees(numbers)
        words = (
            f'the angle of the beam from azimuth {azimuth:.0f} deg and '
            f'elevation {elevation:.0f} deg'
        )
        label = 'angle from the direction'
        return Input(
            'rad', lambda s: _angle(s, numbers), DIRECTION_ANGLE, label, words,
            ('azimuth', 'elevation'),
        )  # fmt: skip
    number = TURNS[head]
    axis = XYZ[number]
    words = f'the position of {axis}, over and over every {1e3 * first:.4g} mm'
    return Input(
        'm', lambda s: np.mod(s.q[:, number], first), 0.0, f'{axis} in the cycle', words,
        (axis.lower(),),
    )  # fmt: skip


_NUMBERS = {CYCLE: 1, MOMENT: 1, PLACE: 3, DIRECTION: 2, **dict.fromkeys(TURNS, 1)}
"""How many numbers the names hold."""


def numbers_of(name: str) -> tuple[float, ...]:
    """Numbers in the name of an input; none for a plain one, or without proper numbers."""
    head, _, rest = name.partition(':')
    if switching := Switching.of(name):
        return switching.lag, *switching.moments
    try:
        numbers = tuple(float(part) for part in rest.split(','))
    except ValueError:
        return ()
    proper = len(numbers) == _NUMBERS.get(head + ':') and np.all(np.isfinite(numbers))
    return numbers if proper and (not head.startswith('cycle') or numbers[0] > 0.0) else ()


def head_of(name: str) -> str:
    """Head of the name of an input with numbers; empty for a plain one."""
    return name.partition(':')[0] + ':' if numbers_of(name) else ''


def found_name(head: str, *numbers: float) -> str:
    """Name of an input with numbers."""
    return head + ','.join(f'{float(v):.6g}' for v in numbers)


def found_input(name: str) -> Input | None:
    """Return an input with numbers; None for any other."""
    numbers = numbers_of(name)
    return _found(name, *numbers) if numbers else None


def _input(name: str) -> Input | None:
    return _of_axis(name) or _PLAIN.get(name) or found_input(name)


def cycle_period(name: str) -> float:
    """Period in s or m if an input is the phase of a cycle in time or along an axis, else 0."""
    return numbers_of(name)[0] if head_of(name).startswith('cycle') else 0.0


def stands_for(name: str) -> tuple[str, ...]:
    """Plain inputs of an input: its own name where it has no numbers."""
    found = found_input(name)
    return found.stands_for if found else (name,)


def plain_names(names: Iterable[str]) -> tuple[str, ...]:
    """Plain inputs of some inputs, each once."""
    return tuple(dict.fromkeys(plain for name in names for plain in stands_for(name)))


def known_input(name: str) -> bool:
    """Return whether a name is one of an input."""
    return name.startswith(SIGNAL) or _input(name) is not None


def unit_of_input(name: str) -> str:
    """Unit of an input; signals have those of their topic, which are not known here."""
    own = _input(name)
    return own.unit if own else ''


def label_of(name: str) -> str:
    """Name of an input for pictures."""
    found = found_input(name)
    return found.label if found else name


def compression(name: str) -> float:
    """Distance, time or angle s0 over which an input is compressed; 0 for none."""
    own = _input(name)
    return own.length if own else 0.0


def input_values(state: State, name: str) -> Array:
    """Values of an input, shape (n,), SI.

    Raises
    ------
    ConfigError
        If the name is unknown, or a signal is not in the recording.
    """
    if name in state.more:
        return state.more[name]
    if name.startswith(SIGNAL):
        raise ConfigError(f'{name}: not among the signals of this run')
    own, axis = _input(name), name[-1].upper()
    lacking = _of_axis(name) is not None and axis not in state.machine.axis_names
    if own is None or own.values is None or lacking:
        raise ConfigError(f"input '{name}' is unknown")
    return own.values(state)


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
    return np.linspace(-1.0, 1.0, 2 if head_of(name) == MOMENT else count)


def nodes_of(name: str, order: int) -> Array:
    """Places in [-1, 1] that determine functions up to an order.

    Chebyshev-Lobatto points; of a phase evenly spaced ones.
    """
    if cycle_period(name):
        return np.asarray(2.0 * np.arange(order + 1) / (order + 1) - 1.0)
    if not order:
        return np.zeros(1)
    return np.asarray(-np.cos(np.pi * np.arange(order + 1) / order))
