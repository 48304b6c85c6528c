# SPDX-License-Identifier: Apache-2.0
"""Search for effects: what is named from which odds on, what is told apart, what is refined."""

from dataclasses import replace

import numpy as np
import pytest
from engine_cells import (
    cause_of,
    coloured,
    holding,
    log_bayes_factor,
    noise,
    options_of,
    solved_rows,
    trace_of,
    tried_with,
)
from scipy.optimize import brentq

from otf_core.diagnosis.engine.search import (
    MAX_CAUSES,
    fit_jointly,
    noise_variance,
    remove_option,
    search,
    search_beside,
    tried_effects,
)
from otf_core.diagnosis.engine.time_courses import JUMP, SLOW_WAVE
from otf_core.effects import REGISTRY

BACKLASH, LAG, COUPLING, TILT = (
    REGISTRY[n] for n in ('backlash', 'servo_mismatch', 'cross_coupling', 'table_tilt')
)
WAVE = SLOW_WAVE


def found_in(rows, options):
    """What a search finds among options."""
    return search(rows, tried_with(rows, options))


def named(causes):
    return [c.option.effect.name for c in causes]


def evidence_of(residual, options):
    """Odds of all options of one effect, each as likely as the other, by densities."""
    odds = [log_bayes_factor(o.own, o.size, residual) for o in options]
    return float(np.logaddexp.reduce(odds) - np.log(len(odds)))


def amplitude_for(evidence, trace, options):
    """Factor on plain deviations at which options reach some evidence; without noise."""
    residual = holding(trace).residual
    bases = [np.linalg.qr(o.own)[0] for o in options]
    parts = [(q.T @ o.own, o.size, q.T @ residual) for q, o in zip(bases, options, strict=True)]

    def lacking(logarithm):
        odds = [log_bayes_factor(c, size, np.exp(logarithm) * y) for c, size, y in parts]
        return np.logaddexp.reduce(odds) - np.log(len(odds)) - evidence

    return np.exp(brentq(lacking, -8.0, 8.0))


# ---------------------------------------------------------------- from which odds on


@pytest.mark.parametrize(
    ('effect', 'coefficients', 'needed'),
    [
        (BACKLASH, {'B_X': 1e-7, 'B_Z': -1e-7}, 9.0),
        (COUPLING, {'Z_X2Y': 1e-7}, 9.0),
        (JUMP, {'J_Y': 1e-7}, 19.0),  # a shape outside the catalogue: 10 more
    ],
    ids=['backlash', 'coupling', 'jump'],
)
def test_effect_is_named_from_its_odds_on_and_not_before(effect, coefficients, needed):
    options = options_of(effect)[:4]
    trace = trace_of(cause_of(effect), **coefficients)
    below, above = (amplitude_for(needed + step, trace, options) * trace for step in (-0.1, 0.1))
    assert found_in(holding(below), {effect.name: options})[0] == []
    (cause,), _ = found_in(holding(above), {effect.name: options})
    assert cause.option.effect is effect
    assert cause.score == pytest.approx(9.1, abs=0.02)


def test_confidence_is_the_share_of_the_odds_none_among_them():
    options = options_of(BACKLASH)
    trace = trace_of(cause_of(BACKLASH), B_X=1e-7)
    rows = holding(amplitude_for(9.5, trace, options) * trace)
    (cause,), _ = found_in(rows, {'backlash': options})
    assert cause.confidence == pytest.approx(1 / (1 + np.exp(-9.5)), abs=1e-6)
    # a lag of the drives looks much like it at one feed
    (cause,), _ = found_in(rows, {'backlash': options, LAG.name: options_of(LAG)})
    odds = np.exp([evidence_of(rows.residual, o) for o in (options, options_of(LAG))])
    assert 0.1 < odds[1] / odds[0] < 10.0
    assert cause.confidence == pytest.approx(odds.max() / (1 + odds.sum()), rel=1e-6)


