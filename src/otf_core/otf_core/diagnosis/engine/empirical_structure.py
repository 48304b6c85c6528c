# SPDX-License-Identifier: Apache-2.0
"""Structure of a gap that no effect explains, and the rival that it is to the causes.

Structure of a gap that no effect explains: which inputs it depends on, and how it acts.

Smooth functions of every input, and of every two, are compared; a cycle in time or along an axis,
a moment, a place or a direction of the beam is an input where there is a clear one
(``input_search``). A score test screens them. The best are fitted exactly, and their
parameters are penalised as those of effects are; then the way to act, the same for all until then,
is chosen in the same way. Looking at many costs the logarithm of their number. What a structure
leaves may depend on another input besides.

Something else: what speaks against the named causes is not only the rest of the catalogue.

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

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, groupby

import numpy as np
from scipy import linalg

from otf_core.arrays import Array
from otf_core.aside import share_out
from otf_core.diagnosis.engine.effect_products import Pool, ShapeProducts, tried_shapes
from otf_core.diagnosis.engine.evidence import log_evidence
from otf_core.diagnosis.engine.input_search import Scores, find_inputs
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import (
    NEEDED_EVIDENCE,
    Cause,
    noise_variance,
    trace_of,
)
from otf_core.effects import EVERY
from otf_core.effects.action import ACTING, RIGID_TABLE, RIGID_TRACKER, Acting, Along, vector
from otf_core.effects.cause_names import name_of
from otf_core.effects.free import Free
from otf_core.effects.free_form import Empirical, FreeForm
from otf_core.effects.inputs import (
    CYCLE,
    MOMENT,
    SIGNAL,
    Span,
    cycle_period,
    found_input,
    functions_of,
    head_of,
    input_values,
    plain_names,
    scaled_input,
    span_of,
    stands_for,
)

INPUTS = (
    'time', 'x', 'y', 'z', 'sense_x', 'sense_y', 'sense_z', 'feed', 'acceleration', 'since_stop',
    'since_reversal_x', 'since_reversal_y', 'since_reversal_z', 'lap', 'range', 'azimuth',
    'elevation',
)  # fmt: skip
ALONE, IN_PAIR = 6, 3
"""Highest order of a function of one input, and of each of two."""
LONG = 60
"""Order of a function of time alone that is tried as well: what switches every few legs."""
ORDERS = {'time': 20, 'feed': 2, 'acceleration': 6}
"""Highest orders of functions of one input, where they differ."""
SCREENED = 14
"""Pairs of inputs that are fitted exactly; single inputs all are."""
AS_RIVALS = 5
"""The same where named causes explain the gap."""
ENOUGH = 0.95
"""Share of the evidence for two inputs that one of them must reach to be enough."""
ONE_DIRECTION = 0.9
"""Share of the squared displacement along one direction from which that alone is tried."""
AXES_OF_INPUTS = ('x', 'y', 'z')
NEEDED = 12.0
"""Logarithm of the odds that a structure needs."""


_EMPIRICAL = Empirical()


@dataclass(frozen=True)
class Structure:
    """A structure that was found.

    Attributes
    ----------
    cause : Cause
        As a cause without a name.
    price : float
        Logarithm of the number of structures that it was chosen from.
    """

    cause: Cause
    price: float = 0.0

    def named(self, used: Collection[str]) -> Cause | None:
        """The same as an effect of the catalogue; None if none depends and acts so.

        Parameters
        ----------
        used : collection of str
            Names that it must not have.
        """
        form = self.effect.form
        assert form.acts is not None
        name, words = name_of(form.inputs, form.acts)
        if not name or name in used:
            return None
        own = replace(form, words=words, own_per_run=self.effect.own_per_run)
        effect = FreeForm(EVERY[name], own, self.effect.spans)
        return replace(self.cause, option=replace(self.cause.option, effect=effect))

    @property
    def effect(self) -> FreeForm:
        """The empirical effect."""
        effect = self.cause.option.effect
        assert isinstance(effect, FreeForm)
        return effect

    @property
    def inputs(self) -> tuple[str, ...]:
        """Plain inputs that it depends on."""
        return plain_names(self.effect.form.inputs)


@dataclass(frozen=True, eq=False)
class Structures:
    """Smooth functions of one and of two inputs, acting as vectors, that were fitted to runs.

    Attributes
    ----------
    looked : float
        Logarithm of the number of structures that were looked at.
    """

    rows: Rows
    ranked: tuple[ShapeProducts, ...]
    looked: float

    def tried(self, free: Free) -> ShapeProducts:
        """Fit one structure."""
        spans = {name: span_of(self.rows.states, name) for name in free.inputs}
        return tried_shapes(self.rows, FreeForm(_EMPIRICAL, free, spans), [{}])[0]

    def score(self, tried: ShapeProducts, variance: float) -> float:
        """Evidence of one of them, less the price of having looked at all."""
        return tried.odds(np.arange(len(tried.size)), variance) - self.looked


def try_structures(rows: Rows, pairs_tried: int = SCREENED) -> Structures:
    """Fit every structure of one input, and those of two that a score test prefers."""
    scores = Scores.of(rows)
    sought = find_inputs(rows, scores)
    inputs = [*_inputs(rows), *(name for name in sought if head_of(name) == CYCLE)]
    alone = [_form((name,)) for name in dict.fromkeys([*inputs, *sought])]
    alone.append(Free(('time',), (LONG,), acts=vector))
    pairs = [_form(names) for names in combinations(inputs, 2)]
    spans = {name: span_of(rows.states, name) for name in inputs}
    best = np.argsort(_screened(rows, scores, pairs, spans))[::-1][:pairs_tried]
    structures = Structures(rows, (), float(np.log(len(alone) + len(pairs))))
    forms = (*alone, *(pairs[k] for k in best))
    return replace(
        structures, ranked=tuple(share_out(structures.tried, forms, (rows, _EMPIRICAL)))
    )


def find_structure(tried: Structures) -> Structure | None:
    """Find what a gap depends on, and how it acts; None if no structure has the odds."""
    rows, ranked = tried.rows, tried.ranked
    variance = noise_variance(rows, _fit_residual(_likeliest(ranked, 1.0), rows))
    first = _simplest(ranked, variance)
    # what turns all that the tracker sees looks as a vector as if it depended on places as well
    inner = [t for t in ranked if set(plain_inputs(t)) <= set(plain_inputs(first))]
    kinds = {inputs_of(t): t for t in sorted(inner, key=lambda t: tried.score(t, variance))}
    ways = [tried.tried(form) for t in kinds.values() for form in _ways(t, variance)]
    best = _likeliest([first, *ways], variance)
    alike = [tried.tried(form) for form in _along_axes(best)]
    enough = ENOUGH * _odds(best, variance)
    simpler = [t for t in alike if _odds(t, variance) > enough]
    return _clear(tried, _likeliest(simpler or [best], variance), variance)


def find_another(tried: Structures, known: Sequence[Structure]) -> Structure | None:
    """Find another input that what structures leave depends on; None if none has the odds."""
    rows, options = tried.rows, [s.cause.option for s in known]
    used = {n for s in known for n in s.inputs}
    single = [t for t in tried.ranked if len(inputs_of(t)) == 1]
    pool = Pool.of(rows, {'': [t for t in single if not used & set(plain_inputs(t))]})
    for option in options:
        pool = pool.joined(option)
    beside = pool.beside(options)
    remaining = beside.candidates['']
    best = _likeliest(remaining, 1.0)
    trace = beside.trace(best, np.arange(len(best.size)), 1.0)
    variance = noise_variance(rows, beside.residual - trace)
    return _clear(tried, _likeliest(remaining, variance), variance)


def _clear(tried: Structures, candidate: ShapeProducts, variance: float) -> Structure | None:
    """A structure, if it has the odds."""
    score = tried.score(candidate, variance)
    if score < NEEDED:
        return None
    option = candidate.made(np.arange(len(candidate.size)), variance)
    return Structure(Cause(option, score, 1.0, ()), tried.looked)


def _inputs(rows: Rows) -> list[str]:
    """Inputs that change in the runs."""
    signals = dict.fromkeys(n for s in rows.states for n in s.more if n.startswith(SIGNAL))
    names = []
    missing = set(AXES_OF_INPUTS) - {a.lower() for a in rows.states[0].machine.axis_names}
    own = [name for name in INPUTS if name.rpartition('_')[2] not in missing]
    for name in (*own, *_of_rotary_axes(rows), *signals):
        known = [s for s in rows.states if name not in signals or name in s.more]
        if len(known) < len(rows.states):
            continue
        values = np.concatenate([input_values(s, name) for s in known])
        if np.ptp(values) > 0.0:
            names.append(name)
    return names


def _of_rotary_axes(rows: Rows) -> list[str]:
    """Inputs of the rotary axes of the machine."""
    axes = [a.lower() for a in rows.states[0].machine.rotary_names]
    return [head + a for a in axes for head in ('', 'sense_', 'since_reversal_')]


def _form(names: tuple[str, ...], acts: Acting = vector) -> Free:
    most = ALONE if len(names) == 1 else IN_PAIR
    orders = (_order(n, most) if len(names) == 1 else min(_order(n, most), most) for n in names)
    # cosine and sine of a cycle belong together
    whole = (o - o % 2 if cycle_period(n) else o for n, o in zip(names, orders, strict=True))
    own = True if head_of(names[0]) == MOMENT else None  # a jolt belongs to its run
    return Free(names, tuple(whole), acts=acts, own_per_run=own)


def _order(name: str, most: int) -> int:
    """Highest order of a function of an input."""
    found = found_input(name)
    usual = 2 if name.startswith('sense_') else most
    return (found.order or most) if found else ORDERS.get(name, usual)


def _screened(rows: Rows, scores: Scores, forms: Sequence[Free], spans: dict[str, Span]) -> Array:
    """About what each structure would gain as a vector, shape (f,)."""
    tables = {
        name: functions_of(
            name,
            np.concatenate([scaled_input(name, input_values(s, name), spans[name])
                            for s in rows.states]),
            _order(name, ALONE),
        )
        for name in spans
    }  # fmt: skip
    gains = [
        gain
        for _, own in groupby(forms, lambda form: (form.inputs[0], form.orders[0]))
        for gain in _gains(list(own), tables, scores)
    ]
    return np.array(gains)


def _gains(forms: Sequence[Free], tables: dict[str, Array], scores: Scores) -> list[float]:
    """Half the fall of the sum of squares by structures, less a price of their coefficients.

    All have the first of their two inputs in common.
    """
    columns = [
        [tables[n][:, : order + 1] for n, order in zip(form.inputs, form.orders, strict=True)]
        for form in forms
    ]
    gains = scores.gains_of_products(columns[0][0], [second for _, second in columns])
    counts = [3 * (len(form.numbers) - 1) for form in forms]
    pieces = len(columns[0][0])
    prices = [0.5 * count * np.log(max(pieces / count, 2.0)) for count in counts]
    return [gain - float(price) for gain, price in zip(gains, prices, strict=True)]


def _likeliest(ranked: Sequence[ShapeProducts], variance: float) -> ShapeProducts:
    return max(ranked, key=lambda t: t.odds(np.arange(len(t.size)), variance))


def _simplest(ranked: Sequence[ShapeProducts], variance: float) -> ShapeProducts:
    """The likeliest, or one of its inputs alone where that is about as good."""
    best = _likeliest(ranked, variance)
    score = best.odds(np.arange(len(best.size)), variance)
    names = set(plain_inputs(best))
    inner = [t for t in ranked if set(plain_inputs(t)) < names]
    enough = [t for t in inner if t.odds(np.arange(len(t.size)), variance) > ENOUGH * score]
    return _likeliest(enough, variance) if enough else best


def inputs_of(tried: ShapeProducts) -> tuple[str, ...]:
    """Inputs of a structure."""
    effect = tried.effect
    assert isinstance(effect, FreeForm)
    return effect.form.inputs


def plain_inputs(tried: ShapeProducts) -> tuple[str, ...]:
    """The same, a place or a moment as the inputs that it says more of."""
    return plain_names(inputs_of(tried))


def _fit_residual(tried: ShapeProducts, rows: Rows) -> Array:
    """Residual less the best fit."""
    return rows.residual - tried.trace(np.arange(len(tried.size)), 1.0)


def _ways(first: ShapeProducts, variance: float) -> list[Free]:
    """The same inputs acting in other ways."""
    assert isinstance(first.effect, FreeForm)
    ways: list[Acting] = [ACTING[RIGID_TRACKER], ACTING[RIGID_TABLE]]
    main, share = _main_direction(first, variance)
    if share > ONE_DIRECTION and not first.effect.own_per_run:
        ways.append(Along((float(main[0]), float(main[1]), float(main[2]))))
    return [replace(first.effect.form, acts=way) for way in ways]


def _along_axes(best: ShapeProducts) -> list[Free]:
    """The same inputs shifting the target along an axis that they belong to."""
    form = best.effect.form if isinstance(best.effect, FreeForm) else None
    if form is None or isinstance(form.acts, Along) or best.effect.own_per_run:
        return []
    own = {name[-1] for name in form.inputs if name.rpartition('_')[2] in AXES_OF_INPUTS}
    units = {'x': (1.0, 0.0, 0.0), 'y': (0.0, 1.0, 0.0), 'z': (0.0, 0.0, 1.0)}
    return [replace(form, acts=Along(units[axis])) for axis in sorted(own)]


def _odds(tried: ShapeProducts, variance: float) -> float:
    """Evidence of a structure with all its terms."""
    return tried.odds(np.arange(len(tried.size)), variance)


def _main_direction(tried: ShapeProducts, variance: float) -> tuple[Array, float]:
    """Main direction of a fitted vector, and its share of the squared displacement."""
    value = tried.estimate(np.arange(len(tried.size)), variance).value
    per = (value * tried.size).reshape(3, -1)
    per = per[:, 1:] if per.shape[1] > 1 else per
    directions, size, _ = np.linalg.svd(per, full_matrices=False)
    main = directions[:, 0] * (np.sign(directions[np.argmax(np.abs(directions[:, 0])), 0]) or 1.0)
    return main, float(size[0] ** 2 / max(float(np.sum(size**2)), 1e-300))


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
    trace = trace_of(causes, rows)
    variance = noise_variance(rows, rows.residual - trace)
    likeliest = sorted(structures.ranked, key=lambda t: -structures.score(t, variance))
    for tried in likeliest[:RIVALS]:
        other = tried.trace(np.arange(len(tried.size)), variance)
        least = min(variance, noise_variance(rows, rows.residual - other))
        odds = structures.score(tried, least) - together(causes, rows, least)
        rival = Rival(odds, inputs_of(tried))
        if not _same(trace, other) or (rival.wins and _says_more(rival.inputs, causes)):
            return rival
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
        added = linalg.orth(white, NEXT_TO_NOTHING)
        basis = np.concatenate([basis, added], axis=1)
        residual = residual - added @ (added.T @ residual)
    return total


def _says_more(inputs: Sequence[str], causes: Sequence[Cause]) -> bool:
    """Whether a function of time and more stands against shifts by free functions of time."""
    effects = [c.option.effect for c in causes]
    alike = all(isinstance(e, FreeForm) and e.form.acts is vector for e in effects)
    return alike and not all(stands_for(n) == ('time',) or n.startswith(SIGNAL) for n in inputs)


def _same(trace: Array, other: Array) -> bool:
    """Return whether two explanations take away the same."""
    rest = trace - other
    return float(rest @ rest) < THE_SAME * float(trace @ trace)
