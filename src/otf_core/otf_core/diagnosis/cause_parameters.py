# SPDX-License-Identifier: Apache-2.0
"""Parameters of the causes, fitted together, their curves where they are free, and their sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.diagnosis.engine.evidence import Estimate, products_of
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import Cause, fit_jointly, places_of
from otf_core.documents import Document, stated
from otf_core.effects import EVERY, AppliedEffect, BelongsTo, State
from otf_core.effects.base import Coefficients, Size
from otf_core.effects.free_form import FreeForm, coefficient_name
from otf_core.effects.inputs import (
    SIGNAL,
    label_of,
    shown_places,
    unit_of_input,
    unscaled_input,
)
from otf_core.model.expanded import COVERAGE_FACTOR, quantity
from otf_core.model.machine import Machine
from otf_core.solving.residuals import leg_numbers

FREE = 3.0
"""Standard deviation of what the data do not see, over the largest displacement found."""
LAGS, LAGS_POWER = 4.0, 2.0 / 9.0
"""Legs apart up to which residuals are taken as correlated: ``LAGS`` (n / 100)**``LAGS_POWER`` of
n legs (Newey and West, Rev. Econ. Stud. 61 (1994) 631)."""
STEP = 0.01
"""Step of a refined shape, in widths of the search for it, by which its trace is differenced."""
SIGNIFICANT = 2.0
"""Standard deviations at which an axis takes part in a cause."""


@dataclass(frozen=True)
class FittedCause:
    """Parameters of one cause.

    Attributes
    ----------
    value, u : ndarray, shape (k,)
        Coefficients of its terms and their standard uncertainties. Combinations that the data do
        not see are zero in ``value``; in ``u`` they may be ``FREE`` times as large as the rest.
    u_seen : ndarray, shape (k,)
        Without these combinations.
    covariance : ndarray, shape (k, k)
        Of what the data see.
    unseen : ndarray, shape (k, m)
        Combinations that they do not see, each as large as ``FREE`` allows.
    """

    cause: Cause
    value: Array
    u: Array
    u_seen: Array
    covariance: Array
    unseen: Array

    @property
    def names(self) -> list[str]:
        """Names of the coefficients."""
        return [self.cause.option.terms.names[i] for i in self.cause.option.take]

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes whose coefficients are significant, strongest first."""
        option = self.cause.option
        strength: dict[str, float] = {}
        rows = zip(option.take, self.value, self.u_seen, option.size, strict=True)
        for i, value, u, size in rows:
            axis = option.terms.axes[i]
            if axis and abs(value) > SIGNIFICANT * u:
                strength[axis] = strength.get(axis, 0.0) + (value * size) ** 2
        largest = max(strength.values(), default=0.0)
        involved = {a: s for a, s in strength.items() if s > 0.02 * largest}
        return tuple(sorted(involved, key=lambda a: -involved[a]))

    def applied(self, run: int) -> AppliedEffect:
        """The effect with its fitted parameters in one run."""
        option = self.cause.option
        of_first = option.terms.columns.shape[2]  # what other runs have of their own comes after
        place = option.take - of_first * (run if option.effect.own_per_run else 0)
        values = {
            option.terms.names[i]: float(value)
            for i, value in zip(place, self.value, strict=True)
            if 0 <= i < of_first
        }
        return AppliedEffect(option.effect, {**option.shape, **values})


def fitted_causes(causes: Sequence[Cause], rows: Rows) -> list[FittedCause]:
    """Fit all causes jointly and split the parameters up again."""
    if not causes:
        return []
    known, causes = causes, [_of_samples(cause, rows) for cause in causes]
    fit = fit_jointly(causes, rows)
    size = np.concatenate([cause.option.size for cause in causes])
    free = FREE * float(np.max(np.abs(fit.value) * size))
    covariance = _widen(fit.covariance, _scores(causes, fit, rows)) + _of_shapes(causes, fit, rows)
    seen = np.diag(covariance)
    unseen = free * fit.unseen
    u = np.sqrt(seen + np.sum(unseen**2, axis=1))
    return [
        FittedCause(
            cause, fit.value[own], u[own], np.sqrt(seen[own]), covariance[own, own], unseen[own]
        )
        for cause, own in zip(known, places_of(known), strict=True)
    ]


