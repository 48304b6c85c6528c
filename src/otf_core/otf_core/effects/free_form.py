# SPDX-License-Identifier: Apache-2.0
"""Free form of an effect: a smooth function of few inputs times what it acts with.

delta = sum over j, k of c_jk P_k(u) A_j, A_j the columns of an effect's formula or of a way to
act, P_k products of Legendre polynomials of the inputs u scaled to [-1, 1] (of a phase: harmonics,
``inputs.functions_of``). Smoothness is the prior: a coefficient of the total order |k| has a
standard deviation in proportion to (1 + |k|)^-r, with r and the size estimated from the data by
their marginal likelihood (restricted maximum likelihood, e.g. Rasmussen and Williams, Gaussian
Processes for Machine Learning, 2006, sections 2.7 and 5.4).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.action import ACTING, Acting, Along
from otf_core.effects.base import AppliedEffect, Effect, no_terms
from otf_core.effects.free import AXIS, TERM, Free, follower
from otf_core.effects.inputs import (
    SIGNAL,
    TURNS,
    Span,
    compression,
    cycle_period,
    functions_of,
    head_of,
    input_values,
    nodes_of,
    scaled_input,
    span_of,
    unscaled_input,
)
from otf_core.effects.terms import Shape, State, Terms
from otf_core.files.message_text import shortened

SAME_PLACE = 0.05
"""Distance of two places of the tracker, as a share of the longest beam, up to which they count
as one."""


_BARE = Effect(no_terms)
_OF_FORMULA = (
    'sizes',
    'many_alike',
    'held_by_tables',
    'contributions',
    'follows',
    'switches',
    'free',
)
_OF_SHAPE = ('shape', 'shapes', 'shape_matters', 'refine', 'wave')
"""Facts that a free form does not share with its effect; the second where it has no shape."""


class FreeForm(Effect):
    """Free form with the ranges of its inputs: an effect like any other.

    Attributes
    ----------
    parent : Effect
        Whose name it has, and whose shape where it acts with that.
    spans : mapping of input to (float, float)
    """

    form: Free
    parent: Effect
    spans: dict[str, Span]

    def __init__(self, parent: Effect, free: Free, spans: Mapping[str, Span]) -> None:
        facts = {f.name: getattr(parent, f.name) for f in fields(Effect)}
        for fact in _OF_FORMULA if free.shaped else (*_OF_FORMULA, *_OF_SHAPE):
            facts[fact] = getattr(_BARE, fact)
        own = {'own_per_run': free.own_per_run, 'belongs_to': free.belongs_to}
        facts |= {name: value for name, value in own.items() if value is not None}
        vars(self).update(facts, form=free, parent=parent, spans=dict(spans))

    def __eq__(self, other: object) -> bool:
        """Two are the same with the same declaration and ranges."""
        return isinstance(other, FreeForm) and self._key == other._key

    def __reduce__(self) -> tuple[type[FreeForm], tuple[Effect, Free, dict[str, Span]]]:
        """Sent to other processes as what it is made of."""
        return FreeForm, (self.parent, self.form, self.spans)

    def __hash__(self) -> int:
        """By name and inputs."""
        return hash((self.name, self.form.inputs))

    @property
    def changes_within_pieces(self) -> bool:
        """As of the formula, or where it depends on a cycle along an axis."""
        return self.wave is not None or any(head_of(n) in TURNS for n in self.form.inputs)

    @property
    def is_structure(self) -> bool:
        """Whether a diagnosis found it, with a name or without; False for what effects declare.

        Files have it as a table.
        """
        form = self.form
        acts = isinstance(form.acts, Along) or form.acts in ACTING.values()
        return acts and not form.least and not form.zero_at

    @property
    def _key(self) -> tuple[str, Free, dict[str, Span]]:
        return self.name, self.form, self.spans

    @classmethod
    def bound(cls, parent: Effect, free: Free, states: Sequence[State]) -> FreeForm:
        """Bind a declaration to the ranges that its inputs have in some runs."""
        wave, shape = parent.wave, {}
        if free.shaped:
            first = {wave.parameter: wave.probe} if wave else parent.shapes(states[0])[0]
            shape = parent.complete_shape(first)
        terms = multipliers(parent, free)(states[0].part(slice(0, 1)), shape)
        return cls(parent, free, {name: span_of(states, name) for name in free.names(terms)})

    def orders_of(self, names: Sequence[str]) -> Array:
        """Sum of the orders of the polynomials that a name ends with."""
        count = len(self.form.orders)
        numbers = [[float(n) for n in name.rsplit('_', count)[1:]] for name in names]
        return np.asarray(np.maximum(np.sum(numbers, axis=1) - sum(self.form.least), 0.0))

    def units(self, state: State, parameters: Shape) -> dict[str, str]:
        """Unit of every given parameter; signals need not be known for that."""
        lacking = {n for n in self.spans if n.startswith(SIGNAL) and n not in state.more}
        if lacking:
            none = {n: np.zeros(len(state)) for n in lacking}
            state = replace(state, more={**state.more, **none})
        return super().units(state, parameters)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return A_k: term of what it acts with, and the orders of the polynomials."""
        base, functions = self.factors(state, shape)
        names, axes, units, columns = [], [], [], []
        numbers = self.form.numbers
        for j, (term, axis) in enumerate(zip(base.names, base.axes, strict=True)):
            columns.append(base.columns[:, :, j, None] * functions[j][:, None, :])
            names += [coefficient_name(term, number) for number in numbers]
            axes += [axis] * len(numbers)
            units += [base.units[j]] * len(numbers)
        least = sum(self.form.least)
        orders = tuple(float(sum(n) - least) for n in numbers) * len(base.names)
        whole = np.concatenate(columns, axis=2)
        return Terms(tuple(names), tuple(units), tuple(axes), whole, orders)

    def factors(self, state: State, shape: Shape) -> tuple[Terms, list[Array]]:
        """What it acts with, and the functions (n, k) that each term of that is times."""
        base = multipliers(self.parent, self.form)(state, shape)
        by_input: dict[tuple[str, ...], Array] = {}
        factors = []
        for term, axis in zip(base.names, base.axes, strict=True):
            own = self.inputs_of(term, axis)
            if own not in by_input:
                by_input[own] = self.functions([
                    scaled_input(n, input_values(state, n), self.spans[n]) for n in own
                ])  # fmt: skip
            factors.append(by_input[own])
        return base, factors

    def inputs_of(self, term: str, axis: str) -> tuple[str, ...]:
        """Inputs of one term of what it acts with."""
        return tuple(n.replace(AXIS, axis.lower()).replace(TERM, term) for n in self.form.inputs)

    def functions(self, places: Sequence[Array]) -> Array:
        """Products of polynomials at scaled inputs, each (n,), shape (n, k)."""
        tables = []
        parts = zip(self.form.inputs, places, self.form.orders, strict=True)
        for number, (name, place, order) in enumerate(parts):
            table = functions_of(name, place, order, self.spans.get(name, (-1.0, 1.0)))
            if number == 0 and self.form.zero_at:
                table = table - self.form.zero_at ** np.arange(order + 1)
            tables.append(table)
        products = [
            np.prod([t[:, k] for t, k in zip(tables, number, strict=True)], axis=0)
            for number in self.form.numbers
        ]
        return np.stack(products, axis=1)


