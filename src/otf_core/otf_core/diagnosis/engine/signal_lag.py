# SPDX-License-Identifier: Apache-2.0
"""Effects that follow a signal: at the lag that no raster holds, and beside functions of time.

Of what warms up, a lag that is wrong by a tenth leaves a hundredth of the squared trace: enough
to prefer a free function of time. So for every effect and way to act the likeliest signal is
tried with the lag that makes the data most likely, in proportion to it and as a parabola.

Every signal is a function of time too, and a free one has so many coefficients that it can follow
most of them. One that is recorded and may drive the effect is the likelier cause where it does
about as well with three coefficients and a lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.diagnosis.engine.effect_products import ProductsBeside, ShapeProducts, tried_shapes
from otf_core.effects.free import follower
from otf_core.effects.free_form import FreeForm
from otf_core.effects.inputs import SIGNAL
from otf_core.model.signals import LAGS, Courses, lag_of

SHORTEST = 2.0
"""s; a shorter lag is none."""
WITHIN = 2.0
"""Factor within which the lag is looked for, the raster of ``LAGS``."""
CLOSE = 1e-3
"""Of the logarithm of a lag."""
AS_WELL = 5.0
"""Logarithm of the odds by which a function of time may be better than a signal that is named."""
ALMOST_ALL = 0.99
"""Share of the evidence of a free function of time from which a signal is named instead."""
LEAST_SHARE = 0.5
"""Of the best score of an effect: what follows a signal less well is not looked at again."""


def signal_of(tried: ShapeProducts) -> str:
    """Signal that a form follows, with its lag; empty if it follows none."""
    effect = tried.effect
    if not isinstance(effect, FreeForm) or len(effect.form.inputs) != 1:
        return ''
    (name,) = effect.form.inputs
    return name if name.startswith(SIGNAL) else ''


def in_proportion(tried: ShapeProducts) -> bool:
    """Return whether a form is in proportion to a signal: as simple as a formula."""
    return bool(signal_of(tried)) and max(tried.terms.orders) == 0.0


def choose_candidate(
    tried: Sequence[ShapeProducts], worth: Array, *, formula: NDArray[np.bool_]
) -> int:
    """Number of the candidate of an effect to be named.

    The likeliest one, or one that follows a signal and is about as good: of a free function of
    time in its evidence, of a formula in its odds.

    Parameters
    ----------
    worth : ndarray, shape (k,)
        Their scores.
    formula : ndarray of bool, shape (k,)
        Which of them are no free forms.
    """
    best = int(np.argmax(worth))
    follow = np.array([bool(signal_of(t)) for t in tried])
    if follow[best] or not follow.any():
        return best
    other = int(np.argmax(np.where(follow, worth, -np.inf)))
    most = worth[best] if formula[best] else ALMOST_ALL * worth[best] + AS_WELL
    return other if worth[other] > min(most, worth[best]) - AS_WELL else best


def add_lags(beside: ProductsBeside, variance: float) -> ProductsBeside:
    """The same with candidates that follow signals at their likeliest lags."""
    if not all(isinstance(s.more, Courses) for s in beside.rows.states):
        return beside
    if not any(signal_of(t) for group in beside.candidates.values() for t in group):
        return beside
    groups = {
        name: [*group, *_refined(beside, group, variance)]
        for name, group in beside.candidates.items()
    }
    return replace(beside, candidates=groups)


def _score(tried: ShapeProducts, variance: float) -> float:
    return max((tried.odds(take, variance) for take in tried.takes), default=-np.inf)


def _refined(
    beside: ProductsBeside, group: Sequence[ShapeProducts], variance: float
) -> list[ShapeProducts]:
    """The likeliest of each way to follow a signal, with its likeliest lag."""
    least = LEAST_SHARE * max((_score(t, variance) for t in group), default=0.0)
    best: dict[object, tuple[float, ShapeProducts]] = {}
    for tried in group:
        effect = tried.effect
        if not signal_of(tried) or not isinstance(effect, FreeForm):
            continue
        score = _score(tried, variance)
        if score > max(least, 0.0, best.get(effect.form.acts, (0.0, tried))[0]):
            best[effect.form.acts] = score, tried
    return [
        _with_lag(beside, tried, variance, order) for _, tried in best.values() for order in (1, 2)
    ]


def _with_lag(
    beside: ProductsBeside, tried: ShapeProducts, variance: float, order: int
) -> ShapeProducts:
    """A function of a signal at its likeliest lag near that of a candidate."""
    effect, rows = tried.effect, beside.rows
    assert isinstance(effect, FreeForm) and effect.form.acts is not None
    topic, acts = signal_of(tried).partition('@')[0], effect.form.acts
    lag = lag_of(signal_of(tried)) or LAGS[0] / WITHIN

    def at(logarithm: float) -> ShapeProducts:
        free = follower(acts, f'{topic}@{np.exp(logarithm):.4g}', order)
        form = FreeForm.bound(effect.parent, free, rows.states)
        return beside.less(tried_shapes(rows, form, ({},))[0])

    from scipy.optimize import minimize_scalar  # 0.1 s

    best = minimize_scalar(
        lambda logarithm: -_score(at(logarithm), variance),
        bounds=(np.log(max(lag / WITHIN, SHORTEST)), np.log(lag * WITHIN)),
        method='bounded',
        options={'xatol': CLOSE},
    )
    return at(float(best.x))
