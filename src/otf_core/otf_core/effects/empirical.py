# SPDX-License-Identifier: Apache-2.0
"""Effect without a formula: a tabulated smooth function of inputs, as a diagnosis found it.

The table holds values at nodes of each input; between them the function is the polynomial through
the nodes in the scaled inputs, so table and coefficients of a free form say the same to the last
digits. Beyond the range of an input it stays as at its end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.action import Acting
from otf_core.effects.base import AppliedEffect, Effect, no_terms
from otf_core.effects.free import Free
from otf_core.effects.free_form import FreeForm, coefficient_name
from otf_core.effects.inputs import (
    Span,
    compression,
    cycle_period,
    functions_of,
    nodes_of,
    scaled_input,
    unscaled_input,
)
from otf_core.effects.terms import Shape, State, Terms
from otf_core.files.message_text import shortened

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