@pytest.mark.parametrize('level', [1.0, 3.0])
def test_noise_names_nothing_even_if_louder_than_assumed(level):
    options = {e.name: options_of(e) for e in (BACKLASH, LAG, COUPLING, JUMP)}
    for seed in range(2):
        causes, considered = found_in(holding(noise(200 + seed, level)), options)
        assert causes == []
        assert len(considered) == 4
        assert max(score for _, score in considered) < 5.0


def test_louder_noise_asks_for_a_larger_effect():
    """Backlash that is plain in noise as assumed is not named in ten times as much of it."""
    trace, options = trace_of(cause_of(BACKLASH), B_X=2e-6), {'backlash': options_of(BACKLASH)}
    for seed in range(2):
        assert named(found_in(holding(trace + noise(seed)), options)[0]) == ['backlash']
        assert named(found_in(holding(trace + noise(seed, 10.0)), options)[0]) == []


@pytest.mark.parametrize(('memory', 'factor'), [(0.0, 1.0), (0.5, 3.0), (0.8, 9.0)])
def test_noise_that_neighbours_share_counts_as_its_mean_over_a_leg(memory, factor):
    """First-order memory: the variance of means of n values is (1 + m) / (1 - m) / n.

    Legs of some ten pieces cut the longest memories; lags below 5 % are left out.
    """
    rows, rng = solved_rows(), np.random.default_rng(9)
    found = []
    for _ in range(4):
        white = rng.standard_normal(len(rows.deviation))
        for k in range(1, len(white)):
            white[k] = memory * white[k - 1] + np.sqrt(1 - memory**2) * white[k]
        found.append(noise_variance(rows, 2.0 * white) / 4.0)
    assert np.mean(found) == pytest.approx(factor, rel=0.2)


def test_residuals_smaller_than_assumed_count_as_assumed():
    rows = solved_rows()
    assert noise_variance(rows, 0.1 * rows.whiten(noise(3)[:, None])[:, 0]) == 1.0


# ---------------------------------------------------------------- one after the other


@pytest.mark.parametrize(
    ('effect', 'shape'),
    [(COUPLING, {}), (WAVE, {'period': 12.0}), (REGISTRY['cyclic_error'], {'period': 0.055})],
    ids=['coupling', 'slow wave', 'cyclic error'],
)
def test_products_are_those_of_columns_less_tables_poses_and_causes(effect, shape):
    """Dense least squares on the columns; a wave has coefficients of its own in both runs."""
    rows, rng = holding(noise(41, 5.0)), np.random.default_rng(7)
    tried, *_ = tried_effects(rows, [effect], {effect.name: [shape]})[0][effect.name]
    own = rows.project(rows.whiten(rows.plain_columns(effect, shape)))
    basis, residual = np.zeros((len(own), 0)), rows.residual
    for count in (2, 3, 0):
        rest = np.stack([c - basis @ np.linalg.lstsq(basis, c, rcond=None)[0] for c in own.T], 1)
        scale = np.abs(rest.T @ rest).max()
        np.testing.assert_allclose(tried.normal, rest.T @ rest, atol=1e-9 * scale)
        right = rest.T @ residual
        np.testing.assert_allclose(tried.right, right, atol=1e-9 * np.sqrt(scale * len(own)))
        if count:
            new = rng.standard_normal((len(basis), count))
            new = np.linalg.qr(new - basis @ (basis.T @ new))[0]
            amount = new.T @ residual
            tried, residual = (
                tried.without(tried.source.shared(rows.pulled(new)), amount),
                residual - new @ amount,
            )
            basis = np.concatenate([basis, new], axis=1)


def test_effects_are_found_one_after_the_other_and_then_no_more():
    options = {e.name: options_of(e) for e in (COUPLING, LAG, BACKLASH)}
    trace = trace_of(cause_of(BACKLASH), B_X=8e-6) + trace_of(cause_of(COUPLING), Z_X2Y=2e-6)
    causes, considered = found_in(holding(trace + noise(11)), options)
    assert named(causes) == ['backlash', 'cross_coupling']
    assert [name for name, _ in considered] == ['servo_mismatch']
    assert considered[0][1] < 9.0