def multipliers(parent: Effect, free: Free) -> Acting:
    """What the function of a free form is multiplied with."""
    return parent.terms if free.acts is None else free.acts


def coefficient_name(term: str, number: Sequence[int]) -> str:
    """Name of the coefficient of a term and the orders of its polynomials."""
    return '_'.join([term, *map(str, number)])


def free_forms(effect: Effect, states: Sequence[State]) -> list[FreeForm]:
    """Free forms of an effect, bound to runs, those that follow their signals among them."""
    moved = _several_places(states)
    forms = [free for free in effect.free if moved or not free.several_places]
    forms += signal_forms(effect, states)
    return [FreeForm.bound(effect, free, states) for free in forms]


def _several_places(states: Sequence[State]) -> bool:
    """Return whether the tracker stood at several places, seen from the machine."""
    places = np.array([np.mean(s.point - s.beam, axis=0) for s in states if len(s)])
    if len(places) < 2:
        return False
    longest = max(float(np.linalg.norm(s.beam, axis=1).max()) for s in states if len(s))
    return bool(np.linalg.norm(places - places[0], axis=1).max() > SAME_PLACE * longest)


def signal_forms(effect: Effect, states: Sequence[State]) -> list[Free]:
    """In proportion to each signal that all runs have, that changes and may drive the effect."""
    others = {s.name for s in states[0].machine.signals if effect.name not in s.acts_on}
    names = [n for n in states[0].more if n.startswith(SIGNAL)]
    names = [n for n in names if n.partition('@')[0] not in others]
    names = [n for n in names if all(n in s.more and np.ptp(s.more[n]) > 0.0 for s in states)]
    return [follower(acts, name) for name in names for acts in effect.follows]


