# SPDX-License-Identifier: Apache-2.0
"""Something else: what speaks against the named causes is not only the rest of the catalogue.

The rival of the causes is the likeliest smooth function of one or two inputs, whatever its cause,
priced as an effect is and by the number of functions looked at. With E_c the evidence of the
causes together, E_s that of the rival, both for the noise that the better of them leaves,

    P(causes) : P(something else) = exp(E_c) : exp(E_s).

A function that leaves the trace of the causes is no rival: it is what they do, in other words.
Unless they shift all places alike in the course of time, and it is likelier and says that the
place, or what else, matters: then they only come near.

The odds that an effect needs before it is named are odds of "nothing, and noise other than
assumed"; they count in its confidence as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from otf_core.arrays import Array
from otf_core.diagnosis.engine.empirical_structure import Structures, inputs_of
from otf_core.diagnosis.engine.evidence import log_evidence
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import (
    NEEDED_EVIDENCE,
    Cause,
    fit_jointly,
    noise_variance,
)
from otf_core.effects.action import vector
from otf_core.effects.free_form import FreeForm
from otf_core.effects.inputs import SIGNAL
from otf_core.effects.located_inputs import stands_for

NEXT_TO_NOTHING = 1e-4
"""Share of the largest singular value."""
THE_SAME = 0.1
"""Share of the squared trace of the causes up to which a structure may leave another one and is
no rival: a rougher or smoother form of what they do."""
RIVALS = 3
"""Structures, the likeliest first, whose traces are looked at."""


@dataclass(frozen=True)
class Rival:
    """The likeliest structure that is not what the causes do.

    Attributes
    ----------
    odds : float
        Logarithm of the odds of it against the causes; minus infinity if there is none.
    """

    odds: float = -np.inf
    inputs: tuple[str, ...] = ()

    @property
    def wins(self) -> bool:
        """Whether it has the odds against the causes that a name needs."""
        return self.odds > NEEDED_EVIDENCE

    def confidence(self, cause: Cause) -> float:
        """Probability of a cause among the effects, something else, and nothing."""
        against = np.logaddexp.reduce([0.0, self.odds, NEEDED_EVIDENCE - cause.score])
        return cause.confidence * float(np.exp(-against))


def rival_of(causes: Sequence[Cause], structures: Structures) -> Rival:
    """Weigh the causes of a gap against something else.

    Parameters
    ----------
    causes : sequence of Cause
        Not empty.
    structures : Structures
        Fitted to the same rows.
    """
    rows = structures.rows
    own = np.concatenate([c.option.own for c in causes], axis=1)
    trace = own @ fit_jointly(causes, rows).value
    variance = noise_variance(rows, rows.residual - trace)
    likeliest = sorted(structures.ranked, key=lambda t: -structures.score(t, variance))
    for tried in likeliest[:RIVALS]:
        other = tried.trace(np.arange(len(tried.size)), variance)
        least = min(variance, noise_variance(rows, rows.residual - other))
        odds = structures.score(tried, least) - together(causes, rows, least)
        found = Rival(odds, inputs_of(tried))
        if not _same(trace, other) or (found.wins and _says_more(found.inputs, causes)):
            return found
    return Rival()


def together(causes: Sequence[Cause], rows: Rows, variance: float) -> float:
    """Evidence of causes together: of each on what those before it leave."""
    residual, total = rows.residual, 0.0
    basis = np.zeros((len(residual), 0))
    for cause in causes:
        option = cause.option
        white = option.own - basis @ (basis.T @ option.own)
        orders = np.array(option.terms.orders)
        total += log_evidence(
            white.T @ white,
            white.T @ residual,
            option.size,
            variance,
            orders[option.take] if len(orders) else orders,
        )
        taken = linalg.orth(white, NEXT_TO_NOTHING)
        basis = np.concatenate([basis, taken], axis=1)
        residual = residual - taken @ (taken.T @ residual)
    return total


def _says_more(inputs: Sequence[str], causes: Sequence[Cause]) -> bool:
    """Tell whether a function of time and more stands against shifts by free functions of time."""
    effects = [c.option.effect for c in causes]
    alike = all(isinstance(e, FreeForm) and e.form.acts is vector for e in effects)
    return alike and not all(stands_for(n) == ('time',) or n.startswith(SIGNAL) for n in inputs)


def _same(trace: Array, other: Array) -> bool:
    """Tell whether two explanations take away the same."""
    rest = trace - other
    return float(rest @ rest) < THE_SAME * float(trace @ trace)
