# SPDX-License-Identifier: Apache-2.0
"""Rows of the diagnosis: against explicit columns, an explicit covariance, the calibration."""

from itertools import pairwise

import numpy as np
import pytest
from engine_cells import LIMIT, coloured, dense_base, holding, noise, solved_rows
from numpy.testing import assert_allclose
from scipy.linalg import block_diag, cholesky

from otf_core.diagnosis.engine.effect_products import family, shared_with, tried_shapes
from otf_core.diagnosis.engine.time_courses import DECOYS
from otf_core.effects import REGISTRY
from otf_core.effects.free_form import free_forms
from otf_core.model.motions import MOTIONS
from otf_core.noise.noise_model import MODEL_FLOOR
from otf_core.solving.residuals import FOLDS
from otf_core.solving.unknowns import pose_block


@pytest.fixture(scope='module')
def rows():
    return solved_rows()


def legs_of(rows):
    """Run, leg and component of every row, in the order of the rows."""
    found = []
    for number, (run, solved) in enumerate(zip(rows.runs, rows.done.runs, strict=True)):
        for component in range(len(solved.system.axes)):
            found += [(number, int(leg), component) for leg in run.pieces.leg]
    return np.array(found)


# ---------------------------------------------------------------- order


def test_rows_are_those_of_the_runs_component_by_component(rows):
    values = np.arange(len(rows.deviation), dtype=float)
    first, second = rows.by_run(values)
    count = len(rows.runs[0].pieces)
    assert first.shape == (2, count)
    assert second.shape == (2, len(rows.runs[1].pieces))
    assert (first[0, 0], first[1, 0], second[0, 0]) == (0, count, 2 * count)
    stacked = np.stack([values, -values], axis=1)
    np.testing.assert_array_equal(rows.by_run(stacked)[0][..., 1], -first)


def test_deviations_are_measured_less_nominal_across_the_path(rows):
    for part, run, solved in zip(
        rows.by_run(rows.plain_deviation), rows.runs, rows.done.runs, strict=True
    ):
        off = solved.pose.apply(run.pieces.xyz) - solved.system.q
        along = run.pieces.direction * np.sum(run.pieces.direction * off, axis=1)[:, None]
        np.testing.assert_allclose(
            np.linalg.norm(part, axis=0), np.linalg.norm(off - along, axis=1), rtol=1e-9
        )


# ---------------------------------------------------------------- whitening


def mean_correlation(one, other, tau):
    """Mean of exp(-|s - t| / tau) over two windows (start, end), s, by 400 x 400 midpoints."""
    grids = [low + (np.arange(400) + 0.5) / 400 * (high - low) for low, high in (one, other)]
    return float(np.mean(np.exp(-np.abs(grids[0][:, None] - grids[1]) / tau)))


def covariance_by_hand(run, solved, leg, component):
    """Covariance (m, m), m^2, of one leg: range and angles of every sample, half of it white.

    A sample scatters by u_range along the beam and u_angle times the distance across it; the
    other half of the variance is correlated over 0.3 s. A model is good to 0.05 um.
    """
    pieces, spec = run.pieces, run.machine.tracker
    own = np.flatnonzero(pieces.leg == leg)
    beam = solved.pose.rotate(pieces.xyz[own])
    distance = np.linalg.norm(beam, axis=1)
    beam /= distance[:, None]
    axis = solved.system.axes[component, own]
    along = np.sum(axis * beam, axis=1)
    sines = np.linalg.norm(np.cross(axis, beam), axis=1)
    shares = (spec.u_range * along, spec.u_angle * distance * sines)
    time, half = pieces.time[own], 0.5 * pieces.duration[own]
    ends = list(zip(time - half, time + half, strict=True))
    slow = np.array([[mean_correlation(a, b, 0.3) for b in ends] for a in ends])
    matrix = 0.5 * slow * sum(np.outer(g, g) for g in shares)
    matrix += np.diag(0.5 * sum(g**2 for g in shares) / pieces.count[own])
    return own, matrix + MODEL_FLOOR**2 * np.eye(len(own))


@pytest.mark.parametrize(('number', 'leg', 'component'), [(0, 3, 0), (0, 40, 1), (1, 17, 0)])
def test_whitened_columns_are_those_of_the_explicit_covariance(rows, number, leg, component):
    run, solved = rows.runs[number], rows.done.runs[number]
    own, matrix = covariance_by_hand(run, solved, leg, component)
    rng = np.random.default_rng(1)
    columns = np.zeros((len(rows.deviation), 3))
    place = np.flatnonzero((legs_of(rows) == (number, leg, component)).all(axis=1))
    columns[place] = rng.standard_normal((len(own), 3))
    white = rows.whiten(columns)
    expected = columns[place].T @ np.linalg.solve(matrix, columns[place])
    # windows of samples are treated as dense: the mean of few differs by their spacing
    np.testing.assert_allclose(white.T @ white, expected, rtol=2e-3, atol=2e-3 * expected.max())
    assert not np.delete(white, place, axis=0).any()  # legs and components are independent


