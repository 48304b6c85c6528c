# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a displacement of the measured point, with a name, a unit and a source.

An effect is linear in its coefficients; what it is not linear in (a period, a time constant) is
its shape. ``terms`` is the one formula: the simulator sums its columns, the fit and the diagnosis
use them as columns of the system of equations, the report quotes them.

The file of an effect finds here all that it is made of.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.action import Acting
from otf_core.effects.free import Free
from otf_core.effects.sizes import Coefficients, Size
from otf_core.effects.terms import BelongsTo, Shape, State, Terms
from otf_core.errors import ConfigError
from otf_core.files.message_text import shortened

__all__ = [
    'Array', 'BelongsTo', 'Coefficients', 'Contribution', 'Effect', 'Shape', 'Size', 'State',
    'Terms', 'Wave',
]  # fmt: skip

BLOCK = 20_000
"""Points that are evaluated at once; bounds the memory of effects with many terms."""
LISTED = 20
"""Names that an error message lists at most."""


@dataclass(frozen=True)
class Wave:
    """What makes an effect a line in a spectrum; its shapes are looked for there.

    Attributes
    ----------
    parameter : str
        Shape parameter: a frequency in Hz if it repeats in time, else a period in m.
    in_time : bool
        True if it repeats in time, False if it does along an axis.
    probe : float
        Stands for it where no line is found.
    """

    parameter: str
    in_time: bool
    probe: float


def product(terms: Terms, state: State, given: Sequence[float]) -> Array:
    """Standard uncertainty of every coefficient: the product of what is declared, shape (k,)."""
    return np.full(len(terms.names), float(np.prod(given)))


@dataclass(frozen=True)
class Contribution:
    """A source of the uncertainty budget that acts as an effect does.

    Attributes
    ----------
    source : str
        As the budget calls it.
    keys : tuple of str
        Keys of ``uncertainty`` in machine.yaml, any of which declares it.
    shape : mapping of str to float
        Shape with which it acts.
    size : callable(terms, state, given)
        Standard uncertainty of every coefficient, shape (k,), from the declared values.
    """

    source: str
    keys: tuple[str, ...]
    shape: Shape = field(default_factory=dict)
    size: Callable[[Terms, State, Sequence[float]], Array] = product


