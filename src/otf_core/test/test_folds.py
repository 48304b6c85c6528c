# SPDX-License-Identifier: Apache-2.0
"""Folds of a cross-validation: legs are never split, neighbours never share a fold."""

from types import SimpleNamespace

import numpy as np

from otf_core.solving.residuals import FOLDS, fold_of, leg_numbers


def solved(*runs):
    """Stands for a solution: only the bounds of the legs are asked for."""
    parts = [SimpleNamespace(whitener=SimpleNamespace(bounds=bounds)) for bounds in runs]
    return SimpleNamespace(runs=parts)


def test_legs_of_further_runs_count_on():
    first, second = leg_numbers(solved([(0, 2), (2, 3)], [(0, 1), (1, 4)]))
    assert first.tolist() == [0, 0, 1]
    assert second.tolist() == [2, 3, 3, 3]


def test_folds_are_alike_in_size_and_neighbours_are_in_different_ones():
    fold = fold_of(np.arange(20 * FOLDS))
    assert np.bincount(fold).tolist() == [20] * FOLDS
    assert np.all(np.diff(fold) != 0)


def test_laps_of_as_many_legs_as_folds_do_not_share_one():
    fold = fold_of(np.arange(4 * FOLDS)).reshape(4, FOLDS)
    assert all(len(set(lap)) == 4 for lap in fold.T.tolist())
