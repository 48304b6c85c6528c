# SPDX-License-Identifier: Apache-2.0
"""Inputs with numbers of their own, which are found in data.

The phase of a cycle in time or along an axis, before and after a moment, the distance from a
place, the angle of the beam from a direction, time as what switches feels it. Their names hold the
numbers: ``cycle:30``, ``cycle_x:0.01``, ``after:341.5``, ``near:0.1,0.25,-0.2``,
``aside:0.7,0.2``, ``switched:58@0,146``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.switching import SWITCHED, Switching
from otf_core.effects.terms import State
from otf_core.model.frames import XYZ

CYCLE, MOMENT, PLACE, DIRECTION = 'cycle:', 'after:', 'near:', 'aside:'
"""Heads of the names; the numbers follow: period in s; moment in s; axis positions in m; azimuth
and elevation in rad."""
TURNS = {f'cycle_{axis.lower()}:': k for k, axis in enumerate(XYZ)}
"""Heads of the names of cycles along axes, and number of the axis; the period in m follows."""
CYCLES = {CYCLE, *TURNS}
"""Heads of all cycles: what depends on them is made of harmonics."""
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class FoundKind:
    """One kind of such inputs.

    Attributes
    ----------
    count : int
        Numbers in its name; 0 where the name says how many.
    stands_for : tuple of str
        Plain inputs that it says more of.
    unit, label : str
        Of its values, and for pictures.
    length : float
        Value s0 over which it is compressed, see ``inputs``; 0 for none.
    order : int
        Highest order of a function of it that says anything; 0 for any.
    values : callable(state, numbers) -> ndarray, shape (n,), SI
    """

    count: int
    stands_for: tuple[str, ...]
    unit: str
    label: str
    length: float
    order: int
    values: Callable[[State, Numbers], Array]
    words: Callable[[Numbers], str]


def beam_direction(azimuth: float, elevation: float) -> Array:
    """Unit vector of a direction, shape (3,)."""
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def _angle(state: State, numbers: Numbers) -> Array:
    reach = np.maximum(np.linalg.norm(state.beam, axis=1), 1e-12)
    cosine = state.beam @ beam_direction(*numbers) / reach
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _place_words(numbers: Numbers) -> str:
    x, y, z = (1e3 * v for v in numbers)
    return f'the distance from X {x:.0f}, Y {y:.0f}, Z {z:.0f} mm'


def _direction_words(numbers: Numbers) -> str:
    azimuth, elevation = np.degrees(numbers)
    return (
        f'the angle of the beam from azimuth {azimuth:.0f} deg and elevation {elevation:.0f} deg'
    )


def _turn(number: int) -> FoundKind:
    """Phase of a cycle along an axis."""
    name = XYZ[number]
    return FoundKind(
        1, (name.lower(),), 'm', f'{name} in the cycle', 0.0, 0,
        lambda state, n: np.asarray(np.mod(state.q[:, number], n[0])),
        lambda n: f'the position of {name}, over and over every {1e3 * n[0]:.4g} mm',
    )  # fmt: skip


KINDS = {
    CYCLE: FoundKind(
        1, ('time',), 's', 'time in the cycle', 0.0, 0,
        lambda state, n: np.asarray(np.mod(state.time, n[0])),
        lambda n: f'time, over and over every {n[0]:.3g} s',
    ),
    MOMENT: FoundKind(
        1, ('time',), '', 'after the moment', 0.0, 1,
        lambda state, n: (state.time > n[0]).astype(float),
        lambda n: f'time, before and after {n[0]:.0f} s',
    ),
    PLACE: FoundKind(
        3, ('x', 'y', 'z'), 'm', 'distance from the place', 0.05, 0,
        lambda state, n: np.asarray(np.linalg.norm(state.point - np.array(n), axis=1)),
        _place_words,
    ),
    DIRECTION: FoundKind(
        2, ('azimuth', 'elevation'), 'rad', 'angle from the direction', 0.1, 0,
        _angle,
        _direction_words,
    ),
    SWITCHED: FoundKind(
        0, ('time',), 's', 'time', 0.0, 0,
        lambda state, n: state.time,
        lambda n: f'time: {Switching(n[0], n[1:]).words}',
    ),
    **{head: _turn(number) for head, number in TURNS.items()},
}  # fmt: skip


def head_of(name: str) -> str:
    """Head of the name of such an input; empty for any other, or without proper numbers."""
    head = name.partition(':')[0] + ':'
    return head if numbers_of(name) else ''


def numbers_of(name: str) -> Numbers:
    """Numbers in the name of such an input; none for any other, or without proper numbers."""
    head, _, rest = name.partition(':')
    if switching := Switching.of(name):
        return switching.lag, *switching.moments
    try:
        numbers = tuple(float(part) for part in rest.split(','))
    except ValueError:
        return ()
    kind = KINDS.get(head + ':')
    proper = kind and len(numbers) == kind.count and np.all(np.isfinite(numbers))
    return numbers if proper and (head + ':' not in CYCLES or numbers[0] > 0.0) else ()


def found_name(head: str, *numbers: float) -> str:
    """Name of such an input."""
    return head + ','.join(f'{float(v):.6g}' for v in numbers)


def found_kind(name: str) -> FoundKind | None:
    """Kind of such an input; None for any other."""
    return KINDS.get(head_of(name))


def cycle_period(name: str) -> float:
    """Period in s or m if an input is the phase of a cycle in time or along an axis, else 0."""
    return numbers_of(name)[0] if head_of(name) in CYCLES else 0.0


def stands_for(name: str) -> tuple[str, ...]:
    """Plain inputs of an input: its own name where it has no numbers."""
    kind = found_kind(name)
    return kind.stands_for if kind else (name,)


def plain_names(names: Iterable[str]) -> tuple[str, ...]:
    """Plain inputs of some inputs, each once."""
    return tuple(dict.fromkeys(plain for name in names for plain in stands_for(name)))