class Effect(ABC):
    """One effect; every subclass is one file and one line in the registry.

    A simple one gives the words and ``terms``; all other facts have defaults.
    """

    name: ClassVar[str]
    """Name in files and reports (docs/conventions.md, gap.json)."""
    cause: ClassVar[str]
    equation: ClassVar[str]
    coefficients: ClassVar[str] = ''
    """What its parameters are; the units stand in ``Terms`` and ``shape_units``."""
    typical: ClassVar[str]
    """Typical size, with unit."""
    source: ClassVar[str]
    signature: ClassVar[str]
    """One sentence: what it looks like in data."""
    needs: ClassVar[str]
    """What measurement shows it where a run does not."""
    shape_names: ClassVar[tuple[str, ...]] = ()
    """Names of the parameters it is not linear in."""
    shape_units: ClassVar[tuple[str, ...]] = ()
    """Their units; '' for a number."""
    shape_defaults: ClassVar[Shape] = MappingProxyType({})
    """Shape parameters that a file may leave out."""
    refine: ClassVar[str] = ''
    """Shape parameter that a fit improves beyond the raster of ``shapes``; '' for none."""
    refine_width: ClassVar[float] = 0.0
    """Relative distance over which it may move."""
    own_per_run: ClassVar[bool] = False
    """True if every run has coefficients of its own, as what drifts since its start."""
    wave: ClassVar[Wave | None] = None
    """What makes it a line in a spectrum; None if it is none."""
    stays_in_place: ClassVar[bool] = False
    """True if it displaces the target in the same way whenever it comes by a place, as tables do,
    but no table can hold it."""
    held_by_tables: ClassVar[bool] = False
    """True if tables hold most of it: whether it matters is judged by what it displaces, not by
    what it leaves."""
    many_alike: ClassVar[bool] = False
    """True if it has so many coefficients, named MOTION@..., that the data hardly see some: they
    are estimated with the size that makes the data most likely."""
    rigid: ClassVar[bool] = False
    """True if it is a rigid motion of tracker or table by functions of one input each."""
    couples: ClassVar[bool] = False
    """True if it displaces point by point, as a function of several positions."""
    belongs_to: ClassVar[BelongsTo] = BelongsTo.EFFECTS
    """The part of a calibration that takes it up."""
    any_axes: ClassVar[bool] = False
    """True if its formula holds for machines with rotary axes as well."""
    material_um: ClassVar[float] = 0.2
    """um; where it changes the residual by less it is not named."""
    contributions: ClassVar[tuple[Contribution, ...]] = ()
    """Sources of the uncertainty budget that act as it does."""
    follows: ClassVar[tuple[Acting, ...]] = ()
    """How it acts where it follows a signal recorded beside the samples."""
    switches: ClassVar[tuple[Acting, ...]] = ()
    """How it acts where it follows something that switches, of which nothing is recorded."""
    free: ClassVar[tuple[Free, ...]] = ()
    """Its free forms: what it may depend on beside its formula."""

    def loose(self, shape: Shape) -> dict[str, float]:
        """Shape parameters that more data may still move: standard deviation of their logarithm.

        Parameters
        ----------
        shape : mapping of str to float
            As a diagnosis found it.
        """
        return {self.refine: self.refine_width} if self.refine else {}

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """What stands for it in a headline, the largest first.

        Empty where no single coefficient does: then the displacement that it causes across the
        path, as root mean square over the run.
        """
        return ()

    def orders_of(self, names: Sequence[str]) -> Array:
        """Orders of coefficients as functions, see ``Terms``, shape (k,)."""
        return np.zeros(len(names))

    @property
    def changes_within_pieces(self) -> bool:
        """True if means over path pieces wash it out: it is evaluated at the samples."""
        return self.wave is not None

    def shapes(self, state: State) -> Sequence[Shape]:
        """Shapes worth trying in this run; one empty shape if there is nothing to choose."""
        return ({},)

    @abstractmethod
    def terms(self, state: State, shape: Shape) -> Terms:
        """Return the linear terms for one shape."""

    def complete_shape(self, parameters: Shape) -> dict[str, float]:
        """Shape parameters with the defaults filled in.

        Raises
        ------
        ConfigError
            Names a shape parameter that is missing or not above zero.
        """
        shape = {}
        for name in self.shape_names:
            value = parameters.get(name, self.shape_defaults.get(name))
            if value is None:
                raise ConfigError(f'{self.name}: {name}: missing')
            if value != self.shape_defaults.get(name) and not (value > 0 and math.isfinite(value)):
                raise ConfigError(f'{self.name}: {name}: {value} is out of range; must be above 0')
            shape[name] = float(value)
        return shape

    def units(self, state: State, parameters: Shape) -> dict[str, str]:
        """Unit of every given parameter.

        Parameters
        ----------
        state : State
            Of the run or the machine that the parameters are for; any points will do.

        Raises
        ------
        ConfigError
            Names a parameter that is missing, unknown or out of range.
        """
        terms = self.terms(state, self.complete_shape(parameters))
        known = dict(
            zip((*self.shape_names, *terms.names), (*self.shape_units, *terms.units), strict=True)
        )
        for name in parameters:
            if name not in known:
                listed = ', '.join(list(known)[:LISTED])
                rest = f', ... ({len(known)} in all)' if len(known) > LISTED else ''
                raise ConfigError(
                    f'{self.name}: {shortened(name)}: unknown; possible: {listed}{rest}'
                )
        return {name: known[name] for name in parameters}

    def displacement(self, state: State, parameters: Shape) -> Array:
        """Displacement of the measured point.

        Parameters
        ----------
        parameters : mapping of str to float
            Coefficients by their names in ``Terms`` (missing ones are zero) and the shape.

        Returns
        -------
        ndarray, shape (n, 3), m

        Raises
        ------
        ConfigError
            Names a parameter that is missing, unknown or out of range.
        """
        self.units(state.part(slice(0, 1)), parameters)
        shape = self.complete_shape(parameters)
        total = np.zeros((len(state), 3))
        for start in range(0, len(state), BLOCK):
            rows = slice(start, start + BLOCK)
            total[rows] = self.block_displacement(state.part(rows), shape, parameters)
        return total

    def block_displacement(self, state: State, shape: Shape, parameters: Shape) -> Array:
        """Displacement of a few points for checked parameters, shape (n, 3), m."""
        terms = self.terms(state, shape)
        return np.asarray(terms.columns @ np.array([parameters.get(n, 0.0) for n in terms.names]))
