# SPDX-License-Identifier: Apache-2.0
"""Folds of a cross-validation: whole legs are held out, since noise is correlated within a leg."""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Index
from otf_core.solving.joint import JointSolution

FOLDS = 8


def leg_numbers(done: JointSolution) -> list[Index]:
    """Number of the leg of every piece, shape (p,) for every run; further runs count on."""
    found, start = [], 0
    for solved in done.runs:
        size = [high - low for low, high in solved.whitener.bounds]
        found.append(np.repeat(np.arange(start, start + len(size)), size))
        start += len(size)
    return found


def fold_of(number: Index) -> Index:
    """Fold of legs by their numbers; neighbouring ones go to different folds."""
    # laps of one line do not always share a fold
    return np.asarray((number * 5 + number // FOLDS) % FOLDS)
