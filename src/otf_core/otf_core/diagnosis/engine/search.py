# SPDX-License-Identifier: Apache-2.0
"""Search of the catalogue: one effect after the other, each on what the others leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.aside import share_out
from otf_core.diagnosis.engine.effect_products import (
    NO_TRACE,
    Candidates,
    Pool,
    ProductsBeside,
    ShapeProducts,
    less_basis,
    orthonormal,
    tried_shapes,
)
from otf_core.diagnosis.engine.evidence import (
    TOGETHER,
    Estimate,
    Option,
    average,
    estimate,
    estimate_of,
    joint_evidence,
    log_evidence,
    motions_of_takes,
    products_of,
)
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.signal_lag import (
    AS_WELL,
    add_lags,
    choose_candidate,
    in_proportion,
    signal_of,
)
from otf_core.diagnosis.engine.spectral import LINE_SCORE, SpectralLine, strongest_lines
from otf_core.diagnosis.engine.time_courses import (
    DECOY_NAMES,
    DECOYS,
    add_switching,
    courses_tried,
)
from otf_core.effects import EVERY, REGISTRY, BelongsTo, Effect, Shape
from otf_core.effects.free_form import FreeForm, free_forms
from otf_core.solving.residuals import check_residuals
from otf_core.solving.sensitivity import column_size

NEEDED_EVIDENCE = 9.0
"""Logarithm of the odds that an effect needs before it is named (8000 to 1)."""
CLOSE_EVIDENCE = 5.0
"""Effects within these odds (150 to 1) of the best are indistinguishable from it, and so are
those that have more than a tenth of its weight (``_weights``)."""
CLOSE_SHARE = 0.01
"""Share of the evidence for the best effect that counts as one nat: neighbouring pieces share
what no model has, so large evidence is known in proportion only."""
SAME_TRACE = 0.03
"""An effect that can leave all but this share of the squared trace of another is not told
from it."""
LIKELIEST_MOTIONS = 6
"""Motions whose combinations are looked at where there are many alike."""
LEAST_WEIGHT = 0.1
"""Weight beside the first from which another effect is named as indistinguishable from it."""
MOST_ALIKE = 4
"""Effects that are named as indistinguishable from a cause at most."""
MAX_CAUSES = 4
MAX_CHANGES = 3
"""Causes that are left out or exchanged at most."""
LEAST_POWER = 0.005
"""Share of the squared trace of all causes from which one is asked again beside the others."""
CLEARLY_BETTER = 2.0
"""Logarithm of the odds by which another effect must be better to take the place of a cause."""
DECOY_DOUBT = 10.0
"""Evidence by which a shape outside the catalogue must be better than any effect in it."""
FREE_DOUBT = 10.0
"""Evidence by which a free form must be better than a formula, of the same effect or of another,
which is named else. Rigid motions by a function of one input are compared with other effects on
equal terms: they have no more functions than couplings and general drifts by their formulas."""


@dataclass(frozen=True)
class Cause:
    """An effect that was found.

    Attributes
    ----------
    confidence : float
        Probability among the candidates and 'none'.
    time_as_well : bool
        True if it follows a signal, and functions of time explain the data as well.
    """

    option: Option
    score: float
    confidence: float
    indistinguishable: tuple[str, ...]
    time_as_well: bool = False


def noise_variance(rows: Rows, residual: Array) -> float:
    """Variance of the noise left in residuals, correlation between pieces included."""
    parts = zip(rows.observed, rows.by_run(residual), strict=True)
    return float(np.mean([check_residuals(p, r.pieces.leg, 0).inflation for r, p in parts]))


def remove_option(option: Option, residual: Array) -> Array:
    """Residual less the best fit of one option."""
    fit = estimate(option.white, option.size, residual, option.widths)
    return residual - option.white @ fit.value


RankedOption = tuple[float, ShapeProducts, Index]
"""Score of an effect, and its best option: the shape and its terms."""
Ranking = list[RankedOption]


def _pairs(
    group: Sequence[ShapeProducts], variance: float
) -> tuple[list[tuple[ShapeProducts, Index]], Array]:
    """Options of an effect, shapes with their terms, and their scores.

    Of many that are alike, combinations of the likeliest motions alone are looked at; the others
    count as options that explain nothing.
    """
    pairs = [(tried, take) for tried in group for take in tried.takes]
    scores = [score for tried in group for score in _scores(tried, variance, tried.takes)]
    return pairs, np.array(scores)


def _scores(tried: ShapeProducts, variance: float, takes: Sequence[Index]) -> list[float]:
    if not tried.effect.many_alike:
        return [tried.odds(take, variance) for take in takes]
    motions = motions_of_takes(tried.terms.names, takes)
    single = [m for m in motions if len(m) == 1]
    first = {
        m: tried.odds(take, variance)
        for m, take in zip(motions, takes, strict=True)
        if len(m) == 1
    }
    best = set().union(*sorted(single, key=lambda m: -first[m])[:LIKELIEST_MOTIONS])
    return [
        tried.odds(take, variance) if len(m) == 1 or len(m) > TOGETHER or m <= best else -np.inf
        for m, take in zip(motions, takes, strict=True)
    ]


def _ranking(candidates: Candidates, variance: float) -> Ranking:
    """Score and best option of every effect; first the best of those with the odds to be named."""
    ranking: Ranking = []
    for group in candidates.values():
        pairs, scores = _pairs(group, variance)
        if not pairs:
            continue
        doubt = DECOY_DOUBT if group[0].effect.name in DECOY_NAMES else 0.0
        free = np.array([is_free(tried) for tried, _ in pairs])
        worth = scores - FREE_DOUBT * free
        best = choose_candidate([t for t, _ in pairs], worth, formula=~free)
        kinds = [average(scores[free == kind]) for kind in np.unique(free)]
        ranking.append((average(kinds) - doubt, *pairs[best]))
    ranking.sort(key=lambda e: (e[0] >= NEEDED_EVIDENCE, _worth(e)), reverse=True)
    return _simpler_first(ranking)


def _simpler_first(ranking: Ranking) -> Ranking:
    """Put a rigid motion by one input before a coupling of inputs that explains little more."""
    if not ranking or not ranking[0][1].effect.couples:
        return ranking
    weights = _weights(ranking)
    for k, (entry, weight) in enumerate(zip(ranking, weights, strict=True)):
        if weight > LEAST_WEIGHT and entry[1].effect.rigid and entry[0] >= NEEDED_EVIDENCE:
            return [entry, *ranking[:k], *ranking[k + 1 :]]
    return ranking


def _worth(entry: RankedOption) -> float:
    """Score of an entry of a ranking, less the doubt in a free form."""
    return entry[0] - FREE_DOUBT * is_doubtful(entry[1])


def is_doubtful(tried: ShapeProducts) -> bool:
    """Return whether this is a free form that is more than a rigid motion by one input."""
    effect = tried.effect
    return is_free(tried) and not (isinstance(effect, FreeForm) and effect.form.rigid)


def is_free(tried: ShapeProducts) -> bool:
    """Return whether this is the free form of an effect; decoys, which have no name, have none."""
    free = bool(tried.terms.orders) and not in_proportion(tried)
    return free and tried.effect.name not in DECOY_NAMES


def _refined(option: Option, basis: Array, rows: Rows, residual: Array) -> Option:
    """Improve the shape of an option: its spectral line or length is only known to a raster."""
    name = option.effect.refine
    if not name:
        return option
    start = float(option.shape[name])

    def at(place: float) -> Option:
        shape = {**option.shape, name: place}
        plain = rows.plain_columns(option.effect, shape)[:, option.take]
        own = rows.project(rows.whiten(plain))
        return _free_of(
            basis, replace(option, shape=shape, plain=plain, own=own, size=column_size(plain))
        )

    def loss(logarithm: float) -> float:
        trial = at(start * float(np.exp(logarithm)))
        return -estimate(trial.white, trial.size, residual, trial.widths).gain

    from scipy.optimize import minimize_scalar  # 0.1 s

    width = option.effect.refine_width
    best = minimize_scalar(
        loss, bounds=(-width, width), method='bounded', options={'xatol': width / 5000}
    )
    refined = at(start * float(np.exp(best.x)))
    better = estimate(refined.white, refined.size, residual, refined.widths).gain
    now = estimate(option.white, option.size, residual, option.widths).gain
    return refined if better > now else option


def search(rows: Rows, tried: Candidates) -> tuple[list[Cause], list[tuple[str, float]]]:
    """Find effects one after the other, and ask each again beside those found after it.

    What is named early may only have stood for what is found later, as a drift does for the axis
    that expands. So each cause is taken away in turn: it goes where the others explain the data as
    well, and gives way where another effect does better beside them. Where another effect is about
    as likely as the first, the search is repeated from that one; the likelier result stays.

    Returns
    -------
    causes : list of Cause
        In the order found.
    considered : list of (name, score)
        The ranking of the last round.
    """
    pool = Pool.of(rows, tried)
    causes, considered, joined = _settled(pool, [])
    readings = [_Reading(tuple(causes), considered)]
    other = _other_start(pool, causes)
    if other is not None:
        others, ranked, _ = _settled(pool.joined(other.option), [other])
        if _is_likelier(others, causes, rows):
            readings.insert(0, _Reading(tuple(others), ranked or considered))
    readings += _of_rigid_motion(joined, readings[0])
    return _weigh_readings(readings, rows)


@dataclass(frozen=True)
class _Reading:
    """Causes that together explain rows."""

    causes: tuple[Cause, ...]
    considered: list[tuple[str, float]]

    @property
    def names(self) -> set[str]:
        """Names of the causes."""
        return {c.option.effect.name for c in self.causes}


def _of_rigid_motion(pool: Pool, reading: _Reading) -> list[_Reading]:
    """The other reading where a coupling may imitate a rigid motion beside it, or be imitated.

    A table that tilts beside a coupling along one direction leaves what a coupling along several
    follows as well. Either is sought beside the other causes.
    """
    causes = reading.causes
    couplings = [c for c in causes if c.option.effect.couples]
    rigid = [c for c in causes if c.option.effect.rigid]
    if not couplings or (not rigid and len(couplings[0].option.axes) < 2):
        return []
    others = [c for c in causes if c not in (*couplings, *rigid)]
    beside = _candidates_beside(pool, others, 1.0)
    rest = pool.beside([c.option for c in causes]).residual
    variance = noise_variance(pool.rows, rest)
    ranking = _ranking(beside.candidates, variance)

    def first(entry: RankedOption) -> Cause:
        return _cause([entry, *(e for e in ranking if e is not entry)], beside, variance)

    if rigid:
        entry = next((e for e in ranking if e[1].effect.couples), None)
        return [] if entry is None else [_Reading((*others, first(entry)), reading.considered)]
    entry = next((e for e in ranking if e[1].effect.rigid and e[0] >= NEEDED_EVIDENCE), None)
    if entry is None:
        return []
    start = first(entry)
    named, ranked, _ = _settled(pool.joined(start.option), [*others, start])
    return [_Reading(tuple(named), ranked or reading.considered)]


def _weigh_readings(
    readings: Sequence[_Reading], rows: Rows
) -> tuple[list[Cause], list[tuple[str, float]]]:
    """The reading to state, its causes no surer than all readings that hold them are together.

    A reading with a rigid motion is stated before one without where it explains little less.
    """
    evidence = _joint([r.causes for r in readings], rows)
    scale = max(1.0, CLOSE_SHARE * evidence.max())
    weights = np.exp((evidence - evidence.max()) / scale)
    rigid = [any(c.option.effect.rigid for c in r.causes) for r in readings]
    likely = weights > LEAST_WEIGHT
    if any(rigid) and not rigid[0] and likely[rigid].any():
        stated = int(np.argmax(np.where(rigid, weights, 0.0)))
    else:
        stated = 0
    reading = readings[stated]
    stays = {_part(c) for c in reading.causes}
    causes = []
    for cause in reading.causes:
        name = cause.option.effect.name
        held = [name in r.names for r in readings]
        without = [r for r, weight, own in zip(readings, weights, held, strict=True)
                   if not own and weight > LEAST_WEIGHT * weights[stated]]  # fmt: skip
        instead = {
            c.option.effect.name for r in without for c in r.causes if _part(c) not in stays
        }
        close = dict.fromkeys([*cause.indistinguishable, *sorted(instead - DECOY_NAMES)])
        share = float(weights[held].sum() / weights.sum())
        causes.append(
            replace(
                cause,
                confidence=min(cause.confidence, share),
                indistinguishable=tuple(close)[:MOST_ALIKE],
            )
        )
    return causes, reading.considered


def _part(cause: Cause) -> tuple[str, tuple[str, ...]]:
    """Name and axes of a cause: with others, it may be the same or stand for more."""
    return cause.option.effect.name, cause.option.axes


def _joint(readings: Sequence[Sequence[Cause]], rows: Rows) -> Array:
    """Evidence of sets of causes for the same noise, that which the best of them leaves."""
    options = [[c.option for c in causes] for causes in readings]
    residuals = [rows.residual - trace_of(causes, rows) for causes in readings if causes]
    variance = min((noise_variance(rows, part) for part in residuals), default=1.0)
    return np.array([joint_evidence(part, rows.residual, variance) for part in options])


def _settled(
    pool: Pool, causes: Sequence[Cause]
) -> tuple[list[Cause], list[tuple[str, float]], Pool]:
    """Find effects beside causes, and ask each again until all stay."""
    named, considered, pool = _search_in_turn(pool, causes)
    for _ in range(MAX_CHANGES):
        changed, given = _changed(pool, named)
        if changed is None:
            named = given
            break
        for cause in changed:
            if all(cause is not known for known in named):
                pool = pool.joined(cause.option)
        named, ranked, pool = _search_in_turn(pool, changed)
        named, considered = _in_order(named), ranked or considered
    return named, considered, pool


def _other_start(pool: Pool, causes: Sequence[Cause]) -> Cause | None:
    """An effect that is about as likely as the first cause and is not found; None if none is."""
    if not causes or not causes[0].indistinguishable:
        return None
    known = {*DECOY_NAMES, *(c.option.effect.name for c in causes)}
    beside = _candidates_beside(pool, [], 1.0)
    variance = noise_variance(pool.rows, remove_option(causes[0].option, pool.rows.residual))
    ranking = _ranking(beside.candidates, variance)
    pairs = zip(ranking, _weights(ranking), strict=True)
    close = [e for e, weight in pairs if weight > LEAST_WEIGHT and e[0] >= NEEDED_EVIDENCE]
    for entry in close:
        if entry[1].effect.name not in known:
            rest = [e for e in ranking if e is not entry]
            return _cause([entry, *rest], beside, variance)
    return None


def _is_likelier(one: Sequence[Cause], other: Sequence[Cause], rows: Rows) -> bool:
    """Return whether causes explain rows clearly better than others, for the same noise."""
    first, second = _joint([one, other], rows)
    return bool(first - second > max(CLEARLY_BETTER, CLOSE_SHARE * second))


def search_beside(rows: Rows, tried: Candidates, known: Sequence[Cause]) -> list[Cause]:
    """Find effects beside causes that are known already; these come first."""
    pool = Pool.of(rows, tried)
    for cause in known:
        pool = pool.joined(cause.option)
    return _search_in_turn(pool, known)[0]


def _in_order(causes: Sequence[Cause]) -> list[Cause]:
    """Columns of every cause less what those before it can follow, and nothing else."""
    placed: list[Cause] = []
    basis = np.zeros((len(causes[0].option.own), 0)) if causes else np.zeros((0, 0))
    for cause in causes:
        option = _free_of(basis, cause.option)
        placed.append(replace(cause, option=option))
        basis = np.concatenate([basis, orthonormal(option.white, option.own)], axis=1)
    return placed


def _search_in_turn(
    pool: Pool, causes: Sequence[Cause]
) -> tuple[list[Cause], list[tuple[str, float]], Pool]:
    """Find effects beside causes, one after the other."""
    causes, considered = list(causes), []
    while len(causes) < MAX_CAUSES:
        beside = _candidates_beside(pool, causes, 1.0)
        first = _ranking(beside.candidates, 1.0)
        if not first:
            break
        # noise is judged on what the best candidate leaves: its own trace must not count as noise
        best = beside.trace(*first[0][1:], 1.0)
        variance = noise_variance(pool.rows, beside.residual - best)
        ranking = _ranking(beside.candidates, variance)
        considered = [(t.effect.name, s) for s, t, _ in ranking]
        if ranking[0][0] < NEEDED_EVIDENCE:
            break
        causes.append(_cause(ranking, beside, variance))
        pool = pool.joined(causes[-1].option)
    return causes, considered, pool


def _candidates_beside(pool: Pool, causes: Sequence[Cause], variance: float) -> ProductsBeside:
    """Candidates beside causes, those with lags and moments at their likeliest ones."""
    beside = pool.beside([c.option for c in causes])
    return add_switching(add_lags(beside, variance), variance)


def _changed(pool: Pool, causes: Sequence[Cause]) -> tuple[list[Cause] | None, list[Cause]]:
    """The causes with the one that is worst placed left out or exchanged; None if all stay.

    Causes that are next to nothing beside the others are not named, whatever they are: they stay.

    Returns
    -------
    changed : list of Cause, optional
    given : list of Cause
        As they are, each as sure as it is given the others.
    """
    if len(causes) < 2:
        return None, list(causes)
    traces = [pool.rows.residual - remove_option(c.option, pool.rows.residual) for c in causes]
    power = np.array([float(trace @ trace) for trace in traces])
    questioned = power >= LEAST_POWER * power.sum()
    rest = pool.beside([c.option for c in causes]).residual
    variance = noise_variance(pool.rows, rest)
    worst, better, given = 0.0, None, list(causes)
    for k in np.flatnonzero(questioned).tolist():
        cause = causes[k]
        others = [c for c in causes if c is not cause]
        beside = _candidates_beside(pool, others, variance)
        ranking = _ranking(beside.candidates, variance)
        (own,) = [e for e in ranking if e[1].effect.name == cause.option.effect.name]
        given[k] = _given_others(cause, own, ranking, others)
        if own[0] < NEEDED_EVIDENCE and own[0] - NEEDED_EVIDENCE < worst:
            worst, better = own[0] - NEEDED_EVIDENCE, others
        elif (lost := _worth(own) - _worth(ranking[0])) < min(worst, -CLEARLY_BETTER):
            worst, better = lost, [*others, _cause(ranking, beside, variance)]
    return better, given


def _given_others(
    cause: Cause, own: RankedOption, ranking: Ranking, others: Sequence[Cause]
) -> Cause:
    """A cause with what it is indistinguishable from, and its confidence, beside the others."""
    first = [own, *(e for e in ranking if e is not own)]
    weights = _weights(first)
    known = {c.option.effect.name for c in others}
    close = [
        e[1].effect.name for e, weight in zip(first[1:], weights[1:], strict=True)
        if weight > LEAST_WEIGHT or e[0] > own[0] - CLOSE_EVIDENCE
    ]  # fmt: skip
    close += [n for n in cause.indistinguishable if n not in known]
    alike = [n for n in dict.fromkeys(close) if n not in DECOY_NAMES]
    return replace(
        cause,
        confidence=_share_of_first(first, weights),
        indistinguishable=tuple(alike)[:MOST_ALIKE],
    )


def _share_of_first(ranking: Ranking, weights: Array) -> float:
    """Probability of the first of a ranking among all effects and none.

    What is put first for its fewer functions is as likely as what it is put before.
    """
    return 1.0 / float(np.minimum(weights, 1.0).sum() + np.exp(-_worth(ranking[0])))


def _cause(ranking: Ranking, beside: ProductsBeside, variance: float) -> Cause:
    """The first of a ranking as a cause, with what is indistinguishable from it."""
    rows, candidates = beside.rows, beside.candidates
    basis, residual = beside.basis, beside.residual
    score, tried, take = ranking[0]
    option = _refined(_free_of(basis, tried.made(take, variance)), basis, rows, residual)
    group = [t for t in candidates[tried.effect.name] if not is_free(t) and t.effect.refine]
    if is_free(tried) and group:  # it may only make up for the raster of the formula
        pairs, scores = _pairs(group, variance)
        near, own = pairs[int(np.argmax(scores))]
        plain = _refined(_free_of(basis, near.made(own, variance)), basis, rows, residual)
        gained = _score(option, residual, variance) - _score(plain, residual, variance)
        option = option if gained > FREE_DOUBT else plain

    weights = _weights(ranking)
    trace = residual - remove_option(option, residual)
    power, pulled = float(trace @ trace), rows.pulled(trace[:, None])

    def same(other: ShapeProducts, take: Index) -> bool:
        rest = power - other.gain(take, pulled)
        return rest < max(SAME_TRACE * power, 4.0)

    close = [
        t.effect.name
        for (s, t, own), weight in zip(ranking[1:], weights[1:], strict=True)
        if t.effect.name not in DECOY_NAMES
        and (
            s > score - CLOSE_EVIDENCE
            or weight > LEAST_WEIGHT
            or (s > NEEDED_EVIDENCE and not is_doubtful(t) and same(t, own))
        )
    ]
    confidence = _share_of_first(ranking, weights)
    as_well = _time_as_well(candidates[tried.effect.name], tried, take, variance)
    return Cause(option, score, confidence, tuple(close[:MOST_ALIKE]), as_well)


def _weights(ranking: Ranking) -> Array:
    """Weight of every effect of a ranking beside the first, shape (k,)."""
    worth = np.array([_worth(entry) for entry in ranking])
    return np.asarray(np.exp((worth - worth[0]) / max(1.0, CLOSE_SHARE * worth[0])))


def _time_as_well(
    group: Sequence[ShapeProducts], chosen: ShapeProducts, take: Index, variance: float
) -> bool:
    """Return whether functions of time explain as well what follows a signal."""
    if not signal_of(chosen):
        return False
    _, scores = _pairs([t for t in group if not signal_of(t)], variance)
    return bool(scores.max(initial=-np.inf) > chosen.odds(take, variance) - AS_WELL)


def _score(option: Option, residual: Array, variance: float) -> float:
    """Evidence of an option with its columns as they are."""
    orders = np.array(option.terms.orders)
    products = option.white.T @ option.white, option.white.T @ residual
    own = orders[option.take] if len(orders) else orders
    return log_evidence(*products, option.size, variance, own)


def _free_of(basis: Array, option: Option) -> Option:
    """Leave out of an option what the causes found so far, spanned by ``basis``, can follow."""
    return replace(option, white=less_basis(basis, option.own))


def fit_jointly(causes: Sequence[Cause], rows: Rows) -> Estimate:
    """Estimate the coefficients of all causes together, jointly with tables and poses."""
    options = [c.option for c in causes]
    size, width = (
        np.concatenate(w) for w in ([o.size for o in options], [o.widths for o in options])
    )
    return estimate_of(*products_of(options, rows.residual), size, width)


def trace_of(causes: Sequence[Cause], rows: Rows) -> Array:
    """Whitened trace of causes fitted together beside tables and poses, shape (r,)."""
    return _times([c.option.own for c in causes], fit_jointly(causes, rows).value)


def displacement_of(causes: Sequence[Cause], value: Array) -> Array:
    """Displacement across the path by causes with coefficients (k, ...), shape (r, ...), m."""
    return _times([c.option.plain for c in causes], value)


def _times(columns: Sequence[Array], value: Array) -> Array:
    """Columns side by side times values (k, ...), without a copy of them."""
    ends = np.cumsum([part.shape[1] for part in columns])
    parts = zip(columns, np.split(value, ends[:-1]), strict=True)
    return np.asarray(sum(part @ own for part, own in parts))


def places_of(causes: Sequence[Cause]) -> list[slice]:
    """Where the coefficients of each cause lie in those of all, as ``fit_jointly`` has them."""
    ends = np.cumsum([0, *(c.option.take.size for c in causes)]).tolist()
    return [slice(low, high) for low, high in pairwise(ends)]


DETECTABLE = 25.0
"""Rise of the sum of squares at which an effect is found."""
INVISIBLE_SHARE = 0.1
"""Largest share of its amplitude that an effect leaves and still counts as not visible."""
PLAUSIBLE = 5e-6
"""m; an effect that would have to be larger to be found counts as not visible."""


@dataclass(frozen=True)
class Visibility:
    """How well the data see an effect.

    Attributes
    ----------
    share : float
        Amplitude left by tables and poses, median over the terms.
    smallest : float
        m; smallest root mean square displacement that would be found, median over the terms.
    """

    share: float
    smallest: float

    @property
    def visible(self) -> bool:
        """False if the effect leaves no trace that could be told."""
        return self.share > INVISIBLE_SHARE and self.smallest < PLAUSIBLE


def sight_of(tried: ShapeProducts) -> Visibility:
    """How well the data see one shape of an effect."""
    acts = tried.size > NO_TRACE
    if not acts.any():
        return Visibility(0.0, np.inf)
    whole, remaining = tried.whole[acts], tried.normal.diagonal()[acts]
    ratio = np.sqrt(remaining / np.maximum(whole, 1e-300))
    smallest = np.sqrt(DETECTABLE / np.maximum(remaining, 1e-300)) * tried.size[acts]
    return Visibility(float(np.median(ratio)), float(np.median(smallest)))


def shapes_from_lines(lines: Sequence[SpectralLine]) -> dict[str, list[Shape]]:
    """Frequencies and periods of spectral lines as shapes of the effects that make them."""
    shapes: dict[str, list[Shape]] = {}
    for line in lines:
        if line.score > LINE_SCORE:
            shape = REGISTRY[line.effect].complete_shape({line.wave.parameter: line.place})
            shapes.setdefault(line.effect, []).append(shape)
    return shapes


def spectral_lines(rows: Rows) -> list[SpectralLine]:
    """Spectral lines of all runs, strongest first."""
    lines: list[SpectralLine] = []
    for residuals in rows.sample_residuals():
        lines += strongest_lines(residuals, list(REGISTRY.values()))
    return sorted(lines, key=lambda line: -line.score)


def effects_without(names: Sequence[str]) -> list[Effect]:
    """Effects of the catalogue that displace, less the named ones."""
    remaining = [e for e in REGISTRY.values() if e.name not in names]
    return [e for e in remaining if e.belongs_to is not BelongsTo.NOISE]


@dataclass(frozen=True)
class SearchResult:
    """What a search of the catalogue found.

    Attributes
    ----------
    causes : tuple of Cause
        In the order found, decoys among them.
    considered : tuple of (effect, log odds)
        The ranking of the last round.
    visible : mapping of effect to Visibility
    """

    causes: tuple[Cause, ...]
    considered: tuple[tuple[str, float], ...]
    visible: dict[str, Visibility]


def search_catalogue(
    rows: Rows,
    exclude: Sequence[str],
    own: Sequence[Effect] = (),
    lines: Sequence[SpectralLine] | None = None,
) -> SearchResult:
    """Search rows for effects of the catalogue less the excluded ones, for ``own``, and decoys.

    ``lines`` are spectral lines of the runs; those of the rows where they are not given.
    """
    shapes = shapes_from_lines(spectral_lines(rows) if lines is None else lines)
    tried, visible = tried_effects(rows, [*effects_without(exclude), *own, *DECOYS], shapes)
    switching = courses_tried(rows, [*effects_without(exclude), *DECOYS])
    causes, considered = search(rows, {**tried, **switching})
    sight = {name: v for name, v in visible.items() if name in EVERY}
    return SearchResult(tuple(causes), tuple(considered), sight)


def tried_effects(
    rows: Rows, effects: Sequence[Effect], shapes: Mapping[str, Sequence[Shape]]
) -> tuple[dict[str, list[ShapeProducts]], dict[str, Visibility]]:
    """Reduce the columns of all effects to their products, effect by effect.

    Parameters
    ----------
    shapes : mapping of effect name to shapes
        Where not given, those of the effect itself.

    Returns
    -------
    tried : mapping of effect name to list of ShapeProducts
    visible : mapping of effect name to Visibility
    """

    def one(effect: Effect) -> tuple[list[ShapeProducts], Visibility]:
        chosen, stand_in = shapes_of(rows, effect, shapes)
        all_tried = tried_shapes(rows, effect, chosen or stand_in)
        tried = all_tried if chosen else []
        for form in free_forms(effect, rows.states):
            own = (chosen or ()) if form.form.shaped else ({},)
            tried += tried_shapes(rows, form, own)
        return tried, best_sight([sight_of(t) for t in all_tried])

    rows.prepare()
    results = share_out(one, effects, (rows, *effects))
    all_tried = dict(zip((e.name for e in effects), results, strict=True))
    return {n: tried for n, (tried, _) in all_tried.items()}, {
        n: s for n, (_, s) in all_tried.items()
    }


def best_sight(seen: Sequence[Visibility]) -> Visibility:
    """How well the data see an effect in the shape that they see best."""
    return Visibility(
        max((v.share for v in seen), default=0.0),
        min((v.smallest for v in seen), default=np.inf),
    )


def shapes_of(
    rows: Rows, effect: Effect, shapes_found: Mapping[str, Sequence[Shape]]
) -> tuple[Sequence[Shape], Sequence[Shape]]:
    """Shapes to try, and what stands for them where there are none."""
    wave = effect.wave
    if wave is None:
        return shapes_found.get(effect.name, effect.shapes(rows.states[0])), ()
    return shapes_found.get(effect.name, ()), (
        effect.complete_shape({wave.parameter: wave.probe}),
    )