def test_the_second_is_scored_on_what_the_first_cannot_follow():
    """Columns of the second less those of the first: dense least squares, no products."""
    first, second = cause_of(BACKLASH), options_of(COUPLING)
    rows = holding(trace_of(first, B_X=3e-5) + trace_of(cause_of(COUPLING), Z_X2Y=3e-6))
    options = {'backlash': [first.option], 'cross_coupling': second}
    causes, _ = found_in(rows, options)
    assert named(causes) == ['backlash', 'cross_coupling']

    def less_first(values):
        own = first.option.own
        return values - own @ np.linalg.lstsq(own, values, rcond=None)[0]

    left = less_first(rows.residual)
    odds = [log_bayes_factor(less_first(o.own), o.size, left) for o in second]
    expected = np.logaddexp.reduce(odds) - np.log(len(odds))
    assert expected > 9.0
    assert causes[1].score == pytest.approx(expected, rel=1e-6)
    left = remove_option(causes[1].option, remove_option(causes[0].option, rows.residual))
    assert np.sum(left**2) < 1e-9 * np.sum(rows.residual**2)


def test_coefficients_of_all_causes_are_fitted_together():
    true = ({'B_X': 5e-6, 'B_Z': -2e-6}, {'S_X': 3e-6, 'C_Y (run 2)': -4e-6})
    causes = [cause_of(BACKLASH), cause_of(WAVE, period=30.0)]
    rows = holding(sum(trace_of(c, **t) for c, t in zip(causes, true, strict=True)))
    names = [c.option.terms.names[i] for c in causes for i in c.option.take]
    found = dict(zip(names, fit_jointly(causes, rows).value, strict=True))
    for name, value in found.items():
        assert value == pytest.approx({**true[0], **true[1]}.get(name, 0.0), abs=1e-11)


# ---------------------------------------------------------------- told apart or not


def stand_in(option, effect, own):
    """The option with another name and other columns."""
    return replace(option, effect=effect, own=own, white=own)


def turned(rows, own, share):
    """A column of the same length of which this share of the squares is not in ``own``."""
    other = rows.project(np.random.default_rng(13).standard_normal(own.shape))
    length = np.linalg.norm(own)
    other -= own * (own[:, 0] @ other[:, 0]) / length**2
    other *= length / np.linalg.norm(other)
    return np.sqrt(1 - share) * own + np.sqrt(share) * other


def backlash_of_x():
    """The option of backlash of X alone, and rows with 6 um of it."""
    option = next(o for o in options_of(BACKLASH) if o.axes == ('X',))
    return option, holding(trace_of(cause_of(BACKLASH), B_X=6e-6))


def test_an_effect_with_the_same_columns_is_not_told_from_the_best():
    option, rows = backlash_of_x()
    options = {
        'backlash': [option],
        'servo_mismatch': [stand_in(option, LAG, option.own)],
        'cross_coupling': options_of(COUPLING),
    }
    (cause, *_), _ = found_in(rows, options)
    pair = {'backlash', 'servo_mismatch'}
    assert {cause.option.effect.name, *cause.indistinguishable} == pair
    assert cause.confidence == pytest.approx(0.5, abs=1e-6)


def test_no_more_than_four_are_named():
    rows, rng = solved_rows(), np.random.default_rng(12)
    names, options, total = [n for n in REGISTRY if n != 'tracker_noise'][:6], {}, 0.0
    for name in names:
        own = rng.standard_normal((len(rows.deviation), 1))
        option = stand_in(options_of(LAG)[1], REGISTRY[name], rows.project(own))
        options[name] = [replace(option, size=np.array([1e-6]))]
        total = total + own[:, 0]
    causes, considered = found_in(holding(coloured(rows, total)), options)
    assert len(causes) == MAX_CAUSES == 4
    assert len(considered) == 3  # of the last round


