# SPDX-License-Identifier: Apache-2.0
"""What an effect declares of a free form: inputs and orders of the function, how it acts."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

from otf_core.effects.action import RIGID_MOTIONS, Acting
from otf_core.effects.inputs import SIGNAL, Switching
from otf_core.effects.terms import BelongsTo, Terms

AXIS, TERM = '{axis}', '{term}'
"""In the name of an input: the axis of each term, and its name."""


@dataclass(frozen=True)
class Free:
    """How the free form of an effect depends and acts: all that an effect declares of it.

    Attributes
    ----------
    inputs : tuple of str
        ``{axis}`` stands for the axis of each term of what it acts with, ``{term}`` for its name.
    orders : tuple of int
        Highest order of the polynomials of each input.
    least : tuple of int
        Lowest order of each.
    words : str
        What is free, for the report: 'its size changes with time'.
    acts : Acting, optional
        The formula of the effect where it is not given.
    of_shape : bool
        True if ``acts`` depends on the shape parameters of the effect, as its formula does.
    zero_at : float
        Where the function is zero: -1 at the start, 1 at the end of the range of the first input;
        0 for nowhere.
    own_per_run, belongs_to : optional
        Where they differ from the effect's.
    essential : int, optional
        Number of the input without which it would be another effect.
    several_places : bool
        True if it differs from another form only where the tracker stood at several places.
    """

    inputs: tuple[str, ...]
    orders: tuple[int, ...]
    words: str = ''
    least: tuple[int, ...] = ()
    acts: Acting | None = None
    of_shape: bool = False
    zero_at: float = 0.0
    own_per_run: bool | None = None
    belongs_to: BelongsTo | None = None
    essential: int | None = None
    several_places: bool = False

    @property
    def shaped(self) -> bool:
        """True if it has the shape parameters of the effect."""
        return self.acts is None or self.of_shape

    @property
    def rigid(self) -> bool:
        """True for a rigid motion of tracker, table or target by a function of one input."""
        return len(self.inputs) == 1 and self.acts in RIGID_MOTIONS

    @property
    def numbers(self) -> tuple[tuple[int, ...], ...]:
        """Orders of every product of polynomials."""
        least = self.least or (0,) * len(self.orders)
        ranges = (range(a, b + 1) for a, b in zip(least, self.orders, strict=True))
        return tuple(product(*ranges))

    def names(self, terms: Terms) -> tuple[str, ...]:
        """Inputs of all terms, each once."""
        pairs = zip(terms.names, terms.axes, strict=True)
        return tuple(dict.fromkeys(
            name.replace(AXIS, axis.lower()).replace(TERM, term)
            for term, axis in pairs for name in self.inputs
        ))  # fmt: skip


def follower(acts: Acting, signal: str, order: int = 1) -> Free:
    """Declare what follows a signal, in proportion or up to an order; zero at its lowest value."""
    topic, _, lag = signal.removeprefix(SIGNAL).partition('@')
    words = f'it follows the signal {topic}' + (f' with a lag of {lag} s' if lag else '')
    words += '' if order == 1 else ', not quite in proportion'
    return Free((signal,), (order,), words, (1,), acts, zero_at=-1.0, own_per_run=False)


def declare_switching(acts: Acting, switching: Switching, order: int = 1) -> Free:
    """Declare what drifts after something that switches: alike each time, or up to an order."""
    words = switching.words + ('' if order == 1 else ', and not the same each time')
    return Free((switching.name,), (order,), words, (1,), acts)
