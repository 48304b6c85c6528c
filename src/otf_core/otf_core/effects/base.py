# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a displacement of the measured point, with a name, a unit and a source.

An effect is linear in its coefficients; what it is not linear in (a period, a time constant) is
its shape. ``terms`` is the one formula: the simulator sums its columns, the fit and the diagnosis
use them as columns of the system of equations, the report quotes them. Its description stands
in words.yaml under its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.action import Acting
from otf_core.effects.free import Free
from otf_core.effects.terms import BelongsTo, Shape, State, Terms
from otf_core.errors import ConfigError
from otf_core.files.message_text import shortened
from otf_core.model.frames import XYZ
from otf_core.model.machine import Machine

POINTS_AT_ONCE = 20_000
"""Points that are evaluated at once; bounds the memory of effects with many terms."""
LISTED = 20
"""Names that an error message lists at most."""
MAINLY = 0.9
"""Share of the length of a vector from which one component stands for it."""
SHARE = 0.25
"""Share of the largest displacement by a motion or axis from which its size is stated as well."""

Part = Mapping[str, float]
"""A sum of coefficients: weights by their names."""


@dataclass(frozen=True)
class Words:
    """Description of an effect: an entry of words.yaml."""

    cause: str
    displacement: str
    parameters: str
    typical_size: str
    looks_like: str
    shown_by: str
    source: str


@cache
def words_of_effects() -> dict[str, Words]:
    """Read words.yaml: the words of every effect of the catalogue by its name."""
    import yaml  # loaded on use: numbers need no words

    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
    text = Path(__file__).with_name('words.yaml').read_text(encoding='utf-8')
    return {name: Words(**entry) for name, entry in yaml.load(text, loader).items()}


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter that an effect is not linear in.

    Attributes
    ----------
    name, unit : str
        Unit '' for a number.
    default : float, optional
        Value where a file leaves it out; without one it must not.
    limits : tuple of float, optional
        Smallest and largest value; without them anything above zero.
    width : float
        Standard deviation of its logarithm, over which a fit may move it beyond the raster of
        ``shapes``; 0 if it is held.
    """

    name: str
    unit: str
    default: float | None = None
    limits: tuple[float, float] | None = None
    width: float = 0.0


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


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of an effect in one run, as a fit gives them.

    Attributes
    ----------
    value : mapping of name to float
        SI units.
    reach : mapping of name to float, m per unit
        Root mean square displacement across the path by each.
    axes : tuple of str
        Axes that take part, the strongest first.
    shape : mapping of name to float
    """

    value: Mapping[str, float]
    reach: Mapping[str, float]
    axes: tuple[str, ...]
    shape: Mapping[str, float]
    machine: Machine

    def of(self, part: Part) -> float:
        """A sum of coefficients; those that a fit does not have are zero."""
        return sum(weight * self.value.get(name, 0.0) for name, weight in part.items())

    def displacement(self, name: str) -> float:
        """Root mean square displacement by one coefficient, m."""
        return abs(self.value[name]) * self.reach[name]

    @property
    def strongest(self) -> str:
        """Name of the coefficient that displaces most; '' if there is none."""
        return max(self.value, key=self.displacement, default='')

    def groups(self) -> dict[str, list[str]]:
        """Names by what stands before their last underscore or their @, the strongest first.

        Only those that displace by ``SHARE`` of the strongest.
        """
        by_head: dict[str, list[str]] = {}
        for name in self.value:
            head = name.split('@')[0] if '@' in name else name.rsplit('_', 1)[0]
            by_head.setdefault(head, []).append(name)
        strength = {
            head: float(np.sqrt(sum(self.displacement(n) ** 2 for n in names)))
            for head, names in by_head.items()
        }
        least = SHARE * max(strength.values(), default=0.0)
        relevant = [head for head in by_head if strength[head] >= least]
        return {head: by_head[head] for head in sorted(relevant, key=lambda h: -strength[h])}


