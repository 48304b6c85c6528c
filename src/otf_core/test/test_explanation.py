# SPDX-License-Identifier: Apache-2.0
"""Which of the effects found are named, and what counts as known, noise and structure."""

from dataclasses import replace

import numpy as np
import pytest
from engine_cells import (
    cause_of,
    coloured,
    holding,
    noise,
    options_of,
    rms_um,
    solved_rows,
    trace_of,
)
from scipy.optimize import brentq

from otf_core.diagnosis.engine.gap_sizes import plain_residuals, residuals_with
from otf_core.diagnosis.engine.search import Cause
from otf_core.diagnosis.engine.time_courses import JUMP
from otf_core.diagnosis.weighing import _without_small, explain, matters
from otf_core.effects import REGISTRY
from otf_core.solving.residuals import FOLDS

BACKLASH, LAG, TABLES = (REGISTRY[n] for n in ('backlash', 'servo_mismatch', 'table_resolution'))


def single(effect, axis):
    """A cause with the one term of an effect that belongs to an axis."""
    option = next(o for o in options_of(effect) if o.axes == (axis,))
    assert option.take.size == 1
    return Cause(option, 50.0, 1.0, ())


def leaving(cause, um):
    """Plain deviations of a cause that the calibration leaves so many um of."""
    plain = cause.option.plain.sum(axis=1)
    return plain * um / rms_um(solved_rows().left(plain))


def renamed(cause, effect):
    return replace(cause, option=replace(cause.option, effect=effect))


def names(causes):
    return [c.option.effect.name for c in causes]


# ---------------------------------------------------------------- what is large enough


@pytest.mark.parametrize('effect', [BACKLASH, TABLES])
@pytest.mark.parametrize(('um', 'named'), [(0.199, False), (0.201, True)])
def test_a_cause_of_a_gap_is_named_from_a_fifth_of_a_micrometre_on(effect, um, named):
    """Without noise nothing of it is left on the legs that were not fitted on."""
    cause = single(BACKLASH, 'X')
    found = explain(holding(leaving(cause, um)), [renamed(cause, effect)], 0.0)
    assert names(found.causes) == ([effect.name] if named else [])
    assert found.before_um == pytest.approx(um)
    assert found.after_um == pytest.approx(0.0 if named else um, abs=1e-6)


@pytest.mark.parametrize(
    ('effect', 'um', 'named'),
    [(BACKLASH, 0.201, True), (TABLES, 0.449, False), (TABLES, 0.451, True)],
)
def test_tables_always_leave_a_little_between_their_nodes(effect, um, named):
    """Where there is no gap to speak of, twice as much is asked for there."""
    cause, simulated = single(BACKLASH, 'X'), 0.97 * um
    found = explain(holding(leaving(cause, um)), [renamed(cause, effect)], simulated)
    assert found.simulated_um == simulated and not matters(found.before_um, simulated)
    assert names(found.causes) == ([effect.name] if named else [])


def apart_from(option, seed, level=4.0):
    """Deviations that change the coefficient of an option in no fold."""
    rows = solved_rows()
    parts = [option.own * (rows.fold == fold)[:, None] for fold in range(FOLDS)]
    seen = rows.project(np.concatenate(parts, axis=1))
    white = np.random.default_rng(seed).standard_normal(len(seen))
    white -= seen @ np.linalg.lstsq(seen, white, rcond=None)[0]
    return coloured(rows, level * white)


@pytest.mark.parametrize(('share', 'named'), [(0.118, False), (0.122, True)])
@pytest.mark.parametrize('simulated_um', [0.0, 1.0])
def test_a_cause_is_named_from_twelve_hundredths_of_the_gap_on(share, named, simulated_um):
    """Beside a rest that says nothing of the cause; simulation at the level of one of them."""
    rows, cause = solved_rows(), single(BACKLASH, 'X')
    rest = apart_from(cause.option, 5)
    own = leaving(cause, 1.0)
    left_of_rest, left_of_own = rows.left(rest), rows.left(own)
    before = rms_um(left_of_rest)

    def gap_and_trace(um):
        whole = rms_um(left_of_rest + um * left_of_own)
        return np.sqrt(whole**2 - simulated_um**2), np.sqrt(max(0.0, whole**2 - before**2))

    def lacking(um):
        gap, trace = gap_and_trace(um)
        return trace / gap - share

    um = brentq(lacking, 0.05, 3.0)
    assert gap_and_trace(um)[1] > 0.21
    found = explain(holding(rest + um * own), [cause], simulated_um)
    assert names(found.causes) == (['backlash'] if named else [])


