# SPDX-License-Identifier: Apache-2.0
"""Effects that only machines with rotary axes have.

J_m is the displacement of the target per unit of motion m, J_a that per rad of the angular
positioning of axis a, in the frame of the link that carries the tracker. Descriptions of effects
stand in words.yaml.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from otf_core.arrays import Array
from otf_core.effects import drift
from otf_core.effects.base import Coefficients, Effect, ShapeParameter, Size, no_terms, vector_size
from otf_core.effects.catalogue.machine import amplitudes
from otf_core.effects.catalogue.tracker import incidence
from otf_core.effects.terms import POSITIONING, Shape, State, Terms
from otf_core.model.frames import XYZ
from otf_core.model.machine import BED, TABLE, Machine
from otf_core.model.motions import DIRECTIONS

of_rotary_axes = partial(Effect, of_rotary_axes=True)

PER_TURN = 'per_turn'
HIGHEST = 180
"""Waves per turn that are tried at most."""
NODES_PER_WAVE = 4
"""Longer waves are errors at the nodes of a table, which leaves next to nothing of them."""


def _waves_per_turn(state: State) -> Sequence[Shape]:
    """Every whole number of waves per turn that tables cannot follow."""
    axes = state.machine.axes
    pitch = min((axes[n].table_pitch for n in state.machine.rotary_names), default=np.pi)
    lowest = max(2, math.ceil(2.0 * np.pi / (NODES_PER_WAVE * pitch)))
    return tuple({PER_TURN: float(n)} for n in range(lowest, HIGHEST + 1))


@partial(
    of_rotary_axes,
    shape=(ShapeParameter(PER_TURN, ''),),
    shapes=_waves_per_turn,
    sizes=lambda fitted: amplitudes(fitted, 'of', 'rad', f'{fitted.shape[PER_TURN]:.0f} per turn'),
    stays_in_place=True,
    held_by_tables=True,
)
def rotary_cyclic_error(state: State, shape: Shape) -> Terms:
    """(S_a sin(n q_a) + C_a cos(n q_a)) J_a of every rotary axis a.

    n is the number of turns of the worm or of the gear stage per turn of the table, its teeth, or
    a harmonic of the encoder. Points that stand for a stretch of the path have the mean over it.
    """
    turning, axes, n = state.turning, state.machine.rotary_names, shape[PER_TURN]
    phase = n * state.q
    held = np.ones_like(phase)
    if turning is not None:  # mean over what is passed at an even speed
        held = np.sinc(np.sqrt(3.0) * n * turning.spread / np.pi)
    places = [state.machine.column(a) for a in axes]
    columns = [state.by_axes(held * wave)[:, :, places] for wave in (np.sin(phase), np.cos(phase))]
    names = [f'{part}_{a}' for part in 'SC' for a in axes]
    return Terms.of(names, 'rad', np.concatenate(columns, axis=2), axes * 2)


LEVEL = 0.9
"""Component along Z from which an axis is upright: gravity has no torque about it."""
DOWN = np.array([0.0, 0.0, -1.0])


def tilting_axes(machine: Machine) -> tuple[str, ...]:
    """Rotary axes on the side of the table that gravity can twist."""
    own = (a for a in machine.chain.table_side if machine.axes[a].rotary)
    return tuple(a for a in own if abs((machine.axes[a].direction or (0, 0, 1))[2]) < LEVEL)


def _largest_twists(fitted: Coefficients) -> tuple[Size, ...]:
    along = 'under a load along'
    return tuple(
        vector_size(
            fitted, [{f'L_{k}_{a}': 1.0} for k in XYZ], 'rad', 'largest twist', f'of {a}', along
        )
        for a in fitted.axes
    )


@partial(of_rotary_axes, sizes=_largest_twists)
def load_tilt(state: State, shape: Shape) -> Terms:
    """L_k (n_a . (e_k(q) x g)) J_a: L_X_a, L_Y_a, L_Z_a of every tilting axis a.

    e_k is a unit vector of the table as it lies now, g the direction of gravity, -Z of the
    machine, n_a the direction of the tilting axis. The torque of a load depends on the angles of
    both axes; what depends on the tilting axis alone is in its tables.
    """
    machine, turning = state.machine, state.turning
    axes = tilting_axes(machine)
    columns = np.zeros((len(state), 3, 3 * len(axes)))
    if turning is not None and machine.tracker.link == BED:
        links = np.array([t.link == TABLE for t in machine.targets.values()])
        on_table = np.asarray(links[turning.target])[:, None]
        for number, axis in enumerate(axes):
            direction = np.array(machine.axes[axis].direction)
            arm = np.einsum('i,nij->nj', np.cross(DOWN, direction), turning.link) * on_table
            influence = turning.motions[:, :, machine.column(axis), POSITIONING[axis]]
            columns[:, :, 3 * number : 3 * number + 3] = influence[:, :, None] * arm[:, None]
    names = [f'L_{k}_{a}' for a in axes for k in XYZ]
    return Terms.of(names, 'rad', columns, [a for a in axes for _ in XYZ])


ACROSS = {'A': 'BC', 'B': 'AC', 'C': 'AB'}


def tilted_axis(machine: Machine) -> tuple[str, str] | None:
    """Rotary axis that another one tilts, and that one; None where there is none."""
    table = [a for a in machine.chain.table_side if machine.axes[a].rotary]
    target = [a for a in machine.chain.target_side if machine.axes[a].rotary]
    if len(table) == 2:
        return table[0], table[1]  # the table's own comes first, it is carried by the second
    return (target[1], target[0]) if len(target) == 2 else None


def _strongest_tilt(fitted: Coefficients) -> tuple[Size, ...]:
    motion = fitted.strongest.split('_')[1]
    parts = ({f'S_{motion}': 1.0}, {f'C_{motion}': 1.0})
    pair = tilted_axis(fitted.machine)
    other = f'{pair[1]} at ' if pair else ''
    return (Size(f'of {motion}', parts, 'rad', f'amplitude with {other}90 deg'),)


@partial(of_rotary_axes, sizes=_strongest_tilt, stays_in_place=True)
def bearing_tilt(state: State, shape: Shape) -> Terms:
    """sin(q_b) (S_m sin(q_a) + C_m cos(q_a)) J_m, m the tilts of axis a across its direction.

    b is the rotary axis that tilts a. A tilt that depends on q_b alone moves all that is on axis a
    alike: it is in the tables of b.
    """
    machine, turning = state.machine, state.turning
    pair = tilted_axis(machine)
    if turning is None or pair is None:
        return no_terms(state, shape)
    axis, other = pair
    own, by = state.q[:, machine.column(axis)], np.sin(state.q[:, machine.column(other)])
    names, columns = [], []
    for letter in ACROSS[axis]:
        influence = turning.motions[:, :, machine.column(axis), DIRECTIONS.index(letter)]
        for part, wave in (('S', np.sin(own)), ('C', np.cos(own))):
            names.append(f'{part}_E{letter}{axis}')
            columns.append(influence * (by * wave)[:, None])
    return Terms.of(names, 'rad', np.stack(columns, axis=2), (axis,) * len(names))


LATEST = 0.95
"""Share of the run after which a first pass leaves no time to grow."""


def _courses_since_first_pass(state: State) -> Sequence[Shape]:
    """Courses in time from the first sample that a rotary axis moves."""
    since = 0.0
    if state.turning is not None:
        places = [state.machine.column(a) for a in state.machine.rotary_names]
        acts = state.turning.motions[:, :, places, :3].any(axis=(1, 2, 3))
        first = float(state.time[acts].min(initial=state.end))
        since = first if first < LATEST * state.end else 0.0
    return [{**shape, 'since': since} for shape in drift.drift_shapes(state)]


def _shifts_of_lines(fitted: Coefficients) -> tuple[Size, ...]:
    """Shift of every axis that takes part, while its reflectors were in view."""
    since, until = (fitted.shape.get(n, 0.0) for n in ('since', 'until'))
    within = f'within {(until - since) / 60.0:.0f} min, from its first pass on'
    remark = within if since and until else drift.REACHED
    return tuple(
        vector_size(
            fitted,
            [drift.value_reached(f'D_{k}_{a}', fitted.shape) for k in XYZ],
            'm',
            remark,
            f'of {a}',
        )
        for a in fitted.axes
    )


@partial(
    drift.drifting,
    of_rotary_axes=True,
    shape=(*drift.SHAPE, ShapeParameter('since', 's', 0.0)),
    shapes=_courses_since_first_pass,
    sizes=_shifts_of_lines,
)
def centre_growth(state: State, shape: Shape) -> Terms:
    """D_k_a g(t) J_ka: the line of axis a shifts along k of what carries it, zero at ``since``.

    ``since`` is when the first reflector that the axis moves came into view. What the line had
    shifted before is in the location errors.
    """
    axes = state.machine.rotary_names
    shifts = np.zeros((len(state), 3, 3 * len(axes)))
    if state.turning is not None:
        places = [state.machine.column(a) for a in axes]
        shifts = state.turning.motions[:, :, places, :3].reshape(len(state), 3, -1)
    names = [f'D_{k}_{a}' for a in axes for k in XYZ]
    base = Terms.of(names, 'm', shifts, [a for a in axes for _ in XYZ])
    return drift.over_time(state, shape, base)


STANDS = 1e-6
"""rad/s; a slower axis is clamped."""


def _largest_change(fitted: Coefficients) -> tuple[Size, ...]:
    motion = fitted.strongest.split('_')[1]
    unit = 'm' if motion[1] in 'XYZ' else 'rad'
    return (Size(f'of {motion}', ({fitted.strongest: 1.0},), unit, 'when clamped'),)


@partial(of_rotary_axes, sizes=_largest_change)
def axis_clamping(state: State, shape: Shape) -> Terms:
    """K_m J_m while the axis stands, m its six motions: K_EXa to K_ECa of every rotary axis a."""
    axes, turning = state.machine.rotary_names, state.turning
    names = tuple(f'K_E{d}{a}' for a in axes for d in POSITIONING)
    units = tuple('m' if d in 'XYZ' else 'rad' for _ in axes for d in POSITIONING)
    columns = np.zeros((len(state), 3, len(names)))
    if turning is not None:
        places = [state.machine.column(a) for a in axes]
        stands = np.abs(turning.rates[:, places]) < STANDS
        own = turning.motions[:, :, places] * stands[:, None, :, None]
        columns = own.reshape(len(state), 3, -1)
    return Terms(names, units, tuple(a for a in axes for _ in POSITIONING), columns)


PART = 'part'


def _parts_used_again(state: State) -> Sequence[Shape]:
    """Parts whose target was used before."""
    if state.turning is None:
        return ()
    parts = np.unique(state.turning.part[state.turning.again > 0])
    return tuple({PART: float(k + 1)} for k in parts)


def _shift_in_part(fitted: Coefficients) -> tuple[Size, ...]:
    remark = f'in part {fitted.shape[PART]:.0f}'
    return (vector_size(fitted, [{f'P_{k}': 1.0} for k in XYZ], 'm', remark),)


@partial(
    of_rotary_axes,
    shape=(ShapeParameter(PART, ''),),
    shapes=_parts_used_again,
    sizes=_shift_in_part,
    own_per_run=True,
)
def reseated_target(state: State, shape: Shape) -> Terms:
    """R (P_X, P_Y, P_Z) in one part whose target was used before, R the rotation of its link."""
    columns = np.zeros((len(state), 3, 3))
    if state.turning is not None:
        own = state.turning.part == round(shape[PART]) - 1
        columns[own] = state.turning.link[own]
    return Terms.of([f'P_{k}' for k in XYZ], 'm', columns)


SHOWN = np.radians(25.0)
"""rad; angle at which the size is stated."""


def _across(vectors: Array, axis: Array) -> Array:
    """Parts of vectors (n, 3) across unit vectors (n, 3)."""
    return np.asarray(vectors - np.einsum('ni,ni->n', vectors, axis)[:, None] * axis)


@partial(
    of_rotary_axes,
    sizes=lambda fitted: (Size('along the beam', ({'k': float(SHOWN**2)},), 'm', 'at 25 deg'),),
)
def facing_incidence(state: State, shape: Shape) -> Terms:
    """(k i^2 + k_u i_u + k_w i_w) e_R in the frame of a reflector that turns with its link.

    Its axis looked to the tracker when its part began; where it really looked elsewhere, the
    linear terms hold that, for every target its own: k_u_t and k_w_t.
    """
    known = list(state.machine.targets)
    names = ('k', *(f'{part}_{t}' for t in known for part in ('k_u', 'k_w')))
    columns = np.zeros((len(state), 3, len(names)))
    turning = state.turning
    if turning is not None:
        beam = state.beam / np.linalg.norm(state.beam, axis=1, keepdims=True)
        axis = turning.facing
        across, other = (_across(turning.link[:, :, k], axis) for k in (0, 1))
        flat = np.linalg.norm(across, axis=1, keepdims=True) < 0.1
        across = np.where(flat, other, across)
        across = across / np.linalg.norm(across, axis=1, keepdims=True)
        square, u, w = incidence(beam, axis, across, np.cross(axis, across))
        columns[:, :, 0] = beam * square[:, None]
        for number in range(len(known)):
            own = turning.target == number
            columns[own, :, 1 + 2 * number] = beam[own] * u[own, None]
            columns[own, :, 2 + 2 * number] = beam[own] * w[own, None]
    units = ('m/rad^2', *('m/rad',) * (2 * len(known)))
    return Terms(names, units, ('',) * len(names), columns)