def crossing(size, stray):
    """Rows that hold p + q, and columns: p, q, and nearly the sum of both, a share astray."""
    rows = solved_rows()
    own = rows.project(np.random.default_rng(17).standard_normal((len(rows.deviation), 3)))
    p, q, r = size * np.linalg.qr(own)[0].T
    total = p + q
    sum_like = p + 0.8 * q + stray * r
    effects = (REGISTRY['thermal_structure_drift'], COUPLING, BACKLASH)
    options = {
        e.name: [replace(stand_in(options_of(LAG)[1], e, v[:, None]), size=np.array([1e-6]))]
        for e, v in zip(effects, (sum_like, p, q), strict=True)
    }
    return holding(coloured(rows, total)), options


@pytest.mark.parametrize(
    ('size', 'stray', 'left'),
    [
        (60.0, 0.0, {'thermal_structure_drift', 'cross_coupling'}),  # as good as the true pair
        (30.0, 0.15, {'backlash', 'cross_coupling'}),  # two were named, one of them wrong
        (30.0, 0.3, {'backlash', 'cross_coupling'}),  # all three were named
    ],
    ids=['stays', 'exchanged', 'left out'],
)
def test_what_stood_for_two_others_is_not_named_beside_them(size, stray, left):
    rows, options = crossing(size, stray)
    first = max(options, key=lambda n: evidence_of(rows.residual, options[n]))
    assert first == 'thermal_structure_drift'
    causes, _ = found_in(rows, options)
    assert set(named(causes)) == left


@pytest.mark.parametrize(('size', 'beside'), [(0.7, True), (0.0, False)])
def test_a_coupling_along_all_directions_does_not_swallow_a_tilt_beside_one_along_z(size, beside):
    """Its columns hold those of the tilt: by evidence alone, both readings are as good."""
    every, tilts = options_of(COUPLING), options_of(TILT)
    rows = solved_rows()
    columns = rows.project(np.random.default_rng(19).standard_normal((len(rows.deviation), 30)))
    own = 80.0 * np.linalg.qr(columns)[0]

    def um(option, effect, columns):
        return replace(stand_in(option, effect, columns), size=np.full(columns.shape[1], 1e-6))

    options = {
        COUPLING.name: [um(o, COUPLING, own[:, o.take]) for o in every],
        TILT.name: [um(tilts[0], TILT, own[:, : tilts[0].take.size])],
    }
    causes, _ = found_in(holding(coloured(rows, size * own[:, 1] + own[:, 25])), options)
    assert set(named(causes)) == {COUPLING.name, *([TILT.name] if beside else [])}
    sure = {c.option.effect.name: (c.confidence, c.indistinguishable) for c in causes}
    assert sure[COUPLING.name] == (pytest.approx(1.0, abs=1e-3), ())
    if beside:
        assert 0.3 < sure[TILT.name][0] < 0.99
        assert sure[TILT.name][1] == (COUPLING.name,)


@pytest.mark.parametrize(('share', 'same'), [(0.028, True), (0.032, False)])
def test_an_effect_that_leaves_three_hundredths_is_the_same_and_one_that_leaves_more_is_not(
    share, same
):
    option, rows = backlash_of_x()
    like = stand_in(option, LAG, turned(rows, option.own, share))
    (cause, *_), considered = found_in(rows, {'backlash': [option], 'servo_mismatch': [like]})
    assert cause.option.effect is BACKLASH
    assert cause.confidence > 0.9  # three hundredths of large evidence are some three nats
    assert cause.indistinguishable == (('servo_mismatch',) if same else ())
    assert len(considered) <= 2


