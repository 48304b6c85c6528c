# SPDX-License-Identifier: Apache-2.0
"""Drawing of effects: shape and direction at random, of any size; ``trace`` scales them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from otf_core.blind.unknown_effects import UNKNOWN_EFFECTS
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.cross_coupling import POWERS
from otf_core.effects.state import probe_state
from otf_core.model.machine import AXES, Machine

Rng = np.random.Generator
Parameters = dict[str, float]

HARD_TO_SEE = (
    'tracker_scale', 'tracker_range_offset', 'tracker_angles', 'table_tilt', 'target_offset',
)  # fmt: skip
"""Effects that one run hardly shows, if at all."""
ANGLES = ('x1n', 'x2', 'x3', 'x5n9n', 'x5z7', 'x8x', 'x8y', 'x11a', 'x11b', 'x12a', 'x12b')


def _vector(rng: Rng, prefix: str, unit: float = 1e-6, most: int = 3) -> Parameters:
    """Random coefficients of one to ``most`` axes."""
    count = int(rng.integers(1, most + 1))
    axes = rng.choice(3, count, replace=False)
    values = rng.uniform(0.4, 1.0, count) * rng.choice([-1.0, 1.0], count)
    return {f'{prefix}_{AXES[a]}': float(unit * v) for a, v in zip(axes, values, strict=True)}


def _drift(rng: Rng, duration: float) -> Parameters:
    return {'tau': float(duration * np.exp(rng.uniform(np.log(0.15), np.log(4.0)))), 'order': 1.0}


def _held(rng: Rng) -> Parameters:
    return {'held': 1.0} if rng.random() < 0.5 else {}


def _directional(rng: Rng) -> Parameters:
    axis = AXES[rng.integers(3)]
    found = _held(rng)
    for motion in rng.choice([f'E{d}{axis}' for d in 'XYZABC'], int(rng.integers(1, 3)), False):
        own = motion[1] == motion[2]
        unit = 1e-6 if motion[1] in 'XYZ' else 4e-6
        for k in range(int(own), int(rng.integers(1, 4)) + 1):
            found[f'{motion}_{k}'] = float(unit * rng.normal())
    return found


def _coupling(rng: Rng) -> Parameters:
    names = []
    for product in POWERS:
        counts = [(AXES[a], product.count(a)) for a in sorted(set(product))]
        names.append(''.join(n + (str(c) if c > 1 else '') for n, c in counts))
    count = int(rng.integers(1, 3))
    return {
        f'{rng.choice(AXES)}_{rng.choice(names)}': float(1e-6 * rng.uniform(0.5, 1) * s)
        for s in rng.choice([-1.0, 1.0], count)
    }


def _between_nodes(rng: Rng, machine: Machine) -> Parameters:
    nodes = probe_state(machine).nodes
    found: Parameters = {'order': 2.0}
    for motion in rng.choice(['EXX', 'EYX', 'EZX', 'EYY', 'EXY', 'EZY', 'EZZ', 'EXZ', 'EYZ'],
                             int(rng.integers(1, 4)), False):  # fmt: skip
        at = nodes[motion[2]]
        wavelength = rng.uniform(1.0, 2.5) * (at[1] - at[0])
        phase = rng.uniform(0, 2 * np.pi)
        for low, high in pairwise(at):
            bow = np.sin(2 * np.pi * 0.5 * (low + high) / wavelength + phase) + 0.3 * rng.normal()
            found[f'{motion}@{low:.6g}..{high:.6g}'] = float(1e-6 * bow)
    return found


def _tilt(rng: Rng) -> Parameters:
    return {
        f'tilt_{rng.choice(["X", "Y"])}_by_{rng.choice(AXES)}': float(rng.choice([-1, 1]) * 2e-5)
    }


def _pose(rng: Rng, duration: float) -> Parameters:
    found = _drift(rng, duration)
    kind = rng.integers(3)
    if kind != 1:
        found |= _vector(rng, 'M')
    if kind != 0:
        found |= _vector(rng, 'W', 2e-6)
    return found


def _angles(rng: Rng) -> Parameters:
    names = rng.choice(ANGLES, int(rng.integers(1, 4)), False)
    return {str(n): float(2e-6 * rng.uniform(0.5, 1) * rng.choice([-1, 1])) for n in names}


def _noise(rng: Rng) -> Parameters:
    kind = rng.integers(3)
    if kind == 0:
        level = float(rng.uniform(1.7, 3.0))
        return {'level_range': level, 'level_angle': level}
    if kind == 1:
        return {'correlated_share': float(rng.uniform(0.85, 0.97)),
                'correlation_time': float(rng.uniform(0.8, 2.0))}  # fmt: skip
    return {'dof': 3.0, 'level_angle': 1.5, 'level_range': 1.5}


def _incidence(rng: Rng) -> Parameters:
    found = {'k': float(2e-5 * rng.choice([-1, 1]))}
    if rng.random() < 0.3:
        found |= {'k_u': float(5e-6 * rng.normal())}
    return found


def _cyclic(rng: Rng) -> Parameters:
    period = {'period': float(rng.choice([0.005, 0.008, 0.01, 0.012, 0.016, 0.02, 0.025]))}
    if rng.random() < 0.5:
        period = {'period': float(rng.uniform(0.006, 0.03))}
    return period | _vector(rng, 'S', most=2) | _vector(rng, 'C', most=2)


_KNOWN: dict[str, Callable[[Rng, Machine, float], Parameters]] = {
    'backlash': lambda g, m, t: _vector(g, 'B') | _held(g),
    'direction_dependent_tables': lambda g, m, t: _directional(g),
    'thermal_axis_expansion': lambda g, m, t: _drift(g, t) | _vector(g, 'S', 4e-6),
    'thermal_structure_drift': lambda g, m, t: _drift(g, t) | _vector(g, 'D'),
    'cross_coupling': lambda g, m, t: _coupling(g),
    'servo_mismatch': lambda g, m, t: _vector(g, 'T', 1e-5, most=2),
    'corner_rounding': lambda g, m, t: {'l': float(g.uniform(0.004, 0.03)), 'A': 1e-6},
    'cyclic_error': lambda g, m, t: _cyclic(g),
    'vibration': lambda g, m, t: (
        {'frequency': float(np.exp(g.uniform(np.log(1.5), np.log(45.0))))}
        | _vector(g, 'S') | _vector(g, 'C')
    ),
    'table_resolution': lambda g, m, t: _between_nodes(g, m),
    'table_tilt': lambda g, m, t: _tilt(g),
    'target_offset': lambda g, m, t: _vector(g, 'dT', 5e-3),
    'target_incidence': lambda g, m, t: _incidence(g),
    'tracker_pose_drift': lambda g, m, t: _pose(g, t),
    'tracker_scale': lambda g, m, t: {'m': float(g.choice([-1, 1]) * 4e-6)},
    'tracker_range_offset': lambda g, m, t: {'c': float(g.choice([-1, 1]) * 5e-6)},
    'tracker_angles': lambda g, m, t: _angles(g),
    'tracker_noise': lambda g, m, t: _noise(g),
}  # fmt: skip


def _unknown_shape(name: str, rng: Rng, duration: float) -> Parameters:
    shapes: dict[str, Parameters] = {
        'unknown_machine_step': {'t0': rng.uniform(0.15, 0.85) * duration},
        'unknown_tracker_step': {'t0': rng.uniform(0.15, 0.85) * duration},
        'unknown_slow_swing': {'period': rng.uniform(30, 120), 't0': rng.uniform(1, 60)},
        'unknown_play_taken_up': {'l': rng.uniform(0.01, 0.06)},
        'unknown_local_bump': {k: rng.uniform(0.2, 0.8) for k in 'xyz'}
        | {'width': rng.uniform(0.04, 0.12)},
        'unknown_stick_slip': {'period': rng.uniform(0.03, 0.12)},
        'unknown_ringing': {'f': rng.uniform(1.0, 4.0), 'tau': rng.uniform(0.3, 1.0)},
        'unknown_ball_passage': {'p': rng.uniform(0.004, 0.02)},
        'unknown_heat_plume': {k: rng.uniform(0.2, 0.8) for k in 'xyz'}
        | {'width': rng.uniform(0.05, 0.15)},
    }
    return {k: float(v) for k, v in shapes.get(name, {}).items()}


def draw_effect(name: str, machine: Machine, duration: float, rng: Rng) -> AppliedEffect:
    """Draw shape and direction of one effect.

    Parameters
    ----------
    name : str
        Of the registry or of ``UNKNOWN_EFFECTS``.
    machine : Machine
    duration : float, s
        Of the run.
    rng : numpy.random.Generator
    """
    if name in UNKNOWN_EFFECTS:
        unit = 2e-6 if name == 'unknown_tracker_step' else 1e-6
        parameters = _unknown_shape(name, rng, duration) | _vector(rng, 'A', unit)
        return AppliedEffect(UNKNOWN_EFFECTS[name], parameters)
    return AppliedEffect(REGISTRY[name], _KNOWN[name](rng, machine, duration))


def scaled(applied: AppliedEffect, factor: float) -> AppliedEffect:
    """Return the effect with all coefficients, but not its shape, multiplied."""
    own = applied.effect.shape_names
    parameters = {k: v if k in own else v * factor for k, v in applied.parameters.items()}
    return AppliedEffect(applied.effect, parameters)
