# SPDX-License-Identifier: Apache-2.0
"""Effects in the simulation: displacement of every sample, and noise other than specified."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.effects import AppliedEffect, Shape, State
from otf_core.effects.catalogue.tracker_noise import SPECIFIED, TrackerNoise
from otf_core.effects.state import state_on_path
from otf_core.errors import ConfigError
from otf_core.model.courses import Courses
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.nodes import axis_nodes
from otf_core.model.path import MIN_LEG, NominalPath
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import NoiseComponent, NoiseModel
from otf_core.sim.drive import Drive

IMPLAUSIBLE = 0.01
"""m; no effect displaces the target by more."""


def _straight_legs(path: NominalPath) -> NDArray[np.int64]:
    """Leg between true corners that each leg of a path lies on, shape (n - 1,).

    A repeated point is part of the leg that led to it.
    """
    _, index = path.corners()
    number = np.arange(len(path.leg_lengths))
    leg = np.clip(np.searchsorted(index, number, side='right') - 1, 0, len(index) - 2)
    moves = path.leg_lengths > MIN_LEG
    last = np.maximum.accumulate(np.where(moves, number, -1))
    first = int(np.flatnonzero(moves)[0])
    return np.asarray(leg[np.where(last < 0, first, last)])


def run_state(
    machine: Machine,
    plan: Plan,
    drive: Drive,
    time: Array,
    clock: Array,
    pose: RigidTransform,
    tables: ErrorTables,
    signals: Courses | None = None,
) -> State:
    """Describe every sample of a simulated run.

    Parameters
    ----------
    time, clock : ndarray, shape (n,), s
        Since the start, true and by the clock of the tracker: effects go by the latter, as it
        is the only one that a recording knows.
    pose : RigidTransform
        Tracker to machine.
    tables : ErrorTables
        Errors of the truth machine.
    signals : Courses, optional
        Recorded beside the samples.

    Returns
    -------
    State
        While standing, the direction is that of the leg just driven.
    """
    leg, speed = drive.leg_and_speed(time)
    return state_on_path(
        machine,
        plan.path.corners()[0],
        _straight_legs(plan.path)[leg],
        drive.position(time),
        speed,
        clock,
        pose,
        {a: axis_nodes(axis) for a, axis in machine.axes.items()},
        tables,
        float(clock[-1]),
        signals=signals,
    )


def total_displacement(state: State, effects: Sequence[AppliedEffect]) -> Array:
    """Sum of the displacements, shape (n, 3), m.

    Raises
    ------
    ConfigError
        If parameters are unknown, or so large that their unit must be wrong.
    """
    total = np.zeros((len(state), 3))
    for one in effects:
        moved = one.effect.displacement(state, one.parameters)
        largest = float(np.abs(moved).max(initial=0.0))
        if not largest <= IMPLAUSIBLE:
            raise ConfigError(
                f'{one.effect.name}: displaces the target by {largest:.3g} m; parameters are in '
                f'SI units: {_stated(one, state)}'
            )
        total += moved
    return total


def _stated(one: AppliedEffect, state: State) -> str:
    units = one.effect.units(state, one.parameters)
    return ', '.join(f'{n} = {v:g} {units[n]}'.rstrip() for n, v in one.parameters.items())


def changed_noise(noise: NoiseModel, effects: Sequence[AppliedEffect]) -> NoiseModel:
    """Noise once tracker_noise has acted on it; the last one counts."""
    model = noise
    for one in effects:
        if isinstance(one.effect, TrackerNoise):
            shape = one.effect.complete_shape(one.parameters)
            factors = (shape['level_range'], *[shape['level_angle']] * 2)
            parts = (_changed(c, f, shape) for c, f in zip(noise, factors, strict=True))
            model = NoiseModel(*parts)
    return model


def _changed(noise: NoiseComponent, factor: float, shape: Shape) -> NoiseComponent:
    """One component with another level; share, time and tails where they are stated."""
    stated = {name: shape[name] for name in shape if shape[name] != SPECIFIED}
    level, white = factor * noise.level, factor * noise.white
    if 'correlated_share' in stated:
        white = level * math.sqrt(1.0 - stated['correlated_share'])
    time = stated.get('correlation_time', noise.correlation_time)
    return NoiseComponent(level, white, time, stated.get('dof', noise.dof))
