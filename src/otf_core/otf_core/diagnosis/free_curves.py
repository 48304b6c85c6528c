# SPDX-License-Identifier: Apache-2.0
"""The function that a free form found: its curves with their uncertainty, and words on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.diagnosis.cause_parameters import FittedCause
from otf_core.effects.free_form import FreeForm, coefficient_name
from otf_core.effects.inputs import (
    SIGNAL,
    label_of,
    shown_places,
    unit_of_input,
    unscaled_input,
)

NO_UNITS: Mapping[str, str] = MappingProxyType({})
POINTS = 41
"""Points of a curve; fewer where the input has few values."""
SEEN = 0.5
"""Share of the variance before the data from which they do not see a combination."""
SENSE, SENSES = 'sense_', {-1: 'backward', 0: 'at rest', 1: 'forward'}
"""Inputs that are senses of travel, and their values in words."""
LEAST_SHARE = 0.1
"""Curves smaller than this share of the largest one are left out."""
SCALES = {'m': (1e6, 'um'), 'rad': (1e6, 'urad'), 'm/m': (1e6, 'um/m'), 's': (1e3, 'ms')}
"""Factor and unit for words, by the SI unit of a curve."""


@dataclass(frozen=True)
class Curve:
    """One curve of a free form, the other inputs in the middle of their ranges.

    Attributes
    ----------
    term : str
        Direction, rotation or coefficient of the formula that follows it.
    axis : str
        Machine axis of the term, if any.
    at : tuple of float
        Values of the input, SI.
    value, u : tuple of float
        Value and its standard uncertainty, in ``unit``, but for what the data do not see, such as
        the mean of a shift, which the place of the tracker holds as well.
    held : mapping of str to float
        Values of the other inputs.
    """

    term: str
    axis: str
    input: str
    input_unit: str
    at: tuple[float, ...]
    value: tuple[float, ...]
    u: tuple[float, ...]
    unit: str
    held: dict[str, float]


def curves_of(part: FittedCause, units: Mapping[str, str] = NO_UNITS) -> tuple[Curve, ...]:
    """Curves of a free form, the largest first; none of a formula.

    Where a function has two inputs, it is shown along each at the middle of the other, and along
    the first at both ends of the second.

    Parameters
    ----------
    units : mapping of str to str
        Of declared signals, by their names as inputs.
    """
    effect, option = part.cause.option.effect, part.cause.option
    if not isinstance(effect, FreeForm):
        return ()
    count = option.terms.columns.shape[2]
    per_term = len(effect.form.numbers)
    found: list[tuple[float, Curve]] = []
    covariance = _seen_covariance(part)
    for first in range(0, count, per_term):
        place = np.flatnonzero((option.take >= first) & (option.take < first + per_term))
        if place.size != per_term:
            continue
        term = option.terms.names[first].rsplit('_', len(effect.form.orders))[0]
        assert option.terms.names[first] == coefficient_name(term, effect.form.numbers[0])
        for curve in _curves(part, covariance, effect, place, term, units):
            size = float(np.sqrt(np.mean(np.square(curve.value)))) * float(option.size[place[0]])
            found.append((size, curve))
    largest = max((size for size, _ in found), default=0.0)
    kept = [(s, c) for s, c in found if s > LEAST_SHARE * largest]
    return tuple(c for _, c in sorted(kept, key=lambda pair: -pair[0]))


def _seen_covariance(part: FittedCause) -> Array:
    """Covariance of the combinations of coefficients that the data see, shape (k, k)."""
    option = part.cause.option
    if not len(option.width):
        return part.covariance
    prior = option.width / np.maximum(option.size, 1e-300)
    share, ways = np.linalg.eigh(part.covariance / prior / prior[:, None])
    seen = share < SEEN
    own = ways[:, seen] * prior[:, None]
    return np.asarray((own * share[seen]) @ own.T)


def _curves(
    part: FittedCause,
    whole: Array,
    effect: FreeForm,
    place: Index,
    term: str,
    units: Mapping[str, str],
) -> list[Curve]:
    """Curves of one term; ``whole`` is the covariance of all coefficients."""
    option = part.cause.option
    axis = option.terms.axes[option.take[place[0]]]
    inputs = effect.inputs_of(term, axis)
    value, covariance = part.value[place], whole[np.ix_(place, place)]
    along = shown_places(inputs[0], POINTS)
    levels = (0.0,) if len(inputs) == 1 else (-1.0, 0.0, 1.0)
    curves = []
    for level in levels:
        places = [along, *(np.full(len(along), level) for _ in inputs[1:])]
        table = effect.functions(places)
        u = np.sqrt(np.maximum(np.einsum('ij,jk,ik->i', table, covariance, table), 0.0))
        held = {
            n: float(unscaled_input(n, np.array([level]), effect.spans[n])[0]) for n in inputs[1:]
        }
        at = unscaled_input(inputs[0], along, effect.spans[inputs[0]])
        curves.append(
            Curve(
                term,
                axis,
                inputs[0],
                units.get(inputs[0].partition('@')[0]) or unit_of_input(inputs[0]),
                tuple(at.tolist()),
                tuple((table @ value).tolist()),
                tuple(u.tolist()),
                option.terms.units[option.take[place[0]]],
                held,
            )
        )
    return curves


def number_words(value: float, unit: str) -> str:
    """Value with a unit that is easy to read."""
    factor, name = SCALES.get(unit, (1.0, unit))
    if unit == 'm' and abs(value) >= 1e-3:
        factor, name = 1e3, 'mm'
    return f'{factor * value:.3g} {name}'.rstrip()


def departs_words(part: FittedCause, units: Mapping[str, str] = NO_UNITS) -> str:
    """How a free form departs from the formula, in words; empty for a formula.

    Of what follows a signal all coefficients are stated: what a thermal model needs.
    """
    effect, curves = part.cause.option.effect, curves_of(part, units)
    if not isinstance(effect, FreeForm) or not curves:
        return ''
    if slopes := [f'{c.term}{words}' for c in curves if (words := _slope_words(c))]:
        beside = '; a function of time explains it as well' if part.cause.time_as_well else ''
        return f'{effect.form.words}: {", ".join(slopes)} (k = 1){beside}'
    return f'{effect.form.words}: {range_words(curves[0])}'


def range_words(curve: Curve) -> str:
    """Where a curve is lowest and highest, in words."""
    low, high = int(np.argmin(curve.value)), int(np.argmax(curve.value))
    ends = ' to '.join(
        f'{number_words(curve.value[k], curve.unit)} at {at_words(curve.input, curve.at[k])}'
        for k in sorted((low, high), key=lambda k: curve.at[k])
    )
    held = ', '.join(at_words(n, v) for n, v in curve.held.items())
    return f'{curve.term} goes from {ends}' + (f' ({held})' if held else '')


def _slope_words(curve: Curve) -> str:
    """How much a curve that follows a signal changes per unit of it."""
    width = curve.at[-1] - curve.at[0]
    if not curve.input.startswith(SIGNAL) or curve.held or width <= 0.0:
        return ''
    slope, u = (curve.value[-1] - curve.value[0]) / width, curve.u[-1] / width
    factor, unit = SCALES.get(curve.unit, (1.0, curve.unit))
    per = curve.input_unit or 'unit of the signal'
    return f' {factor * slope:.3g} +/- {factor * u:.1g} {unit} per {per}'


def at_words(name: str, value: float) -> str:
    """An input and its value in words."""
    if name.startswith(SENSE):
        return f'{name.removeprefix(SENSE).upper()} {SENSES[int(np.sign(round(value)))]}'
    unit = unit_of_input(name)
    words = f'{1e3 * value:.3g} mm' if unit == 'm' else f'{value:.3g} {unit}'.rstrip()
    return f'{label_of(name)} = {words}'
