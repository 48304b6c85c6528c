# SPDX-License-Identifier: Apache-2.0
"""Residuals of solved runs: of single samples, their size and correlation, folds of legs.

Noise is correlated within a leg, so a cross-validation holds out whole legs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.effects import State
from otf_core.effects.state import state_on_path
from otf_core.model.chain import displacement
from otf_core.model.frames import RigidTransform
from otf_core.model.path import Legs, leg_bounds
from otf_core.model.signals import Courses
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Run
from otf_core.solving.joint import JointSolution

DETREND_ORDER = 3


@dataclass(frozen=True)
class SampleResiduals:
    """Samples in the pieces of a run.

    Attributes
    ----------
    leg : ndarray of int64, shape (n,)
    residual : ndarray, shape (n, 3), m
        Perpendicular to the path, machine frame, compensated, slow part of each leg taken off.
    """

    leg: Index
    state: State
    residual: Array


def detrend_legs(values: Array, leg: Index, order: int = DETREND_ORDER) -> Array:
    """Take a polynomial over the samples of each leg off, column by column."""
    result = np.empty_like(values)
    for low, high in leg_bounds(leg):
        x = np.linspace(-1.0, 1.0, high - low)
        basis = np.polynomial.legendre.legvander(x, min(order, max(high - low - 1, 0)))
        part = values[low:high]
        result[low:high] = part - basis @ np.linalg.lstsq(basis, part, rcond=None)[0]
    return result


def sample_state(
    run: Run, pose: RigidTransform, tables: ErrorTables | None, nodes: dict[str, Array]
) -> State:
    """State of the samples in the pieces of a run."""
    samples, legs, index = run.samples, Legs(run.alignment.corners), run.pieces.samples
    leg = run.alignment.leg[index].astype(np.int64)
    points = pose.apply(samples.xyz[index])
    q = legs.at(legs.along(points, leg), leg)
    if tables is not None:  # errors along the path would shift the phase of periodic effects
        q = legs.at(legs.along(points - displacement(tables, q), leg), leg)
    return state_on_path(
        run.machine,
        legs.corners,
        leg,
        q,
        run.pieces.speed[run.pieces.piece],
        run.late + samples.time[index],
        pose,
        nodes,
        tables,
        run.late + run.pieces.end,
        run.shape,
        Courses(run.signals, run.first_ns, samples.time[index]),
        run.leg_starts,
    )


def sample_residuals(
    run: Run, pose: RigidTransform, tables: ErrorTables, nodes: dict[str, Array]
) -> SampleResiduals:
    """Compute the residuals of all samples in the pieces of a run.

    Parameters
    ----------
    pose : RigidTransform
        Tracker to machine, as solved.
    nodes : mapping of axis to ndarray, m
    """
    state = sample_state(run, pose, tables, nodes)
    leg = run.pieces.leg[run.pieces.piece]
    points = pose.apply(run.samples.xyz[run.pieces.samples])
    offset = points - state.q - displacement(tables, state.q)
    offset -= np.einsum('ij,ij->i', offset, state.direction)[:, None] * state.direction
    return SampleResiduals(leg, state, detrend_legs(offset, leg))


MAX_LAG = 200
"""pieces; longest distance at which residuals are searched for correlation."""


@dataclass(frozen=True)
class ResidualCheck:
    """How the residuals compare with the noise that the weights assume.

    Attributes
    ----------
    variance_ratio : float
        Sum of squared normalised residuals per degree of freedom (s0^2; 1 as specified).
    correlation_factor : float
        1 + 2 * sum of the autocorrelation of successive pieces; 1 for independent residuals.
    """

    variance_ratio: float
    correlation_factor: float

    @property
    def inflation(self) -> float:
        """Factor on the covariance of the estimates; never below 1."""
        return max(1.0, self.variance_ratio * self.correlation_factor)


def check_residuals(whitened: Array, leg: Index, rank: int) -> ResidualCheck:
    """Compare residuals with the assumed noise.

    Parameters
    ----------
    whitened : ndarray, shape (c, p)
        Residuals freed of the assumed noise covariance, pieces in driving order: independent
        and of unit variance if nothing but that noise is in them. What the model does not contain
        shows as size and as correlation between neighbouring pieces of a leg.
    leg : ndarray of int64, shape (p,)
    rank : int
        Number of estimated quantities.
    """
    square = float(np.mean(whitened**2))
    freedom = max(1.0, whitened.size - rank)
    total = 0.0
    for lag in range(1, min(MAX_LAG, len(leg) - 1)):
        same = leg[lag:] == leg[:-lag]
        if same.sum() < 20:
            break
        products = whitened[:, lag:][:, same] * whitened[:, :-lag][:, same]
        correlation = float(products.mean()) / max(square, 1e-300)
        if correlation < 0.05:
            break
        total += correlation
    return ResidualCheck(square * whitened.size / freedom, 1.0 + 2.0 * total)


FOLDS = 8


def leg_numbers(joint: JointSolution) -> list[Index]:
    """Number of the leg of every piece, shape (p,) for every run; further runs count on."""
    numbers, start = [], 0
    for solved in joint.runs:
        size = [high - low for low, high in solved.whitener.bounds]
        numbers.append(np.repeat(np.arange(start, start + len(size)), size))
        start += len(size)
    return numbers


def fold_of(number: Index) -> Index:
    """Fold of legs by their numbers; neighbouring ones go to different folds."""
    # laps of one line do not always share a fold
    return np.asarray((number * 5 + number // FOLDS) % FOLDS)