def test_a_further_cause_is_judged_on_what_the_first_leaves():
    """Twice the same cause: the second has nothing left to do."""
    cause = single(BACKLASH, 'X')
    rows = holding(leaving(cause, 3.0) + noise(1))
    found = explain(rows, [cause, renamed(cause, LAG), single(BACKLASH, 'Z')], 0.5)
    assert names(found.causes) == ['backlash']
    assert len(found.steps) == 2


def test_steps_are_the_residuals_with_one_cause_more_each():
    first, second = single(BACKLASH, 'X'), single(LAG, 'Y')
    rows = holding(leaving(first, 3.0) + leaving(second, 2.0) + noise(2))
    found = explain(rows, [first, second], 0.5)
    assert found.causes == (first, second)
    expected = [
        plain_residuals(rows),
        *(residuals_with(rows, f) for f in ([first], [first, second])),
    ]
    for step, wanted in zip(found.steps, expected, strict=True):
        np.testing.assert_array_equal(step.rows, wanted.rows)
    inside = residuals_with(rows, [first, second], held_out=False)
    np.testing.assert_array_equal(found.fitted.rows, inside.rows)
    for gap, step in ((found.before_um, expected[0]), (found.after_um, expected[-1])):
        simulated = found.simulated_um
        assert gap**2 + simulated**2 == pytest.approx(max(step.rms_um, simulated) ** 2)


def test_without_causes_only_the_first_step_is_left():
    cause = single(BACKLASH, 'X')
    found = explain(holding(leaving(cause, 3.0) + noise(3)), [cause], 0.5)
    bare = found.without_causes(found.simulated_um)
    assert (bare.causes, bare.steps) == ((), found.steps[:1])
    assert bare.fitted is found.steps[0]
    assert bare.after_um == bare.before_um == found.before_um > found.after_um
    assert (bare.structured, bare.decoyed) == (found.structured, found.decoyed)


# ---------------------------------------------------------------- shapes outside the catalogue


def jump():
    """A cause outside the catalogue."""
    return cause_of(JUMP, moment=40.0)


@pytest.mark.parametrize(('share', 'decoyed'), [(0.97, False), (1.03, True)])
@pytest.mark.parametrize('first', ['jump', 'backlash'])
def test_shapes_outside_the_catalogue_win_if_they_explain_more(share, decoyed, first):
    """Without noise the first takes what it can and the second the rest, to nothing."""
    rows, known, other = solved_rows(), single(BACKLASH, 'X'), jump()
    own, shift = leaving(known, 3.0), trace_of(other, J_Z=1e-6)
    found = [other, known] if first == 'jump' else [known, other]

    # residuals, with a cause or without, are linear in the deviations
    before = [rows.left(part) for part in (own, shift)]
    after = [residuals_with(holding(part), found[:1]).rows for part in (own, shift)]

    def explained(size):
        """Squares that jump and backlash take off, um^2."""
        whole, left = (rms_um(a + size * b) ** 2 for a, b in (before, after))
        return (whole - left, left) if first == 'jump' else (left, whole - left)

    def lacking(size):
        jumps, backlash = explained(size)
        return jumps / backlash - share

    size = brentq(lacking, 0.5, 20.0, xtol=1e-3)
    planted = holding(own + size * shift)
    answer = explain(planted, found, 0.0)
    assert answer.decoyed is decoyed
    assert names(answer.causes) == ['backlash']
    assert len(answer.steps) == 2
    np.testing.assert_array_equal(answer.steps[1].rows, residuals_with(planted, [known]).rows)
    assert answer.after_um > 1.0  # what the jump takes is not explained


def test_nothing_found_is_neither_named_nor_outside():
    found = explain(holding(noise(4)), [], 0.5)
    assert (found.causes, found.decoyed, len(found.steps)) == ((), False, 1)
    assert found.known_um == found.steps[0].rms_um
    assert found.known_rest is found.fitted


# ---------------------------------------------------------------- known, though too small to name