@dataclass(frozen=True)
class Size:
    """A size: one sum of coefficients with its sign, or the root of the sum of squares of several.

    Attributes
    ----------
    of : str
        What of the effect it is the size of, as in 'backlash *of X*'; empty for all of it.
    parts : tuple of Part
        Empty for a parameter that is chosen, not estimated.
    unit : str
        SI.
    remark : str
        What kind of size it is, as in 'rms along X'.
    chosen : float
        Its value without parts.
    """

    of: str
    parts: tuple[Part, ...]
    unit: str
    remark: str = ''
    chosen: float = 0.0


def vector_size(
    fitted: Coefficients,
    parts: Sequence[Part],
    unit: str,
    remark: str,
    way: str = '',
    along: str = 'along',
) -> Size:
    """Size of a vector with components X, Y and Z: its main component, else its length.

    Parameters
    ----------
    parts : sequence of Part
        Of the components.
    unit, remark : str
        See ``Size``.
    way : str
        What it does, such as 'shifting'.
    along : str
        'about' for a rotation.
    """
    values = np.array([fitted.of(part) for part in parts])
    main = int(np.argmax(np.abs(values)))
    if abs(values[main]) > MAINLY * float(np.linalg.norm(values)):
        return Size(f'{way} {along} {XYZ[main]}'.lstrip(), (parts[main],), unit, remark)
    return Size(way, tuple(parts), unit, remark)


def one_shape(state: State) -> Sequence[Shape]:
    """Nothing to choose."""
    return ({},)


def no_sizes(fitted: Coefficients) -> tuple[Size, ...]:
    """Nothing that a single coefficient stands for."""
    return ()


def always(shape: Shape) -> bool:
    """Any shape acts."""
    return True


def no_terms(state: State, shape: Shape) -> Terms:
    """No displacement."""
    return Terms((), (), (), np.zeros((len(state), 3, 0)))