@pytest.mark.parametrize(('distance', 'same'), [(4.9, True), (5.1, False)])
def test_effects_within_odds_of_150_are_not_told_apart(distance, same):
    """A worse one is made by shortening what it shares; 4 of the squares is no difference."""
    option, _ = backlash_of_x()
    trace = trace_of(cause_of(BACKLASH), B_X=1e-7)
    rows = holding(amplitude_for(60.0, trace, [option]) * trace)
    low, high = 0.0, 0.5
    for _ in range(16):
        share = 0.5 * (low + high)
        like = stand_in(option, LAG, turned(rows, option.own, share))
        off = evidence_of(rows.residual, [option]) - evidence_of(rows.residual, [like])
        low, high = (share, high) if off < distance else (low, share)
    (cause, *_), _ = found_in(rows, {'backlash': [option], 'servo_mismatch': [like]})
    assert cause.indistinguishable == (('servo_mismatch',) if same else ())


def test_a_shape_outside_the_catalogue_is_no_name_for_the_same():
    option, rows = backlash_of_x()
    options = {'backlash': [option], 'jump': [stand_in(option, JUMP, option.own)]}
    (cause, *_), _ = found_in(rows, options)
    assert (cause.option.effect, cause.indistinguishable) == (BACKLASH, ())


def test_at_most_four_names_are_listed():
    option, rows = backlash_of_x()
    names = [n for n in REGISTRY if n not in ('backlash', 'tracker_noise')][:6]
    options = {'backlash': [option]}
    options |= {n: [stand_in(option, REGISTRY[n], option.own)] for n in names}
    (cause, *_), _ = found_in(rows, options)
    assert len(cause.indistinguishable) == 4


# ---------------------------------------------------------------- refinement


@pytest.mark.parametrize(
    ('effect', 'raster', 'true', 'coefficients'),
    [
        (WAVE, 12.0, 12.4, {'S_X': 4e-6, 'C_Z': -3e-6}),
        (WAVE, 12.0, 11.7, {'C_Y': 3e-6}),
        (REGISTRY['cyclic_error'], 0.055, 0.0553, {'S_Y': 3e-6, 'C_Y': 2e-6}),
    ],
)
def test_refinement_moves_a_shape_to_the_true_one(effect, raster, true, coefficients):
    """Off by d, a shape leaves (d / u)^2 of the sum of squares: that is how well it is seen."""
    trace = trace_of(cause_of(effect, period=true), **coefficients)
    options = {effect.name: options_of(effect, period=raster)}
    off = cause_of(effect, period=1.003 * true).option.own
    residual = holding(trace).residual
    left = np.linalg.lstsq(off, residual, rcond=None)[1][0]
    u = 0.003 * true / np.sqrt(left)
    assert abs(raster - true) > 5 * u
    for rows, most in ((holding(trace), 0.3 * u), (holding(trace + noise(15)), 3 * u)):
        causes, _ = found_in(rows, options)
        assert causes[0].option.effect is effect
        assert causes[0].option.shape['period'] == pytest.approx(true, abs=most)


def test_refined_columns_are_those_of_the_refined_shape():
    trace = trace_of(cause_of(WAVE, period=12.4), S_X=4e-6)
    rows = holding(trace + noise(15))
    (cause, *_), _ = found_in(rows, {'slow_wave': options_of(WAVE, period=12.0)})
    anew = cause_of(WAVE, period=cause.option.shape['period']).option
    np.testing.assert_allclose(cause.option.plain, anew.plain, atol=1e-12)
    np.testing.assert_allclose(cause.option.own, anew.own, atol=1e-6)
    np.testing.assert_allclose(cause.option.size, anew.size, rtol=1e-9)


def test_what_is_known_stays_first_and_the_rest_is_found_beside_it():
    known, other = cause_of(COUPLING), cause_of(BACKLASH)
    whole = trace_of(known, Z_X2Y=3e-6) + trace_of(other, B_X=4e-6)
    rows = holding(whole + noise(7))
    tried = tried_with(rows, {'backlash': options_of(BACKLASH)})
    first, *found = search_beside(rows, tried, [known])
    assert first is known and named(found) == ['backlash']
    alone = holding(trace_of(known, Z_X2Y=3e-6) + noise(7))
    tried = tried_with(alone, {'backlash': options_of(BACKLASH)})
    assert search_beside(alone, tried, [known]) == [known]
