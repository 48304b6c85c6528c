# SPDX-License-Identifier: Apache-2.0
"""How a blind trial draws an effect, as data; the random numbers are drawn in ``blind`` alone.

Coefficients count only in proportion: the trial scales them to a size of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

# ---------------------------------------------------------------- numbers


@dataclass(frozen=True)
class Uniform:
    """Any number from ``low`` to ``high``."""

    low: float
    high: float


@dataclass(frozen=True)
class LogUniform:
    """Any number from ``low`` to ``high``, its logarithm evenly spread."""

    low: float
    high: float


@dataclass(frozen=True)
class Normal:
    """Normally distributed about zero with the standard deviation ``size``."""

    size: float


@dataclass(frozen=True)
class OneOf:
    """One of some numbers."""

    values: tuple[float, ...]


@dataclass(frozen=True)
class Share:
    """``size`` times a number from ``least`` to 1; of either sign where ``signed``."""

    size: float
    least: float
    signed: bool = True


Value = float | Uniform | LogUniform | Normal | OneOf | Share
"""A number, or how one is drawn."""

# ---------------------------------------------------------------- parameters


@dataclass(frozen=True)
class Number:
    """One parameter, or several of the same value.

    Attributes
    ----------
    of_duration : bool
        True if the value counts in durations of the run.
    also : tuple of str
        Further parameters of the same value.
    """

    name: str
    value: Value
    of_duration: bool = False
    also: tuple[str, ...] = ()


@dataclass(frozen=True)
class Axes:
    """Coefficients ``PREFIX_X`` ... of one to ``most`` axes, of either sign.

    Each is 0.4 to 1 times ``size``.
    """

    prefix: str
    size: float = 1e-6
    most: int = 3


@dataclass(frozen=True)
class Some:
    """One to ``most`` different ones of ``items``."""

    items: tuple[Drawn, ...]
    most: int


@dataclass(frozen=True)
class Several:
    """``item`` drawn one to ``most`` times, of either sign; a repeated one counts once."""

    item: Drawn
    most: int


@dataclass(frozen=True)
class Maybe:
    """``item`` in a share of all cases, in place of what was drawn before by the same name."""

    share: float
    item: Drawn


@dataclass(frozen=True)
class Either:
    """One of several ways, each a sequence."""

    ways: tuple[tuple[Drawn, ...], ...]


@dataclass(frozen=True)
class OfMachine:
    """What is drawn depends on the names of the machine's axes."""

    item: Callable[[tuple[str, ...]], Drawn]


@dataclass(frozen=True)
class BetweenNodes:
    """A rough wave along an axis, one coefficient per interval of its table.

    Attributes
    ----------
    name : str
        Of a coefficient, to be formatted with both ends of the interval.
    lengths : tuple of two floats
        Shortest and longest wave, in intervals.
    rough : float
        Standard deviation of what is added to the wave, over its amplitude.
    """

    name: str
    axis: str
    size: float
    lengths: tuple[float, float]
    rough: float


Drawn = Number | Axes | Some | Several | Maybe | Either | OfMachine | BetweenNodes
"""A part of the parameters of an effect."""


@dataclass(frozen=True)
class Trial:
    """What a blind trial does with an effect.

    Attributes
    ----------
    drawn : tuple of Drawn
        Its parameters, drawn in this order.
    hard_to_see : bool
        True if one run hardly shows it: it is sized by what it displaces, not by what it leaves.
    second_place : int
        Its turn among the effects that are measured from a second tracker place; 0 if it is not.
    """

    drawn: tuple[Drawn, ...]
    hard_to_see: bool = False
    second_place: int = 0