def _of_samples(cause: Cause, rows: Rows) -> Cause:
    """Cause with means over the samples where it bends between nodes.

    Pieces of a third of a node interval see bows some percent smaller than their centres do. The
    search compares shapes, for which that is of no consequence.
    """
    option = cause.option
    if option.effect.belongs_to is not BelongsTo.TABLES or not rows.runs:
        return cause
    plain = rows.plain_columns(option.effect, option.shape, of_samples=True)[:, option.take]
    return replace(
        cause, option=replace(option, plain=plain, own=rows.project(rows.whiten(plain)))
    )


def _scores(causes: Sequence[Cause], fit: Estimate, rows: Rows) -> list[Array]:
    """Products of columns and residuals of every leg of every run, shape (legs, k)."""
    own = np.concatenate([c.option.own for c in causes], axis=1)
    residual = rows.residual - own @ fit.value
    scores = []
    parts = zip(rows.by_run(own), rows.by_run(residual), leg_numbers(rows.done), strict=True)
    for columns, rest, number in parts:
        products = np.einsum('cpk,cp->pk', columns, rest)
        starts = np.flatnonzero(np.diff(number, prepend=-1))
        scores.append(np.add.reduceat(products, starts, axis=0))
    return scores


def _widen(covariance: Array, scores: Sequence[Array]) -> Array:
    """Covariance of coefficients, widened where residuals of a leg have more in common than noise.

    What the causes leave is noise and what no model has, which pulls the coefficients as well.
    With S the covariance of the scores as legs show it, correlated over some of them, C S C is
    that of the coefficients whatever the residuals are made of (Newey and West, Econometrica 55
    (1987) 703). Its variances count where they are larger than those of the noise.
    """
    total = np.zeros_like(covariance)
    for own in scores:
        total += own.T @ own
        most = int(LAGS * (len(own) / 100.0) ** LAGS_POWER)
        for lag in range(1, min(most, len(own) - 1) + 1):
            cross = own[lag:].T @ own[:-lag]
            total += (1.0 - lag / (most + 1.0)) * (cross + cross.T)
    shown = np.einsum('ij,jk,ik->i', covariance, total, covariance)
    known = np.maximum(np.diag(covariance), 1e-300)
    wider = np.sqrt(np.maximum(shown / known, 1.0))
    return np.asarray(covariance * np.outer(wider, wider))


def _of_shapes(causes: Sequence[Cause], fit: Estimate, rows: Rows) -> Array:
    """What refined shapes, such as a period, add to the covariance of the coefficients.

    With C that of the coefficients of columns E alone, and s what a cause changes by per logarithm
    of its shape, which the search knows to within w: C E's (s's - s'E C E's + w^-2)^-1 s'E C.
    """
    total = np.zeros_like(fit.covariance)
    for cause, own in zip(causes, places_of(causes), strict=True):
        if cause.option.effect.refine:
            slope = _slope(cause, fit.value[own], rows)
            cross = products_of([c.option for c in causes], slope)[1]
            moved = fit.covariance @ cross
            known = slope @ slope - cross @ moved
            total += np.outer(moved, moved) / (known + cause.option.effect.refine_width**-2)
    return total