def test_noise_as_assumed_has_unit_variance_and_no_memory(rows):
    white = holding(noise(2)).deviation
    # 3764 values: standard deviations 0.023 and 0.016
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.07)
    assert np.mean(white[1:] * white[:-1]) == pytest.approx(0.0, abs=0.05)
    given = np.random.default_rng(3).standard_normal(len(white))
    np.testing.assert_allclose(holding(coloured(rows, given)).deviation, given, atol=1e-9)


# ---------------------------------------------------------------- what tables and poses follow


def test_columns_less_tables_and_poses_are_dense_least_squares(rows):
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((len(rows.deviation), 4))
    stacked = np.concatenate([dense_base(rows), cholesky(rows.ridge)])
    given = np.concatenate([columns, np.zeros((len(rows.ridge), 4))])
    fit = np.linalg.lstsq(stacked, given, rcond=None)[0]
    np.testing.assert_allclose(rows.project(columns), columns - dense_base(rows) @ fit, atol=1e-9)
    left = rows.project(rows.deviation[:, None])[:, 0]
    np.testing.assert_allclose(rows.residual, left, atol=1e-12)


def test_tie_breaker_is_a_hundredth_of_squared_bends_and_a_trace_of_size(rows):
    unknowns, rng = rows.done.unknowns, np.random.default_rng(5)
    values = rng.standard_normal(len(rows.use))
    free = np.zeros(unknowns.free)
    free[rows.use] = values
    full = unknowns.gauge @ free
    bends = sum(np.sum(np.diff(full[unknowns.blocks[m]], 2) ** 2) for m in MOTIONS)
    assert values @ rows.ridge @ values == pytest.approx(1e-2 * (bends + 1e-2 * free @ free))


def test_base_is_the_trace_of_a_unit_of_every_unknown(rows):
    """The whitened columns of the calibration's own design, in units of the limit."""
    unknowns = rows.done.unknowns
    design = np.concatenate([s.system.design.toarray() for s in rows.done.runs])
    gauge = unknowns.gauge.toarray()[:, rows.use]
    np.testing.assert_allclose(dense_base(rows), rows.whiten(design @ gauge * LIMIT), atol=1e-9)


@pytest.mark.parametrize('number', [0, 1])
def test_moved_tracker_leaves_nothing(rows, number):
    """A shift and a turn of the tracker of one run by 10 um and 10 urad."""
    parts = [np.zeros_like(s.system.deviation) for s in rows.done.runs]
    run, solved = rows.runs[number], rows.done.runs[number]
    points = solved.pose.apply(run.pieces.xyz)
    moved = np.array([4e-6, -9e-6, 3e-6]) + np.cross([6e-6, -2e-6, 8e-6], points)
    parts[number] = np.einsum('cij,ij->ci', solved.system.axes, moved)
    plain = np.concatenate([p.reshape(-1) for p in parts])
    assert np.abs(plain).max() > 5e-6
    # as the calibration fits it, and with a tie-breaker of 1e-2 of the limit
    assert np.abs(rows.left(plain)).max() < 1e-9
    white = rows.whiten(plain[:, None])
    assert np.linalg.norm(rows.project(white)) < 1e-3 * np.linalg.norm(white)


def test_what_is_left_of_anything_is_dense_generalised_least_squares(rows):
    """With the weights of the noise alone, and what is known before the data."""
    unknowns, done = rows.done.unknowns, rows.done
    gauge = unknowns.gauge.toarray()[:, rows.use] * rows.limit
    design = np.concatenate([s.system.design.toarray() for s in done.runs]) @ gauge
    factors = [
        block_diag(*[leg[c] for leg in whitener.factors])
        for whitener in rows.whiteners
        for c in range(2)
    ]
    plain = noise(6)
    sizes = np.cumsum([0] + [len(f) for f in factors])
    white = [
        np.linalg.solve(f, np.column_stack([design[a:b], plain[a:b]]))
        for f, (a, b) in zip(factors, pairwise(sizes), strict=True)
    ]
    stacked = np.concatenate(white)
    matrix = stacked[:, :-1].T @ stacked[:, :-1] + rows.ridge
    fit = np.linalg.solve(matrix, stacked[:, :-1].T @ stacked[:, -1])
    np.testing.assert_allclose(rows.left(plain), plain - design @ fit, atol=1e-11, rtol=0)
    both = np.column_stack([plain, 2.0 * plain])
    np.testing.assert_allclose(rows.left(both)[:, 1], 2.0 * rows.left(plain), atol=1e-14, rtol=0)


