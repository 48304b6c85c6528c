# SPDX-License-Identifier: Apache-2.0
"""Rotations that the data do not see, on a table-side axis: their products with the own travel.

Such a rotation r acts through a lever that grows with the travel of its own axis. At the nodes
that is a translation, and is tabled as one. Between them the product of two straight lines bends:
by r' s (1 - s) h G, with the step r' of the rotation over the interval, its length h, s from 0 to
1 within it and G the change of the lever. Tables of the translation cannot follow.

The steps are taken as random with one variance. It is estimated from the residuals e by the
squares Q = |D^T W e|^2 of their projections on the bends D, which noise makes tr M, and steps of
variance v larger by v |M|^2, with M = D^T W P D, P taking off what tables and poses can follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.budget.columns import across, projected, weighted
from otf_core.joint import JointSolution
from otf_core.kinematics import motion_influence
from otf_core.machine import AXES, Machine
from otf_core.runs import Run
from otf_core.tables import MOTIONS, unit_of

Array = NDArray[np.float64]

SIGNIFICANT = 2.0
"""Standard deviations of Q above its mean for noise alone."""


TURNING = ('AX', 'BY', 'CZ')
"""Rotations about the own axis: the own travel is no lever for them."""


def unseen_products(machine: Machine, seen: Sequence[str]) -> list[str]:
    """Rotations not seen whose lever holds the travel of their own axis."""
    return [
        m for m in MOTIONS
        if unit_of(m) == 'rad' and m not in seen and m[1:] not in TURNING
        and m[2] in machine.chain.lever_axes(m[2])
    ]  # fmt: skip


def _columns(machine: Machine, motions: Sequence[str], nodes: dict[str, Array], q: Array) -> Array:
    """Displacement per unit step of every rotation in every interval, shape (p, 3, k), m/rad."""
    columns = []
    for motion in motions:
        own = AXES.index(motion[2])
        change = motion_influence(machine, motion, q + np.eye(3)[own])
        change = change - motion_influence(machine, motion, q)
        for low, high in pairwise(nodes[motion[2]]):
            s = np.clip((q[:, own] - low) / (high - low), 0.0, 1.0)
            columns.append((s * (1.0 - s) * (high - low))[:, None] * change)
    return np.stack(columns, axis=2)


def unseen_covariance(
    runs: Sequence[Run], done: JointSolution, residuals: Sequence[Array], inflation: float
) -> tuple[Array, float]:
    """What unseen rotations add to the covariance.

    Parameters
    ----------
    runs : sequence of Run
    done : JointSolution
    residuals : sequence of ndarray, each of shape (c, p), m
        Of the runs, with what is known of them taken off.
    inflation : float
        Factor on the covariance that the residuals call for.

    Returns
    -------
    covariance : ndarray, shape (full, full)
        Zero if the residuals show nothing of them.
    dof : float
        Number of steps.
    """
    size, nodes = done.unknowns.full, done.unknowns.nodes
    motions = unseen_products(runs[0].machine, done.solution.accepted)
    if not any(len(nodes[m[2]]) > 1 for m in motions):
        return np.zeros((size, size)), np.inf
    columns = [
        across(s, _columns(r.machine, motions, nodes, s.system.q))
        for r, s in zip(runs, done.runs, strict=True)
    ]
    right = projected(done, columns)
    change = done.solution.covariance @ right
    matrix, seen = -right.T @ change, np.zeros(right.shape[1])
    for solved, part, rest in zip(done.runs, columns, residuals, strict=True):
        heavy = weighted(solved, part).reshape(-1, part.shape[2])
        matrix += heavy.T @ part.reshape(-1, part.shape[2])
        seen += heavy.T @ rest.reshape(-1)
    norm = float(np.sum(matrix**2))
    excess = float(seen @ seen) - inflation * float(np.trace(matrix))
    if excess <= SIGNIFICANT * inflation * np.sqrt(2.0 * norm):
        return np.zeros((size, size)), np.inf
    return np.asarray(excess / norm * (change @ change.T)), float(len(seen))
