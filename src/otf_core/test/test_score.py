# SPDX-License-Identifier: Apache-2.0
"""Score test: quick ways to a gain agree with the plain one, and that with a fit."""

from dataclasses import replace

import numpy as np
import pytest
from engine_cells import holding, noise

from otf_core.diagnosis.engine.input_search import Scores


@pytest.fixture(scope='module')
def scores_and_time():
    rows = holding(noise(5))
    return Scores.of(rows), np.concatenate([s.time for s in rows.states])


def functions(place, order):
    return np.polynomial.legendre.legvander(place, order)


def test_products_of_functions_gain_what_their_columns_gain(scores_and_time):
    scores, time = scores_and_time
    rng = np.random.default_rng(8)
    first = functions(2.0 * time / time.max() - 1.0, 3)
    others = [functions(rng.uniform(-1, 1, len(time)), order) for order in (1, 2, 3)]
    found = scores.gains_of_products(first, others)
    for gain, other in zip(found, others, strict=True):
        columns = np.einsum('pi,pj->pij', first, other).reshape(len(time), -1)[:, 1:]
        assert gain == pytest.approx(scores.gain(columns), rel=1e-9)


@pytest.mark.parametrize('count', [3, 64, 150])
def test_waves_gain_what_their_columns_gain(scores_and_time, count):
    scores, time = scores_and_time
    frequency = 0.02 + 0.005 * np.arange(count)
    found = scores.gains_of_waves(time, frequency)
    assert found.shape == (count,)
    for k in (0, count // 2, count - 1):
        angle = 2.0 * np.pi * frequency[k] * time
        waves = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        assert found[k] == pytest.approx(scores.gain(waves), rel=1e-9)


def whitened_gain(rows, functions):
    """Half the fall of the squares by shifts of all pieces, from the rows themselves."""
    matrix, right = 0.0, 0.0
    ends = np.cumsum([len(s) for s in rows.states])[:-1]
    for run, whitener, pulled, own in zip(
        rows.done.runs,
        rows.whiteners,
        rows.pulled_residual.turned,
        np.split(functions, ends),
        strict=True,
    ):
        columns = np.einsum('cpi,pk->cpik', run.system.axes, own)
        white = whitener.whiten(columns).reshape(-1, 3 * functions.shape[1])
        matrix = matrix + white.T @ white
        right = right + np.einsum('pi,pk->ik', pulled[:, :, 0], own).ravel()
    return 0.5 * right @ np.linalg.solve(matrix, right)


@pytest.mark.parametrize('per_leg', [0.0, 0.5, 1.0, 3.0])
def test_gain_is_about_that_of_rows_freed_of_correlation(per_leg):
    """Be it slow, or be it that it changes along the legs, which noise allows much less."""
    rows = holding(noise(5))
    scores = Scores.of(rows)
    sizes = np.concatenate([np.bincount(r.pieces.leg) for r in rows.runs])
    along = np.arange(sizes.sum()) / sizes[sizes > 0].mean()
    if per_leg:
        columns = np.stack([np.sin(2 * np.pi * per_leg * along), np.cos(5 * per_leg * along)], 1)
    else:
        columns = functions(2.0 * along / along.max() - 1.0, 2)[:, 1:]
    assert scores.gain(columns) == pytest.approx(whitened_gain(rows, columns), rel=1 / 3)


def test_gain_of_each_is_that_beside_a_constant(scores_and_time):
    scores, time = scores_and_time
    steps = (time[:, None] > [20.0, 50.0, 70.0]).astype(float)
    found = scores.gains_of_each(steps)
    for k in range(3):
        both = np.stack([np.ones(len(time)), steps[:, k]], axis=1)
        pull = scores.pull - scores.pull.mean(axis=0)  # a constant gains nothing
        alone = replace(scores, pull=pull)
        assert alone.gains_of_each(steps)[k] == pytest.approx(alone.gain(both), rel=1e-3)
    assert len(found) == 3