def test_poses_are_always_among_what_is_solved_for(rows):
    blocks = rows.done.unknowns.free_blocks
    for number in range(2):
        block = blocks[pose_block(number)]
        assert set(range(block.start, block.stop)) <= set(rows.use.tolist())


# ---------------------------------------------------------------- columns of effects


def test_columns_are_differences_of_simulated_displacements(rows):
    """A unit of every coefficient at a time, at the pieces of both runs."""
    for name in ('backlash', 'servo_mismatch', 'target_offset'):
        effect = REGISTRY[name]
        shape = dict(effect.shapes(rows.states[0])[0])
        found = rows.plain_columns(effect, shape)
        for k, coefficient in enumerate(rows.terms(effect, shape).names):
            parts = []
            for state, solved in zip(rows.states, rows.done.runs, strict=True):
                moved = effect.displacement(state, {**shape, coefficient: 1e-3}) / 1e-3
                parts += [np.sum(axis * moved, axis=1) for axis in solved.system.axes]
            np.testing.assert_allclose(found[:, k], np.concatenate(parts), atol=1e-12)


# ---------------------------------------------------------------- folds


def test_every_leg_lies_in_one_fold_and_its_neighbours_in_others(rows):
    legs, of_leg = legs_of(rows)[:, :2], {}
    for key, fold in zip(map(tuple, legs), rows.fold, strict=True):
        assert of_leg.setdefault(key, fold) == fold
    for run in (0, 1):
        driven = [of_leg[key] for key in sorted(of_leg) if key[0] == run]
        assert len(driven) > 4 * FOLDS
        assert all(a != b for a, b in pairwise(driven))


def test_folds_are_of_like_size(rows):
    share = np.bincount(rows.fold, minlength=FOLDS) / len(rows.fold)
    assert len(share) == FOLDS
    assert share.min() > 0.5 / FOLDS
    assert share.max() < 1.5 / FOLDS


@pytest.mark.parametrize('free', [False, True])
@pytest.mark.parametrize('name', ['backlash', 'thermal_structure_drift', 'vibration'])
def test_what_a_candidate_does_needs_none_of_its_columns(rows, name, free):
    """Traces and products of terms are those of the columns themselves, run by run or shared."""
    effect = REGISTRY[name]
    forms = free_forms(effect, rows.states)
    if free and not forms:
        return
    effect = forms[-1] if free else effect
    wave = REGISTRY[name].wave
    shape = effect.shapes(rows.states[0])[0] if wave is None else {'frequency': 7.0}
    shape = effect.complete_shape(shape)
    (tried,) = tried_shapes(rows, effect, [shape])
    take = np.arange(len(tried.terms.names))[::2]
    own = tried.source.option(take).own
    value = np.linspace(1.0, 2.0, len(take))
    scale = np.abs(own @ value).max()
    assert_allclose(tried.source.trace(take, value), own @ value, atol=1e-9 * scale)
    other = np.random.default_rng(4).standard_normal((len(own), 2))
    size = np.linalg.norm(own, axis=0).max() * np.linalg.norm(other, axis=0).max()
    found = tried.source.shared(rows.pulled(other))[:, take]
    assert_allclose(found, other.T @ own, atol=1e-9 * size)


@pytest.mark.parametrize('effect', DECOYS, ids=lambda e: e.name)
def test_shapes_in_time_multiplied_together_are_those_of_their_columns(rows, effect):
    shapes = effect.shapes(rows.states[0])[:3]
    alike = tried_shapes(rows, effect, shapes)
    assert len({family(one) for one in alike}) == 1
    other = np.random.default_rng(5).standard_normal((len(rows.deviation), 2))
    every = np.arange(len(alike[0].terms.names))
    for found, one in zip(shared_with(alike, rows.pulled(other)), alike, strict=True):
        own = one.source.option(every).own
        size = np.linalg.norm(own, axis=0).max() * np.linalg.norm(other, axis=0).max()
        assert_allclose(found, other.T @ own, atol=1e-9 * size)


def test_lines_are_sorted_by_the_unknowns_that_they_touch(rows):
    for base, whitener, some in zip(
        rows.by_run(dense_base(rows)), rows.whiteners, rows.touched, strict=True
    ):
        left = base.copy()
        for one in some:
            pieces = np.concatenate([np.arange(*whitener.bounds[k]) for k in one.lines])
            own = left[:, pieces[:, None], one.unknowns]
            np.testing.assert_array_equal(own.reshape(one.base.shape), one.base)
            left[:, pieces[:, None], one.unknowns] = 0.0
        assert sorted(k for one in some for k in one.lines) == [*range(len(whitener.bounds))]
        assert not left.any()