def test_what_is_too_small_to_be_named_is_known_all_the_same():
    named, small = single(BACKLASH, 'X'), single(LAG, 'Y')
    rows = holding(leaving(named, 3.0) + leaving(small, 0.15))
    found = explain(rows, [named, small], 0.0)
    assert found.causes == (named,)
    assert 0.1 < found.after_um < 0.15  # the one that is named takes a little of it
    assert found.known_um == pytest.approx(0.0, abs=1e-6)
    assert found.known_rest.rms_um == pytest.approx(0.0, abs=1e-6)
    assert found.fitted.rms_um > 0.1


def test_something_else_is_weighed_without_what_is_too_small_to_be_named():
    named, small = single(BACKLASH, 'X'), single(LAG, 'Y')
    large = leaving(named, 3.0)
    found = explain(holding(large + leaving(small, 0.15)), [named, small], 0.0)
    assert found.small == (small,)
    rest = _without_small(holding(large + leaving(small, 0.15)), found)
    np.testing.assert_allclose(rest.residual, holding(large).residual, atol=1e-3)
    alone = explain(holding(large), [named], 0.0)
    rows = holding(large)
    assert _without_small(rows, alone) is rows


def test_what_is_found_after_a_shape_outside_the_catalogue_is_not_known():
    """It lives on what that shape left."""
    named, small, other = single(BACKLASH, 'X'), single(LAG, 'Y'), jump()
    rows = holding(leaving(named, 3.0) + leaving(small, 0.15) + trace_of(other, J_Z=2e-6))
    before, after = (
        explain(rows, order, 0.0) for order in ([named, small, other], [named, other, small])
    )
    assert before.causes == after.causes == (named,)
    assert before.known_um == residuals_with(rows, [named, small]).rms_um
    assert after.known_um == residuals_with(rows, [named]).rms_um
    assert before.known_um < after.known_um


def test_what_makes_held_out_legs_worse_is_no_knowledge():
    """30 coefficients of nothing at all."""
    rows, wild = holding(noise(5)), cause_of(REGISTRY['cross_coupling'])
    found = explain(rows, [wild], 0.5)
    assert residuals_with(rows, [wild]).rms_um > plain_residuals(rows).rms_um
    assert found.known_um == plain_residuals(rows).rms_um


# ---------------------------------------------------------------- noise and structure


def of_variance(variance, seed, extra=0.0):
    """Rows whose noise has this variance per degree of freedom, and further deviations."""
    rows, plain = solved_rows(), noise(seed)
    free = len(rows.deviation) - len(rows.use)
    found = np.sum(holding(plain).residual ** 2) / free
    return holding(np.sqrt(variance / found) * plain + extra)


@pytest.mark.parametrize(
    ('variance', 'factor'),
    [(0.69, 1.0), (0.71, 0.71**0.5), (1.0, 1.0), (1.39, 1.39**0.5), (1.41, 1.0), (4.0, 1.0)],
)
def test_noise_of_the_simulation_is_corrected_by_what_has_no_structure(variance, factor):
    found = explain(of_variance(variance, 6), [], 2.0)
    assert found.simulated_um == pytest.approx(2.0 * factor, rel=1e-9)


def test_noise_is_corrected_by_what_the_causes_leave():
    cause = single(BACKLASH, 'X')
    rows = of_variance(1.2, 7, leaving(cause, 3.0))
    assert explain(rows, [cause], 2.0).simulated_um == pytest.approx(2.0 * 1.2**0.5, rel=1e-3)
    assert explain(rows, [], 2.0).simulated_um == 2.0


def remembering(memory, level, seed):
    """Rows with noise of which neighbouring pieces share some."""
    rng, rows = np.random.default_rng(seed), solved_rows()
    white = rng.standard_normal(len(rows.deviation))
    for k in range(1, len(white)):
        white[k] = memory * white[k - 1] + np.sqrt(1 - memory**2) * white[k]
    return holding(coloured(rows, level * white))


@pytest.mark.parametrize(
    ('memory', 'level', 'structured'),
    [(0.0, 1.0, False), (0.0, 3.0, False), (0.0, 0.5, False), (0.3, 1.0, True), (0.3, 3.0, True)],
)
def test_structure_is_what_neighbours_share_and_not_the_size(memory, level, structured):
    for seed in (8, 9):
        found = explain(remembering(memory, level, seed), [], 2.0)
        assert found.structured is structured
        if structured:  # its size tells nothing of the noise
            assert found.simulated_um == 2.0
