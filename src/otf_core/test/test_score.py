# SPDX-License-Identifier: Apache-2.0
"""Score test: quick ways to a gain agree with the plain one, and that with a fit."""

import numpy as np
import pytest
from engine_cells import holding, noise

from otf_core.diagnosis.engine.score import Scores


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


def test_gain_is_that_of_weighted_least_squares(scores_and_time):
    """Half the fall of the squares by shifts of all pieces, each direction with its own."""
    scores, time = scores_and_time
    columns = functions(2.0 * time / time.max() - 1.0, 2)
    whole = np.zeros((9, 9))
    right = np.zeros(9)
    for piece, row in enumerate(columns):
        both = np.kron(np.eye(3), row[None, :])
        whole += both.T @ scores.information[:, :, piece] @ both
        right += both.T @ scores.pull[piece]
    scale = 1.0 / np.sqrt(np.diag(whole))
    whole = whole * np.outer(scale, scale) + 1e-4 * np.eye(9)
    expected = 0.5 * (scale * right) @ np.linalg.solve(whole, scale * right)
    assert scores.gain(columns) == pytest.approx(expected, rel=1e-9)
