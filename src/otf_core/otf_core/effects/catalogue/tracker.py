# SPDX-License-Identifier: Apache-2.0
"""Effects of the target and of the tracker.

r is the beam from the tracker to the target, R, H, V its length, azimuth and zenith angle, e_R,
e_H, e_V unit vectors in the direction of their increase. The description of an effect stands in
words.yaml.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from otf_core.arrays import Array
from otf_core.effects import drift
from otf_core.effects.action import rigid_tracker, turns, vector
from otf_core.effects.base import (
    Coefficients,
    Contribution,
    Effect,
    ShapeParameter,
    Size,
    no_terms,
    vector_size,
)
from otf_core.effects.free import Free
from otf_core.effects.terms import BelongsTo, Shape, State, Terms
from otf_core.model.frames import XYZ


@partial(
    Effect,
    sizes=lambda fitted: (vector_size(fitted, [{f'dT_{a}': 1.0} for a in XYZ], 'm', ''),),
    contributions=(Contribution('target offset', ('target_offset',)),),
)
def target_offset(state: State, shape: Shape) -> Terms:
    """Sum over the axes of r_a(q_a) x dT, with the rotations r_a of the error tables.

    dT is the wrong part of the offset; without tables it is zero.
    """
    rotation = np.zeros((len(state.q), 3))
    if state.tables is not None:
        for k, letter in enumerate('ABC'):
            for a, axis in enumerate(state.machine.axis_names):
                rotation[:, k] += state.tables.motions[f'E{letter}{axis}'].at(state.q[:, a])
    columns = np.stack([np.cross(rotation, e) for e in np.eye(3)], axis=2)
    return Terms.of([f'dT_{a}' for a in XYZ], 'm', columns)


def incidence(beam: Array, axis: Array, across: Array, up: Array) -> tuple[Array, Array, Array]:
    """i^2, i_u and i_w of the angle i between beam and axis of a target, each shape (n,).

    Parameters
    ----------
    beam : ndarray, shape (n, 3)
        Unit vectors from the tracker to the target.
    axis, across, up : ndarray, shape (n, 3)
        Unit vectors: the axis of the target, and two directions across it.
    """
    towards, u, w = (-np.einsum('ni,ni->n', beam, e) for e in (axis, across, up))
    off = np.hypot(u, w)
    angle = np.arctan2(off, towards)
    scale = np.where(off > 1e-12, angle / np.maximum(off, 1e-12), 1.0)
    return angle**2, scale * u, scale * w


@partial(Effect)
def target_incidence(state: State, shape: Shape) -> Terms:
    """(k i^2 + k_u i_u + k_w i_w) e_R, i the angle of incidence, its parts to the side and up.

    The target keeps its orientation in the machine frame and looks to the tracker from the middle
    of the volume; a misaligned target, offset i0, is the linear terms:
    k |i - i0|^2 = k i^2 - 2 k i0 . i + constant.
    """
    machine = state.machine
    beam = state.beam / np.linalg.norm(state.beam, axis=1, keepdims=True)
    axis = state.q - state.beam - 0.5 * (machine.lower + machine.upper)
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    up = np.broadcast_to(state.R_machine_tracker[:, 2], axis.shape)
    if np.min(np.linalg.norm(np.cross(up, axis), axis=1)) < 1e-6:
        up = np.broadcast_to(state.R_machine_tracker[:, 0], axis.shape)
    side = np.cross(up, axis)
    side = side / np.linalg.norm(side, axis=1, keepdims=True)
    factors = np.stack(incidence(beam, axis, side, np.cross(axis, side)), axis=1)
    columns = beam[:, :, None] * factors[:, None, :]
    return Terms(('k', 'k_u', 'k_w'), ('m/rad^2', 'm/rad', 'm/rad'), ('',) * 3, columns)


def _shift_and_turn(fitted: Coefficients) -> tuple[Size, ...]:
    """Shift and turn, the one that displaces more first."""
    shifts, turned = (
        [drift.value_reached(f'{part}_{a}', fitted.shape) for a in XYZ] for part in 'MW'
    )
    shift = vector_size(fitted, shifts, 'm', drift.REACHED, 'shifting')
    turn = vector_size(fitted, turned, 'rad', drift.REACHED, 'turning', 'about')
    return (turn, shift) if fitted.strongest.startswith('W') else (shift, turn)


@partial(
    drift.drifting,
    sizes=_shift_and_turn,
    any_axes=True,
    follows=(rigid_tracker,),
    switches=(rigid_tracker,),
    free=(
        Free(
            ('time',),
            (10,),
            'the drift does not follow an exponential in time',
            (1,),
            rigid_tracker,
            zero_at=-1.0,
        ),
    ),
)
def tracker_pose_drift(state: State, shape: Shape) -> Terms:
    """(M + W x r) g(t): shift and turn about the tracker at ``until``, machine axes."""
    shift = Terms.of([f'M_{a}' for a in XYZ], 'm', vector(state, shape).columns)
    return Terms.joined(*(drift.over_time(state, shape, p) for p in (shift, turns(state.beam))))


PER_KELVIN = 0.93e-6
PER_PASCAL = 2.7e-9
"""Relative change of a length measured in air, per K and per Pa: the refractivity
n - 1 = 2.72e-4 (20 degC, 1013.25 hPa) is proportional to the density of air, so its relative
change is 1 / 293.15 per K and 1 / 101325 per Pa (Ciddor, Applied Optics 35 (1996) 1566; Edlen's
equation as modified by Birch and Downs, Metrologia 31 (1994) 315, gives the same)."""


def _air(terms: Terms, state: State, given: Sequence[float]) -> Array:
    """Standard uncertainty from those of temperature and pressure of the air."""
    level = float(np.hypot(given[0] * PER_KELVIN, given[1] * PER_PASCAL))
    return np.full(len(terms.names), level)


@partial(
    Effect,
    sizes=lambda fitted: (Size('', ({'m': 1.0},), 'm/m'),),
    contributions=(
        Contribution('tracker scale', ('tracker_scale',)),
        Contribution('air', ('air_temperature', 'air_pressure'), size=_air),
    ),
    any_axes=True,
)
def tracker_scale(state: State, shape: Shape) -> Terms:
    """All ranges too long in the same proportion m: m r."""
    return Terms.of(['m'], 'm/m', state.beam[:, :, None])


@partial(
    Effect,
    sizes=lambda fitted: (Size('', ({'c': 1.0},), 'm'),),
    contributions=(Contribution('tracker range offset', ('tracker_range_offset',)),),
    any_axes=True,
)
def tracker_range_offset(state: State, shape: Shape) -> Terms:
    """All ranges too long by the same amount c: c e_R."""
    column = state.beam / np.linalg.norm(state.beam, axis=1, keepdims=True)
    return Terms.of(['c'], 'm', column[:, :, None])


@dataclass(frozen=True)
class Beam:
    """The beam in the tracker's own spherical coordinates.

    Azimuth H counts about the third axis of the tracker frame from its first, zenith angle V from
    the third axis down.

    Attributes
    ----------
    distance : ndarray, shape (n,), m
    sin_h, cos_h, sin_v, cos_v : ndarray, shape (n,)
    e_r, e_h, e_v : ndarray, shape (n, 3)
        Unit vectors in the machine frame.
    """

    distance: Array
    sin_h: Array
    cos_h: Array
    sin_v: Array
    cos_v: Array
    e_r: Array
    e_h: Array
    e_v: Array


def beam_of(state: State) -> Beam:
    """Return the beam of every point; straight up or down the azimuth counts as zero."""
    own = state.beam @ state.R_machine_tracker
    distance = np.linalg.norm(own, axis=1)
    level = np.hypot(own[:, 0], own[:, 1])
    upright = level < 1e-9 * distance
    safe = np.where(upright, 1.0, level)
    cos_h = np.where(upright, 1.0, own[:, 0] / safe)
    sin_h = np.where(upright, 0.0, own[:, 1] / safe)
    sin_v, cos_v = level / distance, own[:, 2] / distance
    e_h = np.stack([-sin_h, cos_h, np.zeros_like(sin_h)], axis=1)
    e_v = np.stack([cos_v * cos_h, cos_v * sin_h, -sin_v], axis=1)
    turn = state.R_machine_tracker.T
    e_r = state.beam / distance[:, None]
    return Beam(distance, sin_h, cos_h, sin_v, cos_v, e_r, e_h @ turn, e_v @ turn)


OFFSETS = ('x1n', 'x1z', 'x2', 'x3')
NO_EFFECT = 1e-9
"""Displacement per unit of a parameter, relative to the largest possible, that is rounding."""


def _along_unit_vectors(beam: Beam) -> dict[str, tuple[Array, Array, Array]]:
    """Displacement along e_H, e_V and e_R per unit of each parameter."""
    r, sin_h, cos_h, sin_v, cos_v = beam.distance, beam.sin_h, beam.cos_h, beam.sin_v, beam.cos_v
    zero, one, level = np.zeros_like(r), np.ones_like(r), r * sin_v
    return {
        'x1n': (sin_v, cos_v, zero),
        'x1z': (cos_v, -sin_v, zero),
        'x2': (zero, cos_v, sin_v),
        'x3': (one, zero, zero),
        'x4': (zero, r, zero),
        'x5n9n': (zero, r * cos_v, zero),
        'x5z9z': (zero, -r * sin_v, zero),
        'x5z7': (r * cos_v, zero, zero),
        'x6': (2.0 * r, zero, zero),
        'x8x': (-level * sin_h, zero, zero),
        'x8y': (level * cos_h, zero, zero),
        'x11a': (level * (cos_h**2 - sin_h**2), zero, zero),
        'x11b': (level * 2.0 * sin_h * cos_h, zero, zero),
        'x12a': (zero, r * (cos_v**2 - sin_v**2), zero),
        'x12b': (zero, r * 2.0 * sin_v * cos_v, zero),
    }


def _shared_equally(terms: Terms, state: State, given: Sequence[float]) -> Array:
    """Standard uncertainties that together make the declared offset a and angle b.

    Makers specify the error across the beam as a + b R. The parameters each take an equal share
    of it in mean square over the pieces: the offsets of a, the angles of b R.
    """
    offset, angle = given
    distance = np.linalg.norm(state.beam, axis=1)
    beam = state.beam / distance[:, None]
    along = np.einsum('ij,ijk->ik', beam, terms.columns)
    beside = terms.columns - beam[:, :, None] * along[:, None, :]
    size = np.sqrt(np.mean(np.sum(beside**2, axis=1), axis=0))
    is_offset = np.array([unit == 'm' for unit in terms.units])
    wanted = np.where(is_offset, offset, angle * np.sqrt(np.mean(distance**2)))
    # what displaces nothing on this path, but for rounding, has no share
    acts = size > NO_EFFECT * np.where(is_offset, 1.0, np.sqrt(np.mean(distance**2)))
    share = np.where(is_offset, (acts & is_offset).sum(), (acts & ~is_offset).sum())
    size, share = np.where(acts, size, np.inf), np.maximum(share, 1)
    # in each of the two directions across the beam: hence the factor 2
    return np.asarray(wanted * np.sqrt(2.0 / share) / size)


@partial(
    Effect,
    contributions=(
        Contribution('tracker angles', ('tracker_offset', 'tracker_angle'), size=_shared_equally),
    ),
    any_axes=True,
)
def tracker_angles(state: State, shape: Shape) -> Terms:
    """R sinV dH e_H + R dV e_V + dR e_R: x1n ... x12b, offsets in m, all others in rad.

    Encoder eccentricity and waves, index, tilt of the axes, beam and transit offsets: one family
    that single stations cannot tell apart, one face. dH, dV and dR stand in words.yaml.
    """
    beam = beam_of(state)
    parts = _along_unit_vectors(beam)
    columns = [
        h[:, None] * beam.e_h + v[:, None] * beam.e_v + r[:, None] * beam.e_r
        for h, v, r in parts.values()
    ]
    units = tuple('m' if n in OFFSETS else 'rad' for n in parts)
    return Terms(tuple(parts), units, ('',) * len(parts), np.stack(columns, axis=2))


SPECIFIED = -1.0
"""Stands for the value that the simulation has anyway."""


def _departure(fitted: Coefficients) -> tuple[Size, ...]:
    """Level where it departs, else time constant, else degrees of freedom."""
    levels = {n: v for n, v in fitted.shape.items() if n.startswith('level_')}
    if levels:
        name = max(levels, key=levels.__getitem__)
        of = f'of the {name.removeprefix("level_")}'
        return (Size(of, (), '', 'times as specified', levels[name]),)
    if 'correlation_time' in fitted.shape:
        value = fitted.shape['correlation_time']
        return (Size('', (), 's', 'time over which it is correlated', value),)
    return (Size('', (), '', 'degrees of freedom of its tails', fitted.shape['dof']),)


@partial(
    Effect,
    shape=(
        ShapeParameter('level_range', '', 1.0, (0.0, 1e3)),
        ShapeParameter('level_angle', '', 1.0, (0.0, 1e3)),
        ShapeParameter('correlated_share', '', SPECIFIED, (0.0, 1.0)),
        ShapeParameter('correlation_time', 's', SPECIFIED, (1e-3, 100.0)),
        ShapeParameter('dof', '', SPECIFIED, (2.1, 1e6)),
    ),
    sizes=_departure,
    belongs_to=BelongsTo.NOISE,
    any_axes=True,
)
def tracker_noise(state: State, shape: Shape) -> Terms:
    """No displacement: it changes the noise that the simulated tracker adds.

    Range noise has the standard deviation level_range * u_range, both angles
    level_angle * u_angle; the share correlated_share of the variance is a first-order Gauss-Markov
    process of time constant correlation_time; the rest is white, with Student's t of ``dof``
    degrees of freedom and the same variance if dof is given.
    """
    return no_terms(state, shape)