# Effects without a formula: a tabulated smooth function of inputs, as a diagnosis found it. The
# table holds values at nodes of each input; between them the function is the polynomial through
# the nodes in the scaled inputs, so table and coefficients of a free form say the same to the last
# digits. Beyond the range of an input it stays as at its end.

EMPIRICAL = 'empirical'
CONDITION = 1e8
"""Nodes so close that digits are lost are refused; the condition number of their polynomials."""


class Empirical(Effect):
    """What carries a tabulated function; it does nothing by itself."""

    def __init__(self, name: str = EMPIRICAL) -> None:
        super().__init__(no_terms, name)


def node_table(one: AppliedEffect) -> tuple[dict[str, list[float]], dict[str, Array]]:
    """Nodes of every input, SI, and the values of every term on their grid.

    Parameters
    ----------
    one : AppliedEffect
        Of a ``FreeForm`` whose inputs do not depend on the term.
    """
    effect = one.effect
    assert isinstance(effect, FreeForm)
    form = effect.form
    names = list(effect.spans)
    places = [
        _reached(n, nodes_of(n, order), effect.spans[n])
        for n, order in zip(names, form.orders, strict=True)
    ]
    grid = np.meshgrid(*places, indexing='ij')
    table = effect.functions([g.ravel() for g in grid])
    nodes = {
        n: unscaled_input(n, p, effect.spans[n]).tolist()
        for n, p in zip(names, places, strict=True)
    }
    values = {}
    terms = {n.rsplit('_', len(form.orders))[0] for n in one.parameters}
    for term in sorted(terms):
        own = [one.parameters.get(coefficient_name(term, k), 0.0) for k in form.numbers]
        values[term] = (table @ np.array(own)).reshape([len(p) for p in places])
    return nodes, values


def _reached(name: str, places: Array, span: Span) -> Array:
    """Nodes in [-1, 1] moved to where the values of an input end; only infinity is 1 of some."""
    top = float(scaled_input(name, np.array([span[1]]), span)[0]) if compression(name) else 1.0
    return np.asarray(-1.0 + 0.5 * (places + 1.0) * (top + 1.0))


def of_table(
    name: str, acts: Acting, nodes: Mapping[str, Sequence[float]], values: Mapping[str, Array]
) -> AppliedEffect:
    """Build the effect of a table.

    Parameters
    ----------
    nodes : mapping of input to sequence of float
        Ascending, the first and the last are the range; of a phase an odd number in one period.
    values : mapping of term to ndarray
        On the grid of the nodes.

    Raises
    ------
    ValueError
        If the nodes of an input are too close or not apart.
    """
    spans: dict[str, Span] = {
        n: (0.0, cycle_period(n)) if cycle_period(n) else (float(v[0]), float(v[-1]))
        for n, v in nodes.items()
    }
    form = Free(tuple(nodes), tuple(len(v) - 1 for v in nodes.values()), acts=acts)
    inverses = []
    for n, own in nodes.items():
        place = scaled_input(n, np.array(own, dtype=float), spans[n])
        matrix = functions_of(n, place, len(own) - 1)
        if not np.linalg.cond(matrix) < CONDITION:
            raise ValueError(
                f'{shortened(n)}: the nodes are too close to each other or not ascending'
            )
        inverses.append(np.linalg.inv(matrix))
    parameters = {}
    for term, value in values.items():
        coefficients = np.asarray(value, dtype=float)
        for k, inverse in enumerate(inverses):
            coefficients = np.moveaxis(np.tensordot(inverse, coefficients, axes=(1, k)), 0, k)
        for number in form.numbers:
            parameters[coefficient_name(term, number)] = float(coefficients[number])
    return AppliedEffect(FreeForm(Empirical(name), form, spans), parameters)


class OwnCause(Empirical):
    """A cause of one's own: an empirical effect with a name, its size free.

    Its free form depends on the same inputs in the same way.

    Parameters
    ----------
    one : AppliedEffect
        As read from a file.
    """

    one: AppliedEffect

    def __init__(self, one: AppliedEffect) -> None:
        super().__init__(one.effect.name)
        assert isinstance(one.effect, FreeForm)
        form = replace(one.effect.form, words='the function is another one of the same inputs')
        vars(self).update(one=one, free=(form,))

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return size: 1 is as tabulated."""
        moved = self.one.effect.displacement(state, self.one.parameters)
        return Terms.of(['size'], '', moved[:, :, None])

    def sized(self, parameters: Shape) -> AppliedEffect:
        """The table times a size."""
        size = parameters.get('size', 0.0)
        scaled = {name: size * value for name, value in self.one.parameters.items()}
        return AppliedEffect(self.one.effect, scaled)
