# SPDX-License-Identifier: Apache-2.0
"""Effects in the simulation: displacement of every sample, and noise other than specified."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.effects import AppliedEffect, Shape, State
from otf_core.effects.catalogue.tracker import SPECIFIED, tracker_noise
from otf_core.effects.state import lap_numbers, state_in_parts
from otf_core.errors import ConfigError
from otf_core.model.frames import RigidTransform
from otf_core.model.nodes import axis_nodes
from otf_core.model.path import sides_of_travel
from otf_core.model.signals import Courses
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import NoiseComponent, NoiseModel
from otf_core.sim.drive import Drive

IMPLAUSIBLE = 0.01
"""m; no effect displaces the target by more."""


def run_state(
    drives: Sequence[Drive],
    number: int,
    time: Array,
    clock: Array,
    tables: ErrorTables,
    places: Mapping[str, Array],
    pose: RigidTransform,
    duration: float = 0.0,
    signals: Courses | None = None,
) -> State:
    """Describe samples of one part of a simulated run.

    Parameters
    ----------
    number : int
        Of the part.
    time : ndarray, shape (n,), s
        Since the start of the part.
    clock : ndarray, shape (n,), s
        Since the start of the run by the clock of the tracker: effects go by it, as it is the
        only one that a recording knows.
    tables : ErrorTables
        Errors of the truth machine.
    places : mapping of target to ndarray, shape (3,), m
    pose : RigidTransform
        Tracker to the link that it stands on.
    signals : Courses, optional
        Recorded beside the samples.

    Returns
    -------
    State
        While standing, the direction is that of the leg just driven.
    """
    machine, drive = tables.machine, drives[number]
    now, unit, corners = drive.motion(time), drive.unit, drive.corners
    lines = sum(len(d.corners) - 1 for d in drives[:number])
    state = state_in_parts(
        machine,
        [d.part.target for d in drives],
        places,
        np.full(len(time), number),
        lines + now.line,
        now.q,
        now.rates,
        sides_of_travel(unit)[now.leg],
        clock,
        pose,
        {a: axis_nodes(axis) for a, axis in machine.axes.items()},
        tables,
        duration,
    )
    before, after = corners[now.line] - 1, corners[now.line + 1]
    history = {
        **state.more,
        'acceleration': np.gradient(state.speed, time) if len(time) > 1 else np.zeros(len(time)),
        'lap': lap_numbers(drive.part.path.positions[corners])[now.line],
    }
    return replace(
        state,
        direction=unit[now.leg],
        from_corner=now.from_corner,
        to_corner=now.to_corner,
        before=unit[np.maximum(before, 0)],
        after=unit[np.minimum(after, len(unit) - 1)],
        more=history if signals is None else signals.beside(history),
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
        if one.effect is tracker_noise:
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
