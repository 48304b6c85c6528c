# SPDX-License-Identifier: Apache-2.0
"""Effects of the machine: drives, slides, tables and structure.

e_a is the unit vector of axis a, d the travel direction, u positions scaled to [-1, 1] over the
axis range, J_m the displacement per unit of motion m. Every formula is the displacement of the
measured point; its description stands in words.yaml.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from itertools import combinations, pairwise

import numpy as np
from numpy.polynomial import legendre

from otf_core.arrays import Array
from otf_core.effects import drift
from otf_core.effects.action import turned_about_zero_by_axis, turned_by_axis, vector
from otf_core.effects.base import (
    Coefficients,
    Contribution,
    Effect,
    ShapeParameter,
    Size,
    Wave,
    vector_size,
)
from otf_core.effects.free import Free
from otf_core.effects.inputs import harmonics
from otf_core.effects.terms import BelongsTo, Shape, State, Terms
from otf_core.errors import ConfigError
from otf_core.model.chain import Sight
from otf_core.model.frames import XYZ
from otf_core.model.machine import BED, Axis, Machine
from otf_core.model.motions import DIRECTIONS, ErrorMotion, unit_of
from otf_core.model.path import MOVING

HELD = 'held'
"""Shape parameter: 1 if an axis that stands stays on the side of its last travel, else 0."""


def travel_sign(state: State, shape: Shape) -> Array:
    """Sign of travel of each axis, shape (n, 3); where it stands that of its last, or 0."""
    if shape[HELD] > 0.5:
        return state.side
    return np.where(np.abs(state.direction) > MOVING, np.sign(state.direction), 0.0)


def _own(inputs: tuple[str, ...], orders: tuple[int, ...], words: str) -> Free:
    return Free(inputs, orders, words, belongs_to=BelongsTo.EFFECTS)


def _reversal_values(fitted: Coefficients) -> tuple[Size, ...]:
    axes = fitted.machine.axes
    return tuple(Size(f'of {a}', ({f'B_{a}': 1.0},), axes[a].unit) for a in fitted.axes)


@partial(
    Effect,
    shape=(ShapeParameter(HELD, '', 0.0),),
    shapes=lambda state: ({HELD: 0.0}, {HELD: 1.0}),
    sizes=_reversal_values,
    belongs_to=BelongsTo.REVERSAL,
    any_axes=True,
    free=(
        Free(
            ('time',),
            (4,),
            'the backlash changes during the run',
            own_per_run=True,
            belongs_to=BelongsTo.EFFECTS,
        ),
        _own(
            ('since_reversal_{axis}',),
            (5,),
            'the backlash is traversed over some distance after a reversal',
        ),
        _own(('feed',), (2,), 'the backlash depends on the feed'),
    ),
)
def backlash(state: State, shape: Shape) -> Terms:
    """Half the reversal value B of every axis, with the sign of its travel."""
    axes = state.machine.axis_names
    names, units = tuple(f'B_{a}' for a in axes), tuple(state.machine.axes[a].unit for a in axes)
    return Terms(names, units, axes, state.by_axes(0.5 * travel_sign(state, shape)))


ORDER = 3
"""Highest order of the functions of ``direction_dependent_tables``."""


def functions_along(axis: Axis, q: Array, order: int) -> Array:
    """Functions up to an order at positions q (n,) of an axis, m or rad, shape (n, order + 1).

    Legendre polynomials; of an endless axis 1, cos q, sin q, cos 2q ...
    """
    if axis.endless:
        return harmonics(q, order)
    place = (2.0 * q - axis.min - axis.max) / (axis.max - axis.min)
    return np.asarray(legendre.legvander(place, order))


def _influence_of(state: State, motion: ErrorMotion) -> Array:
    """Displacement of the target per unit of a motion, shape (n, 3)."""
    if state.turning is None:
        return Sight.of_tool(state.machine).at(state.q).influence(motion)
    column = state.machine.column(motion.axis)
    return state.turning.motions[:, :, column, DIRECTIONS.index(motion.direction)]


def reversed_motions(state: State, shape: Shape) -> Terms:
    """Half of each motion with the sign of the travel of its axis: m per m or rad of reversal."""
    sign, machine = 0.5 * travel_sign(state, {HELD: 0.0}), state.machine
    motions = machine.motions
    columns = [sign[:, machine.column(m.axis), None] * _influence_of(state, m) for m in motions]
    names, units = tuple(str(m) for m in motions), tuple(m.unit for m in motions)
    return Terms(names, units, tuple(m.axis for m in motions), np.stack(columns, axis=2))


def _rms_along_axes(fitted: Coefficients) -> tuple[Size, ...]:
    """Root mean square along its axis of each motion that displaces much."""
    found_sizes = []
    for head, names in fitted.groups().items():
        motion = ErrorMotion.of(head)
        orders = {n: int(n.rsplit('_', 1)[1]) for n in names}
        wave = fitted.machine.axes[motion.axis].endless
        square = {n: 1.0 / (2 if wave and k else 2 * k + 1) for n, k in orders.items()}
        parts = tuple({n: float(np.sqrt(of))} for n, of in square.items())
        found_sizes.append(Size(f'of {motion}', parts, motion.unit, f'rms along {motion.axis}'))
    return tuple(found_sizes)


@partial(
    Effect,
    shape=(ShapeParameter('order', '', float(ORDER)), ShapeParameter(HELD, '', 0.0)),
    shapes=lambda state: tuple(
        {'order': k, HELD: held} for k in (1.0, float(ORDER)) for held in (0.0, 1.0)
    ),
    sizes=_rms_along_axes,
    belongs_to=BelongsTo.REVERSAL,
    any_axes=True,
    free=(
        Free(
            ('{axis}',),
            (7,),
            'the reversal error varies along the axis more than a cubic',
            acts=reversed_motions,
        ),
    ),
)
def direction_dependent_tables(state: State, shape: Shape) -> Terms:
    """1/2 sign(d_a) c_k P_k(u_a) J_m: motion and order of its function, EXX_1 ... ECZ_3.

    The constant of the own axis' positioning is backlash.
    """
    half, machine, order = 0.5 * travel_sign(state, shape), state.machine, round(shape['order'])
    axes = zip(machine.axis_names, state.q.T, strict=True)
    along = [functions_along(machine.axes[a], values, order) for a, values in axes]
    named = [(m, k) for m in machine.motions for k in range(m.is_positioning, order + 1)]
    columns, start = np.empty((len(state), 3, len(named))), 0
    for motion in machine.motions:
        axis = machine.column(motion.axis)
        own = along[axis][:, None, int(motion.is_positioning) :]
        influence = half[:, axis, None] * _influence_of(state, motion)
        end = start + own.shape[2]
        np.multiply(influence[:, :, None], own, out=columns[:, :, start:end])
        start = end
    names = tuple(f'{motion}_{k}' for motion, k in named)
    return Terms(names, tuple(m.unit for m, _ in named), tuple(m.axis for m, _ in named), columns)


def strain_displacement(state: State, shape: Shape) -> Terms:
    """S_X, S_Y, S_Z: displacement by the strain of each axis."""
    axes = state.machine.axis_names
    columns = state.travel[:, :, None] * np.eye(3)
    return Terms.of([f'S_{a}' for a in axes], 'm/m', columns, axes)


def strain_and_shift_displacement(state: State, shape: Shape) -> Terms:
    """The same and D_X, D_Y, D_Z: displacement of the reference position of each axis."""
    axes, shifts = state.machine.axis_names, vector(state, shape).columns
    shift = Terms.of([f'D_{a}' for a in axes], 'm', shifts, axes)
    return Terms.joined(strain_displacement(state, shape), shift)


def growth_displacement(state: State, shape: Shape) -> Terms:
    """S_X, S_Y, S_Z: displacement of each axis along itself."""
    axes = state.machine.axis_names
    return Terms.of([f'S_{a}' for a in axes], 'm', vector(state, shape).columns, axes)


def approach_displacement(state: State, shape: Shape) -> Terms:
    """S_X, S_Y, S_Z: displacement of each axis along itself that approaches its end."""
    return drift.over_time(state, {**shape, 'order': 1.0}, growth_displacement(state, shape))


def _strains(fitted: Coefficients) -> tuple[Size, ...]:
    return tuple(
        Size(f'of {a}', (drift.value_reached(f'S_{a}', fitted.shape),), 'm/m', drift.REACHED)
        for a in fitted.axes
    )


@partial(
    drift.drifting,
    sizes=_strains,
    contributions=(
        Contribution(
            'machine temperature',
            ('machine_temperature', 'expansion'),
            {'tau': 1e-6, 'until': 0.0, 'order': 1.0},  # complete when the run starts
        ),
    ),
    follows=(strain_displacement, strain_and_shift_displacement),
    switches=(strain_displacement,),
    free=(
        Free(
            ('time',),
            (10,),
            'the strain does not follow an exponential in time',
            (1,),
            acts=strain_displacement,
            zero_at=-1.0,
        ),
        Free(
            ('{axis}',),
            (2,),
            'the expansion is not proportional to the distance from the zero position of the axis',
            acts=approach_displacement,
            of_shape=True,
            essential=0,
        ),
        Free(
            ('time', '{axis}'),
            (6, 2),
            'the expansion is not proportional to the distance from the zero position of the '
            'axis and does not follow an exponential in time',
            (1, 0),
            acts=growth_displacement,
            zero_at=-1.0,
            essential=1,
        ),
    ),
)
def thermal_axis_expansion(state: State, shape: Shape) -> Terms:
    """S_a g(t) (q_a - q0_a) e_a: strain of linear axis a at ``until``, q0_a its zero position."""
    machine, functions = state.machine, drift.time_functions(state, shape)
    axes = tuple(a for a in machine.axis_names if a not in machine.rotary_names)
    places = [machine.column(a) for a in axes]  # a uniform strain turns no axis
    columns = [state.by_axes(state.travel * g[:, None])[:, :, places] for _, g in functions]
    names = [f'S_{a}{suffix}' for suffix, _ in functions for a in axes]
    return Terms.of(names, 'm/m', np.concatenate(columns, axis=2), axes * len(functions))


def _shift(fitted: Coefficients) -> tuple[Size, ...]:
    parts = [drift.value_reached(f'D_{a}', fitted.shape) for a in XYZ]
    return (vector_size(fitted, parts, 'm', drift.REACHED),)


@partial(
    drift.drifting,
    sizes=_shift,
    any_axes=True,
    follows=(vector,),
    switches=(vector,),
    free=(
        Free(
            ('time',),
            (14,),
            'the drift does not follow an exponential in time',
            (1,),
            vector,
            zero_at=-1.0,
        ),
    ),
)
def thermal_structure_drift(state: State, shape: Shape) -> Terms:
    """D_k g(t): shift at ``until``, the same vector at every place."""
    shift = Terms.of([f'D_{a}' for a in XYZ], 'm', vector(state, shape).columns, XYZ)
    return drift.over_time(state, shape, shift)


POWERS = (
    *((a, b) for a, b in combinations(range(3), 2)),
    *((a, a, b) for a, b in combinations(range(3), 2)),
    *((a, b, b) for a, b in combinations(range(3), 2)),
    (0, 1, 2),
)
"""Products of positions as the axes that are multiplied."""


def _product_name(axes: Sequence[str]) -> str:
    counts = [(a, axes.count(a)) for a in dict.fromkeys(axes)]
    return ''.join(name + (str(count) if count > 1 else '') for name, count in counts)


def _strongest_coupling(fitted: Coefficients) -> tuple[Size, ...]:
    direction, product = fitted.strongest.split('_')
    of = f'along {direction} by {product.replace("2", chr(178))}'
    return (Size(of, ({fitted.strongest: 1.0},), 'm', 'at the corner of the volume'),)


@partial(
    Effect,
    sizes=_strongest_coupling,
    stays_in_place=True,
    couples=True,
    free=tuple(
        Free(
            pair,
            (4, 4),
            f'the error is not a low-order polynomial of {pair[0].upper()} and {pair[1].upper()}',
            (1, 1),
            vector,
        )
        for pair in combinations('xyz', 2)
    ),
)
def cross_coupling(state: State, shape: Shape) -> Terms:
    """C u_x^i u_y^j u_z^k e_d, at least two powers above 0: X_XY ... Z_XYZ.

    c is the error at the corner of the volume.
    """
    products = np.stack([np.prod(state.scaled[:, list(p)], axis=1) for p in POWERS], axis=1)
    columns = np.concatenate([products[:, None, :] * e[:, None] for e in np.eye(3)], axis=2)
    axes = state.machine.axis_names
    powers = [_product_name([axes[k] for k in power]) for power in POWERS]
    names = [f'{d}_{p}' for d in XYZ for p in powers]
    return Terms.of(names, 'm', columns, [n[0] for n in names])


def _moves_with(machine: Machine, axis: str) -> str:
    """What moves at the same time as an axis, in words.

    A tracker on the bed sees the axes of the table together, or those of the tool.
    """
    side = machine.chain.table_side if axis in machine.chain.table_side else ()
    others = [a for a in side if a != axis]
    if machine.tracker.link == BED and len(others) == 1:
        return others[0]
    return 'what moves with it'


def _difference_of_delays(fitted: Coefficients) -> tuple[Size, ...]:
    """Largest difference of the delays of two axes, or the one that takes part."""
    if fitted.machine.rotary_names and len(fitted.axes) == 1:
        (axis,) = fitted.axes
        other = _moves_with(fitted.machine, axis)
        if fitted.of({f'T_{axis}': 1.0}) < 0.0:
            return (Size(f'of {other} behind {axis}', ({f'T_{axis}': -1.0},), 's'),)
        return (Size(f'of {axis} behind {other}', ({f'T_{axis}': 1.0},), 's'),)
    delays = {a: fitted.of({f'T_{a}': 1.0}) for a in fitted.machine.axis_names}
    late, early = max(delays, key=delays.__getitem__), min(delays, key=delays.__getitem__)
    return (Size(f'of {late} behind {early}', ({f'T_{late}': 1.0, f'T_{early}': -1.0},), 's'),)


@partial(
    Effect,
    sizes=_difference_of_delays,
    any_axes=True,
    free=(
        Free(('feed',), (2,), 'the lag is not proportional to the feed'),
        Free(('since_stop',), (5,), 'the lag changes during a leg'),
        Free(
            ('since_stop', 'feed'),
            (5, 2),
            'the lag changes during a leg and is not proportional to the feed',
        ),
    ),
)
def servo_mismatch(state: State, shape: Shape) -> Terms:
    """-v T_a d_a e_a: delay T_a = 1/Kv_a of axis a, v d the velocity.

    Equal delays of all axes shift the point along the path and leave no trace across it.
    """
    axes = state.machine.axis_names
    return Terms.of([f'T_{a}' for a in axes], 's', state.by_axes(-state.velocity), axes)


LENGTHS = (0.002, 0.004, 0.008, 0.016, 0.032)
"""m; about v^2 / 2a, from 0.1 m/s to 0.4 m/s at 2 m/s^2 and more."""
STRAIGHT = 1e-6
"""Change of direction below which there is no corner."""


def _inside(before: Array, after: Array) -> Array:
    turn = after - before
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    return np.where(size > STRAIGHT, turn / np.maximum(size, STRAIGHT), 0.0)


def both_ends(state: State, shape: Shape) -> Terms:
    """``from`` and ``to``: to the inside of the corner behind and of the corner ahead."""
    inside = _inside(state.before, state.direction), _inside(state.direction, state.after)
    return Terms.of(['from', 'to'], 'm', np.stack(inside, axis=2))


def _distance_from_corner(fitted: Coefficients) -> tuple[Size, ...]:
    remark = f'at the corner; a third of that {1e3 * fitted.shape["l"]:.2g} mm away'
    return (Size('', ({'A': 1.0},), 'm', remark),)


def _rounding(
    inputs: tuple[str, ...], orders: tuple[int, ...], least: tuple[int, ...], words: str
) -> Free:
    return Free(inputs, orders, f'the rounding {words}', least, both_ends, zero_at=1.0)


@partial(
    Effect,
    shape=(ShapeParameter('l', 'm', width=0.5),),
    shapes=lambda state: tuple({'l': length} for length in LENGTHS),
    sizes=_distance_from_corner,
    refine='l',
    free=(
        _rounding(
            ('{term}_corner',), (8,), (1,), 'does not decay exponentially with the distance'
        ),
        _rounding(
            ('{term}_corner', '{term}_turn'), (6, 2), (1, 0), 'depends on the angle of the corner'
        ),
        _rounding(('{term}_corner', 'feed'), (6, 2), (1, 0), 'depends on the feed'),
    ),
)
def corner_rounding(state: State, shape: Shape) -> Terms:
    """A exp(-s / l) b at both ends of every leg, s the path length to the corner.

    b is the unit vector along (direction after - direction before): inside the corner.
    """
    behind, ahead = np.moveaxis(both_ends(state, shape).columns, 2, 0)
    start = np.exp(-state.from_corner / shape['l'])[:, None] * behind
    column = start + np.exp(-state.to_corner / shape['l'])[:, None] * ahead
    return Terms.of(['A'], 'm', column[:, :, None])


def amplitudes(fitted: Coefficients, way: str, unit: str, remark: str) -> tuple[Size, ...]:
    """Amplitude of sine and cosine of every axis or direction that takes part."""
    return tuple(
        Size(f'{way} {a}', ({f'S_{a}': 1.0}, {f'C_{a}': 1.0}), unit, f'amplitude, {remark}')
        for a in fitted.axes
    )


def waves(parts: Sequence[str], phases: Sequence[Array], axes: tuple[str, ...]) -> Terms:
    """Sine and cosine of each phase, (n,) or (n, 3), along every axis.

    Named by the parts, as S_X, S_Y, S_Z, C_X, C_Y, C_Z.
    """
    values = [wave(phase) for phase in phases for wave in (np.sin, np.cos)]
    columns = [(v[:, None, None] if v.ndim == 1 else v[:, :, None]) * np.eye(3) for v in values]
    names = [f'{part}_{a}' for part in parts for a in axes]
    return Terms.of(names, 'm', np.concatenate(columns, axis=2), axes * len(parts))


def _harmonics(state: State, shape: Shape) -> Terms:
    """S1_X ... C1_Z and S2_X ... C2_Z: the wave and its second harmonic."""
    phase = 2.0 * np.pi * state.q / shape['period']
    return waves(('S1', 'C1', 'S2', 'C2'), (phase, 2.0 * phase), state.machine.axis_names)


WAVES = 3
"""A period fits at least so often into the longest axis; longer waves are for the tables."""


def _periods(state: State) -> Sequence[Shape]:
    """Periods from four sample spacings up, as close as the longest axis can tell apart."""
    step = np.linalg.norm(np.diff(state.q, axis=0), axis=1)
    spacing = float(np.median(step[step > 1e-9])) if np.any(step > 1e-9) else 1e-3
    length = float(np.max(state.machine.upper - state.machine.lower))
    frequency = np.arange(WAVES / length, 0.25 / spacing, 0.5 / length)
    return tuple({'period': float(1.0 / f)} for f in frequency)


@partial(
    Effect,
    shape=(ShapeParameter('period', 'm', width=0.01),),
    shapes=_periods,
    sizes=lambda fitted: amplitudes(
        fitted, 'of', 'm', f'period {1e3 * fitted.shape["period"]:.3g} mm'
    ),
    refine='period',
    wave=Wave('period', in_time=False, probe=0.01),
    stays_in_place=True,
    free=(
        Free(
            ('{axis}',),
            (2,),
            'the wave has harmonics, and its amplitude changes along the axis',
            acts=_harmonics,
            of_shape=True,
        ),
    ),
)
def cyclic_error(state: State, shape: Shape) -> Terms:
    """(S_a sin(2 pi q_a / p) + C_a cos(2 pi q_a / p)) e_a.

    p is the pitch of the screw, the signal period of the scale or a whole-number part of them.
    """
    phase = 2.0 * np.pi * state.q / shape['period']
    return waves('SC', (phase,), state.machine.axis_names)


SECONDS = 2.0
"""Stretch over which the shapes to try keep their phase; a search refines them from there."""


def _ringing(state: State, shape: Shape) -> Terms:
    """Sine and cosine along X, Y, Z of the time since the start of a leg."""
    since = state.more.get('since_stop', state.time)
    return waves('SC', (2.0 * np.pi * shape['frequency'] * since,), XYZ)


def _frequencies(state: State) -> Sequence[Shape]:
    """Frequencies up to half the sample rate, 1 / (2 * SECONDS) apart."""
    step = np.diff(state.time)
    rate = 1.0 / float(np.median(step)) if len(step) and np.median(step) > 0 else 1.0
    return tuple({'frequency': k / (2.0 * SECONDS)} for k in range(1, int(rate * SECONDS)))


@partial(
    Effect,
    shape=(ShapeParameter('frequency', 'Hz', width=2e-4),),
    shapes=_frequencies,
    sizes=lambda fitted: amplitudes(fitted, 'along', 'm', f'{fitted.shape["frequency"]:.4g} Hz'),
    refine='frequency',
    wave=Wave('frequency', in_time=True, probe=10.0),
    free=(
        Free(
            ('since_stop',),
            (6,),
            'it is excited by every start and decays',
            (1,),
            _ringing,
            of_shape=True,
            zero_at=1.0,
        ),
    ),
)
def vibration(state: State, shape: Shape) -> Terms:
    """S sin(2 pi f t) + C cos(2 pi f t), t on the clock of the tracker."""
    return waves('SC', (2.0 * np.pi * shape['frequency'] * state.time,), XYZ)


INTERVAL = re.compile(r'(E[XYZABC][XYZ])@(-?[\d.e-]+?)\.\.(-?[\d.e-]+?)(_2)?')
BOW_SQUARE, WAVE_SQUARE = 8.0 / 15.0, 18.0 / 35.0
"""Mean squares of the two functions between two nodes."""
_Bump = tuple[ErrorMotion, float, float, bool]
"""Motion, ends of an interval, and whether the function is the wave."""


def _bump_named(where: str, name: str) -> _Bump:
    match = INTERVAL.fullmatch(name)
    if match is None:
        raise ConfigError(f'{where}: unknown; write motion@from..to, m, as in EYX@0.03..0.06')
    symbol, low, high, wave = match.groups()
    try:
        ends = float(low), float(high)
    except ValueError:
        raise ConfigError(f'{where}: {low}..{high} is not an interval') from None
    if not ends[1] > ends[0]:
        raise ConfigError(f'{where}: the interval is empty')
    return ErrorMotion.of(symbol), *ends, wave is not None


def _displaced(state: State, bumps: Sequence[_Bump]) -> Array:
    """Displacement per unit of every bump, shape (n, 3, k)."""
    view = Sight.of_tool(state.machine).at(state.q)
    influences = {m: view.influence(m) for m in dict.fromkeys(m for m, *_ in bumps)}
    columns = np.zeros((len(state), 3, len(bumps)))
    for k, (motion, low, high, wave) in enumerate(bumps):
        q = state.q[:, state.machine.column(motion.axis)]
        s = np.clip((q - low) / (high - low), 0.0, 1.0)
        own = 12.0 * np.sqrt(3.0) * s * (1 - s) * (0.5 - s) if wave else 4.0 * s * (1 - s)
        columns[:, :, k] = own[:, None] * influences[motion]
    return columns


class BetweenNodes(Effect):
    """Its coefficients may belong to any interval, not only to those of the nodes."""

    def units(self, state: State, parameters: Shape) -> dict[str, str]:
        """Unit of every given parameter."""
        own = dict.fromkeys(self.complete_shape(parameters), '')
        return {
            n: own[n] if n in own else unit_of(_bump_named(f'{self.name}: {n}', n)[0])
            for n in parameters
        }

    def block_displacement(self, state: State, shape: Shape, parameters: Shape) -> Array:
        """Displacement of a few points for checked parameters, shape (n, 3), m."""
        given = {n: v for n, v in parameters.items() if n not in shape}
        bumps = [_bump_named(f'{self.name}: {n}', n) for n in given]
        return np.asarray(_displaced(state, bumps) @ np.array([*given.values()]))


def _rms_between_nodes(fitted: Coefficients) -> tuple[Size, ...]:
    """Root mean square between nodes of each motion that displaces much."""
    found_sizes = []
    for head, names in fitted.groups().items():
        intervals = len({n.removesuffix('_2') for n in names})
        square = {n: (WAVE_SQUARE if n.endswith('_2') else BOW_SQUARE) for n in names}
        parts = tuple({n: float(np.sqrt(s / intervals))} for n, s in square.items())
        found_sizes.append(Size(f'of {head}', parts, unit_of(head), 'rms between nodes'))
    return tuple(found_sizes)


@partial(
    BetweenNodes,
    shape=(ShapeParameter('order', '', 2.0),),
    shapes=lambda state: ({'order': 1.0}, {'order': 2.0}),
    sizes=_rms_between_nodes,
    many_alike=True,
    belongs_to=BelongsTo.TABLES,
    material_um=0.45,  # smooth errors always leave a little between nodes
)
def table_resolution(state: State, shape: Shape) -> Terms:
    """(c 4 s (1 - s) + c' 12 sqrt(3) s (1 - s) (1/2 - s)) J_m, s from 0 to 1 between two nodes.

    Each function reaches 1: the first is what a steady curvature leaves, the second what a full
    wave between two nodes leaves. One term per motion and interval, named by its ends. Order 1:
    bows of the translations; 2: waves as well; 3: rotations as well.
    """
    order = round(shape['order'])
    bumps = [
        (motion, low, high, wave)
        for motion in state.machine.motions if order > 2 or motion.is_translation
        for low, high in pairwise(np.round(state.nodes[motion.axis], 6).tolist())
        for wave in (False, True)[:order]
    ]  # fmt: skip
    names = tuple(f'{m}@{low:.6g}..{high:.6g}{"_2" if w else ""}' for m, low, high, w in bumps)
    units, axes = tuple(m.unit for m, *_ in bumps), tuple(m.axis for m, *_ in bumps)
    return Terms(names, units, axes, _displaced(state, bumps))


def _tilt_over_range(fitted: Coefficients) -> tuple[Size, ...]:
    """Tilt over the range of the axis, of the coefficient that displaces most."""
    name, machine = fitted.strongest, fitted.machine
    _, about, _, axis = name.split('_')
    place = machine.axis_names.index(axis)
    range_m = float(machine.upper[place] - machine.lower[place])
    remark = f'over the {1e3 * range_m:.4g} mm of {axis}'
    return (Size(f'about {about} by {axis}', ({name: range_m},), 'rad', remark),)


@partial(
    Effect,
    sizes=_tilt_over_range,
    rigid=True,
    free=(
        Free(
            ('{axis}',),
            (10,),
            'the tilt is not proportional to the position',
            (1,),
            turned_by_axis,
        ),
        *(
            Free(
                ('{axis}',),
                (order,),
                words,
                (1,),
                turned_about_zero_by_axis,
                several_places=True,
            )
            for order, words in (
                (1, 'the table tilts about a point of the machine, not about the tracker'),
                (10, 'it tilts about a point of the machine, not in proportion to the position'),
            )
        ),
    ),
)
def table_tilt(state: State, shape: Shape) -> Terms:
    """C (q_a - q0_a) e_k x r: axis k of the tilt, axis a that moves; r is the beam.

    Where the rotation has another centre, a shift by a function of q_a is added, which is
    straightness and positioning of that axis. It is the same for all places of the tracker if the
    centre is fixed to the machine: from several places, a table that tilts beside the tracker
    differs from one that carries it.
    """
    turned = turned_by_axis(state, shape)
    columns = np.tile(state.travel, 3)[:, None, :] * turned.columns
    return Terms.of(turned.names, 'rad/m', columns, turned.axes)
