# SPDX-License-Identifier: Apache-2.0
"""Single samples of a solved run: their state, and what is left of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.effects import State
from otf_core.effects.state import state_on_path
from otf_core.model.courses import Courses
from otf_core.model.frames import RigidTransform
from otf_core.model.kinematics import displacement
from otf_core.model.path import Legs, leg_bounds
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Run

DETREND_ORDER = 3


@dataclass(frozen=True)
class SampleResiduals:
    """Samples in the pieces of a run.

    Attributes
    ----------
    leg : ndarray of int64, shape (n,)
    state : State
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
    samples, legs, index = run.samples, Legs(run.shape.corners), run.pieces.samples
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
    run : Run
    pose : RigidTransform
        Tracker to machine, as solved.
    tables : ErrorTables
    nodes : mapping of axis to ndarray, m
    """
    state = sample_state(run, pose, tables, nodes)
    leg = run.pieces.leg[run.pieces.piece]
    points = pose.apply(run.samples.xyz[run.pieces.samples])
    offset = points - state.q - displacement(tables, state.q)
    offset -= np.einsum('ij,ij->i', offset, state.direction)[:, None] * state.direction
    return SampleResiduals(leg, state, detrend_legs(offset, leg))