def _slope(cause: Cause, value: Array, rows: Rows) -> Array:
    """Change of a cause per logarithm of its refined shape, projected and whitened, shape (r,)."""
    option = cause.option
    name, step = option.effect.refine, STEP * option.effect.refine_width
    shapes = ({**option.shape, name: option.shape[name] * np.exp(k * step)} for k in (-1, 1))
    before, after = (rows.plain_columns(option.effect, s)[:, option.take] @ value for s in shapes)
    change = (after - before) / (2.0 * step)
    return rows.project(rows.whiten(change[:, None]))[:, 0]


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
class Curve(Document):
    """One curve of a free form, the other inputs in the middle of their ranges.

    What the data do not see is left out of value and u, such as the mean of a shift, which the
    place of the tracker holds as well.
    """

    term: str = stated('direction, rotation or coefficient of the formula that follows it')
    axis: str = stated('machine axis of the term, if any')
    input: str = stated('name of the input')
    input_unit: str = stated('unit of the input')
    at: tuple[float, ...] = stated('values of the input', 'SI')
    value: tuple[float, ...] = stated('in unit')
    u: tuple[float, ...] = stated('standard uncertainty, in unit')
    unit: str = stated('of value and u')
    held: Mapping[str, float] = stated('values of the other inputs', 'SI')


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
    by_size: list[tuple[float, Curve]] = []
    covariance = _seen_covariance(part)
    for first in range(0, count, per_term):
        place = np.flatnonzero((option.take >= first) & (option.take < first + per_term))
        if place.size != per_term:
            continue
        term = option.terms.names[first].rsplit('_', len(effect.form.orders))[0]
        assert option.terms.names[first] == coefficient_name(term, effect.form.numbers[0])
        for curve in _curves(part, covariance, effect, place, term, units):
            size = float(np.sqrt(np.mean(np.square(curve.value)))) * float(option.size[place[0]])
            by_size.append((size, curve))
    largest = max((size for size, _ in by_size), default=0.0)
    relevant = [(s, c) for s, c in by_size if s > LEAST_SHARE * largest]
    return tuple(c for _, c in sorted(relevant, key=lambda pair: -pair[0]))


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


WHOLE = 'rms across the path'
"""What stands for an effect of which no coefficient does."""


@dataclass(frozen=True)
class CauseSize(Document):
    """A size of a cause."""

    of: str = stated('of X, along Z ...; empty: of all of it')
    value: float = stated('value', 'SI')
    u: float | None = stated('standard uncertainty; null: chosen, not estimated')
    unit: str = stated('of value and u')
    remark: str = stated('what kind of size it is', default='')

    @property
    def words(self) -> str:
        """Value, expanded uncertainty (k = 2) and unit."""
        return quantity(self.value, self.u, self.unit)

    @property
    def significant(self) -> bool:
        """True if it is larger than its expanded uncertainty."""
        return self.u is None or abs(self.value) > COVERAGE_FACTOR * self.u


def sizes_of(
    part: FittedCause, states: Sequence[State], curves: Sequence[Curve]
) -> tuple[CauseSize, ...]:
    """Sizes of a cause, those that are significant, or else the first.

    Parameters
    ----------
    states : sequence of State
        Of the pieces of every run.
    curves : sequence of Curve
        Of a free form, the largest first: what is stated of it is the largest value.
    """
    if curves:
        return (_of_curves(curves),)
    in_run = [_InRun(part, k, states) for k in range(_runs_of_its_own(part, states))]
    strongest = max(in_run, key=lambda one: one.displacement)
    sizes = [strongest.evaluated(s) for s in strongest.sizes()] or [strongest.whole()]
    return tuple([s for s in sizes if s.significant] or sizes[:1])


def chosen_sizes(
    effect: str, parameters: dict[str, float], machine: Machine
) -> tuple[CauseSize, ...]:
    """Sizes of an effect without coefficients."""
    sizes = EVERY[effect].sizes(Coefficients({}, {}, (), parameters, machine))
    return tuple(CauseSize(s.of, s.chosen, None, s.unit, s.remark) for s in sizes)