@dataclass(frozen=True, eq=False)
class Effect:
    """One effect: a formula and what the rest must know of it.

    Attributes
    ----------
    formula : callable(state, shape) -> Terms
        The linear terms for one complete shape.
    name : str
        Name in files and reports (docs/conventions.md, gap.json): that of the formula.
    shape : tuple of ShapeParameter
    shapes : callable(state) -> sequence of shape
        Shapes worth trying in a run; one empty shape if there is nothing to choose.
    sizes : callable(coefficients) -> tuple of Size
        What stands for it in a headline, the largest first. Empty where no single coefficient
        does: then the displacement that it causes across the path, as root mean square.
    shape_matters : callable(shape) -> bool
        Whether data can tell how a found shape is to be moved.
    refine : str
        Shape parameter that a fit improves beyond the raster of ``shapes``; '' for none.
    own_per_run : bool
        True if every run has coefficients of its own, as what drifts since its start.
    wave : Wave, optional
        What makes it a line in a spectrum.
    stays_in_place : bool
        True if it displaces the target in the same way whenever it comes by a place, as tables do,
        but no table can hold it.
    held_by_tables : bool
        True if tables hold most of it: whether it matters is judged by what it displaces, not by
        what it leaves.
    many_alike : bool
        True if it has so many coefficients, named MOTION@..., that the data hardly see some: they
        are estimated with the size that makes the data most likely.
    rigid : bool
        True if it is a rigid motion of tracker or table by functions of one input each.
    couples : bool
        True if it displaces point by point, as a function of several positions.
    belongs_to : BelongsTo
        The part of a calibration that takes it up.
    any_axes, of_rotary_axes : bool
        True if its formula holds for machines with rotary axes as well, or for them alone.
    material_um : float, um
        Where it changes the residual by less it is not named.
    contributions : tuple of Contribution
        Sources of the uncertainty budget that act as it does.
    follows, switches : tuple of Acting
        How it acts where it follows a signal recorded beside the samples, and where it follows
        something that switches, of which nothing is recorded.
    free : tuple of Free
        Its free forms: what it may depend on beside its formula.
    """

    formula: Callable[[State, Shape], Terms]
    name: str = ''
    shape: tuple[ShapeParameter, ...] = ()
    shapes: Callable[[State], Sequence[Shape]] = one_shape
    sizes: Callable[[Coefficients], tuple[Size, ...]] = no_sizes
    shape_matters: Callable[[Shape], bool] = always
    refine: str = ''
    own_per_run: bool = False
    wave: Wave | None = None
    stays_in_place: bool = False
    held_by_tables: bool = False
    many_alike: bool = False
    rigid: bool = False
    couples: bool = False
    belongs_to: BelongsTo = BelongsTo.EFFECTS
    any_axes: bool = False
    of_rotary_axes: bool = False
    material_um: float = 0.2
    contributions: tuple[Contribution, ...] = ()
    follows: tuple[Acting, ...] = ()
    switches: tuple[Acting, ...] = ()
    free: tuple[Free, ...] = ()

    def __post_init__(self) -> None:
        """Take the name of the formula where none is given."""
        object.__setattr__(self, 'name', self.name or self.formula.__name__)

    def __reduce__(self) -> str | tuple[object, ...]:
        """Sent to other processes by its name where a module has it."""
        module = self.formula.__module__
        if getattr(import_module(module), self.name, None) is self:
            return _of_module, (module, self.name)
        return super().__reduce__()

    @property
    def words(self) -> Words:
        """Its description, for effects of the catalogue."""
        return words_of_effects()[self.name]

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Names of the parameters it is not linear in."""
        return tuple(p.name for p in self.shape)

    @property
    def shape_units(self) -> tuple[str, ...]:
        """Their units; '' for a number."""
        return tuple(p.unit for p in self.shape)

    @property
    def refine_width(self) -> float:
        """Relative distance over which the refined shape parameter may move."""
        return next((p.width for p in self.shape if p.name == self.refine), 0.0)

    def loose(self, shape: Shape) -> dict[str, float]:
        """Shape parameters that more data may still move: standard deviation of their logarithm.

        Parameters
        ----------
        shape : mapping of str to float
            As a diagnosis found it.
        """
        matters = self.shape_matters(shape)
        return {p.name: p.width for p in self.shape if p.width and matters}

    def orders_of(self, names: Sequence[str]) -> Array:
        """Orders of coefficients as functions, see ``Terms``, shape (k,)."""
        return np.zeros(len(names))

    @property
    def changes_within_pieces(self) -> bool:
        """True if means over path pieces wash it out: it is evaluated at the samples."""
        return self.wave is not None

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return the linear terms for one complete shape."""
        return self.formula(state, shape)

    def complete_shape(self, parameters: Shape) -> dict[str, float]:
        """Shape parameters with the defaults filled in.

        Raises
        ------
        ConfigError
            Names a shape parameter that is missing or out of range.
        """
        shape = {}
        for one in self.shape:
            value = parameters.get(one.name, one.default)
            if value is None:
                raise ConfigError(f'{self.name}: {one.name}: missing')
            low, high = one.limits or (math.ulp(0.0), math.inf)
            if value != one.default and not (low <= value <= high and math.isfinite(value)):
                wanted = f' [{low:g}, {high:g}]' if one.limits else '; must be above 0'
                raise ConfigError(f'{self.name}: {one.name}: {value} is out of range{wanted}')
            shape[one.name] = float(value)
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
        for start in range(0, len(state), POINTS_AT_ONCE):
            rows = slice(start, start + POINTS_AT_ONCE)
            total[rows] = self.block_displacement(state.part(rows), shape, parameters)
        return total

    def block_displacement(self, state: State, shape: Shape, parameters: Shape) -> Array:
        """Displacement of a few points for checked parameters, shape (n, 3), m."""
        terms = self.terms(state, shape)
        return np.asarray(terms.columns @ np.array([parameters.get(n, 0.0) for n in terms.names]))


def _of_module(module: str, name: str) -> Effect:
    effect: Effect = getattr(import_module(module), name)
    return effect


@dataclass(frozen=True)
class AppliedEffect:
    """An effect of a certain size: what a simulation adds, what a diagnosis found.

    Attributes
    ----------
    parameters : mapping of str to float
        Coefficients and shape by name, in the units of the effect; what is missing is zero or
        the default.
    """

    effect: Effect
    parameters: Shape