def sizes_words(sizes: Sequence[CauseSize], direction: str) -> str:
    """Sizes as they follow the name of a cause: ' of X, 5.02 +/- 0.19 um'."""
    kinds = dict.fromkeys(s.remark for s in sizes)
    parts = []
    for size in sizes:
        of = size.of or (f'along {direction}' if direction and size.unit == 'm' else '')
        remark = f' ({size.remark})' if size.remark and len(kinds) > 1 else ''
        parts.append(f' {of}, {size.words}{remark}' if of else f', {size.words}{remark}')
    common = next(iter(kinds)) if len(kinds) == 1 else ''
    return ', and'.join(parts) + (f' ({common})' if common else '')


def _runs_of_its_own(part: FittedCause, states: Sequence[State]) -> int:
    return len(states) if part.cause.option.effect.own_per_run else 1


def _of_curves(curves: Sequence[Curve]) -> CauseSize:
    """Largest value of the strongest function of a free form, and its root mean square."""
    term = curves[0].term
    own = [c for c in curves if c.term == term]
    value = np.concatenate([c.value for c in own])
    k = int(np.argmax(np.abs(value)))
    u = float(np.concatenate([c.u for c in own])[k])
    rms = number_words(float(np.sqrt(np.mean(value**2))), curves[0].unit)
    of = f'of {curves[0].axis or term}'
    return CauseSize(of, float(value[k]), u, curves[0].unit, f'free form: largest; rms {rms}')


class _InRun:
    """Coefficients of a cause in one run."""

    def __init__(self, part: FittedCause, run: int, states: Sequence[State]) -> None:
        option = part.cause.option
        count = option.terms.columns.shape[2]
        self.place = np.flatnonzero(option.take // max(count, 1) == run)
        names = [option.terms.names[i] for i in option.take[self.place] - run * count]
        self.part, self.names, self.pieces = part, names, sum(map(len, states))
        axes = part.axes or tuple(dict.fromkeys(option.terms.axes[i] for i in option.take))
        self.coefficients = Coefficients(
            dict(zip(names, part.value[self.place].tolist(), strict=True)),
            dict(zip(names, option.size[self.place].tolist(), strict=True)),
            axes,
            option.shape,
            states[run].machine,
        )
        self.remark = f'in run {run + 1}' if len(states) > 1 and option.effect.own_per_run else ''

    @property
    def displacement(self) -> float:
        """Root mean square displacement across the path, m."""
        plain = self.part.cause.option.plain[:, self.place] @ self.part.value[self.place]
        return float(np.sqrt(plain @ plain / self.pieces))

    def sizes(self) -> tuple[Size, ...]:
        """What the file of the effect states."""
        return self.part.cause.option.effect.sizes(self.coefficients)

    def evaluated(self, size: Size) -> CauseSize:
        """Value and standard uncertainty of a size."""
        weights = np.array([[p.get(n, 0.0) for n in self.names] for p in size.parts])
        values = weights @ self.part.value[self.place]
        if len(values) == 1:
            value, slope = float(values[0]), weights[0]
        else:
            value = float(np.linalg.norm(values))
            slope = values @ weights / max(value, 1e-300)
        remark = ', '.join(filter(None, (size.remark, self.remark)))
        return CauseSize(size.of, value, self._u(slope), size.unit, remark)

    def whole(self) -> CauseSize:
        """Displacement across the path with its standard uncertainty."""
        columns = self.part.cause.option.plain[:, self.place]
        value = self.displacement
        moved = columns @ self.part.value[self.place]
        slope = moved @ columns / (self.pieces * max(value, 1e-300))
        remark = ', '.join(filter(None, (WHOLE, self.remark)))
        return CauseSize('', value, self._u(slope), 'm', remark)

    def _u(self, slope: Array) -> float:
        own = self.place
        square = slope @ self.part.covariance[np.ix_(own, own)] @ slope
        return math.sqrt(max(0.0, float(square + np.sum((slope @ self.part.unseen[own]) ** 2))))
