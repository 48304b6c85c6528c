# SPDX-License-Identifier: Apache-2.0
"""What a cell may hide, as functions of what a drive does: ``View`` -> displacement or ``Moves``.

``PLAIN``: the effects of the interface by the formula that their reference states, with its
parameters. ``OTHER``: the same causes as nature has them: a drive that is worn at one place, a
table that tilts past a support, corners rounded by a path filter. ``FOLLOWING``: such that follow
a recorded temperature. ``NAMELESS``: causes of no catalogue. ``TURNING``: faults of machines with
rotary axes, where they arise in the chain. Everything is in proportion to its coefficients; those
of OTHER, FOLLOWING and NAMELESS are of unit size, times A, and draw their shape from ``View.rng``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from blind.nature import LINEAR, SIX, Array, Errors, Moves, Noise, View

Parameters = Mapping[str, float]
UNIT = np.eye(3)
SENSOR = '/spindle/temperature'
BEAM = ('range', 'azimuth', 'elevation')
FEED = ('feed', 'lap')
"""Not told apart where every lap has a feed of its own."""


@dataclass(frozen=True)
class Form:
    """A cause in one form.

    Attributes
    ----------
    move : callable(view, parameters)
        Displacement (n, 3), m, or ``Moves``.
    draw : callable(view)
        Parameters of some size.
    names : frozenset of str
        Names of the catalogue that are right for it; none for a cause of no catalogue.
    shape : tuple of str
        Parameters that are no coefficients.
    hard : bool
        True if one run hardly shows it: it is sized by what it displaces.
    groups, besides : inputs of gap.json
        Of every group one is an input of it; others that may be named besides. No groups where no
        smooth function of inputs comes near.
    noise : callable(parameters), optional
        The noise of the tracker instead of a displacement.
    """

    name: str
    move: Callable[[View, Parameters], Array | Moves]
    draw: Callable[[View], dict[str, float]]
    names: frozenset[str] = frozenset()
    shape: tuple[str, ...] = ()
    hard: bool = False
    groups: tuple[Sequence[str], ...] = ()
    besides: tuple[str, ...] = ()
    noise: Callable[[Noise, Parameters], Noise] | None = None

    @property
    def is_wave(self) -> bool:
        """Whether means over pieces wash it out."""
        return bool(self.names & {'vibration', 'cyclic_error'})

    def scaled(self, p: Parameters, factor: float) -> dict[str, float]:
        """Parameters of the same form in another size."""
        return {n: v if n in self.shape else v * factor for n, v in p.items()}

    def moves(self, view: View, p: Parameters) -> Moves:
        """What it moves at all samples of a view."""
        found = self.move(view, p)
        return found if isinstance(found, dict) else {'shift': found}


PLAIN: dict[str, Form] = {}
OTHER: dict[str, Form] = {}
FOLLOWING: dict[str, Form] = {}
NAMELESS: dict[str, Form] = {}
TURNING: dict[str, Form] = {}


def plain(draw, *shape, **more):
    """Enter a function in PLAIN under its name."""

    def enter(move):
        name = move.__name__
        PLAIN[name] = Form(name, move, draw, frozenset({name}), shape, **more)
        return move

    return enter


def natural(forms, *names, prefix='other', **more):
    """Enter a function of a view that draws its own shape."""

    def enter(move):
        def moved(view, p):
            own = copy(view)
            own.rng = np.random.default_rng(int(p['draw']))
            return p['A'] * move(own)

        name = f'{prefix}_{move.__name__}'
        draw = lambda v: {'draw': float(v.rng.integers(1, 10**9)), 'A': 1e-6}  # noqa: E731
        forms[name] = Form(name, moved, draw, frozenset(names), ('draw',), **more)
        return move

    return enter


def vector(p: Parameters, head: str) -> Array:
    """Coefficients HEAD_X, HEAD_Y, HEAD_Z."""
    return np.array([p.get(f'{head}_{a}', 0.0) for a in LINEAR])


def from_reference(v: View, axis: str) -> Array:
    """Travel from the zero position of an axis, else from its minimum, m."""
    low, high = v.machine.range_of(axis)
    return v.q[:, v.machine.column(axis)] - (0.0 if low <= 0.0 <= high else low)


def approach(v: View, p: Parameters) -> Array:
    """(1 - exp(-t / tau)) / (1 - exp(-end / tau))."""
    tau, end = p['tau'], p.get('until') or v.run.length
    return np.asarray(np.expm1(-v.time / tau) / np.expm1(-end / tau))


def slow(v: View, **more: float) -> dict[str, float]:
    """Course of a drift, with its coefficients."""
    return {'tau': v.log_between(0.15, 4.0) * v.run.length, **more}


# The effects of the interface, by their formulas (docs/effects.md).


@plain(lambda v: {'held': v.pick(0.0, 1.0), **v.some('B')}, 'held')
def backlash(v, p):
    """1/2 B_a sign(d_a) e_a; held: an axis at rest stays on the side of its last travel."""
    return 0.5 * (v.side if p.get('held') else v.sense) * vector(p, 'B')


def _direction_dependent(v):
    axis, p = v.pick(*LINEAR), {'order': 3.0, 'held': v.pick(0.0, 1.0)}
    for letter in v.rng.permutation(list(SIX))[:2]:
        first = 1 if letter == axis else 0
        for k in range(first, 4):
            p[f'E{letter}{axis}_{k}'] = float(v.rng.normal()) * (
                1e-6 if letter in LINEAR else 3e-6
            )
    return p


@plain(_direction_dependent, 'order', 'held')
def direction_dependent_tables(v, p):
    """1/2 sign(d_a) sum of c_k P_k(u_a) J_m, m the motions of every axis a."""
    total = np.zeros((len(v.q), 3))
    for motion in dict.fromkeys(n[:3] for n in p if re.fullmatch(r'E[A-CX-Z][XYZ]_\d', n)):
        column = v.machine.column(motion[2])
        series = [p.get(f'{motion}_{k}', 0.0) for k in range(4)]
        value = np.polynomial.legendre.legval(v.u[:, column], series)
        sign = (v.side if p.get('held') else v.sense)[:, column]
        total += (0.5 * sign * value)[:, None] * v.influence(motion)
    return total


@plain(lambda v: slow(v, **v.some('S', 4e-6)), 'tau', 'until', 'order')
def thermal_axis_expansion(v, p):
    """S_a g(t) (q_a - q0_a) e_a."""
    travel = np.stack([from_reference(v, a) for a in LINEAR], axis=1)
    return approach(v, p)[:, None] * travel * vector(p, 'S')


@plain(lambda v: slow(v, **v.some('D')), 'tau', 'until', 'order')
def thermal_structure_drift(v, p):
    """D g(t)."""
    return approach(v, p)[:, None] * vector(p, 'D')


_MONOMIALS = ('XY', 'XZ', 'YZ', 'X2Y', 'XY2', 'X2Z', 'XZ2', 'Y2Z', 'YZ2', 'XYZ')


@plain(lambda v: {f'{v.pick(*LINEAR)}_{v.pick(*_MONOMIALS)}': v.pick(-1e-6, 1e-6)
                  for _ in range(v.pick(1, 2))})  # fmt: skip
def cross_coupling(v, p):
    """c u_x^i u_y^j u_z^k e_d, coefficient d_X<i>Y<j>Z<k>."""
    total = np.zeros((len(v.q), 3))
    for name, c in p.items():
        powers = re.findall(r'([XYZ])(\d?)', name[2:])
        factors = [v.u[:, v.machine.column(a)] ** int(k or 1) for a, k in powers]
        total += c * np.prod(factors, axis=0)[:, None] * UNIT[LINEAR.index(name[0])]
    return total


@plain(lambda v: v.some('T', 1e-5, most=2))
def servo_mismatch(v, p):
    """-v T_a d_a e_a."""
    return -v.speed[:, None] * v.direction * vector(p, 'T')


def _inside(change: Array) -> Array:
    length = np.linalg.norm(change, axis=1, keepdims=True)
    return np.where(length > 1e-6, change / np.maximum(length, 1e-6), 0.0)


@plain(lambda v: {'l': v.between(0.004, 0.03), 'A': 1e-6}, 'l')
def corner_rounding(v, p):
    """A exp(-s / l) towards the inside of the corner, at both ends of every leg."""
    after, before = np.exp(-v.start / p['l']), np.exp(-v.end / p['l'])
    inside = after[:, None] * _inside(v.inside_start) + before[:, None] * _inside(v.inside_end)
    return p['A'] * inside


@plain(lambda v: {'period': v.pick(v.pick(0.005, 0.008, 0.01, 0.012, 0.016, 0.02, 0.025),
                                   v.between(0.006, 0.03)),
                  **v.some('S', most=2), **v.some('C', most=2)}, 'period')  # fmt: skip
def cyclic_error(v, p):
    """(S_a sin(2 pi q_a / p) + C_a cos(2 pi q_a / p)) e_a."""
    phase = 2.0 * np.pi * v.q / p['period']
    return np.sin(phase) * vector(p, 'S') + np.cos(phase) * vector(p, 'C')


@plain(lambda v: {'frequency': v.log_between(1.5, 45.0), **v.some('S'), **v.some('C')},
       'frequency')  # fmt: skip
def vibration(v, p):
    """S sin(2 pi f t) + C cos(2 pi f t), t on the clock of the tracker since its first sample."""
    phase = 2.0 * np.pi * p['frequency'] * (v.time - v.time[0])[:, None]
    return np.sin(phase) * vector(p, 'S') + np.cos(phase) * vector(p, 'C')


def _between_nodes(v):
    p = {'order': 2.0}
    for motion in v.rng.permutation([f'E{d}{a}' for a in LINEAR for d in LINEAR])[
        : v.pick(1, 2, 3)
    ]:
        nodes = np.round(v.machine.nodes(motion[2]), 6)
        middle = 0.5 * (nodes[1:] + nodes[:-1])
        wave = np.sin(2 * np.pi * middle / (v.between(1.0, 2.5) * (nodes[1] - nodes[0])))
        for low, high, c in zip(nodes[:-1], nodes[1:], wave, strict=True):
            p[f'{motion}@{low:.6g}..{high:.6g}'] = 1e-6 * float(c + 0.3 * v.rng.normal())
    return p


@plain(_between_nodes, 'order')
def table_resolution(v, p):
    """(c 4 s (1 - s) + c' 12 sqrt(3) s (1 - s) (1/2 - s)) J_m from node to node."""
    total, influence = np.zeros((len(v.q), 3)), {}
    for name, c in p.items():
        if found := re.fullmatch(r'(E[A-CX-Z]([XYZ]))@(-?[\d.e-]+)\.\.(-?[\d.e-]+)(_2)?', name):
            motion, axis, low, high, wave = found.groups()
            q = v.q[:, v.machine.column(axis)]
            s = np.clip((q - float(low)) / (float(high) - float(low)), 0.0, 1.0)
            bump = 4.0 * s * (1.0 - s) * (3.0 * np.sqrt(3.0) * (0.5 - s) if wave else 1.0)
            if motion not in influence:
                influence[motion] = v.influence(motion)
            total += c * bump[:, None] * influence[motion]
    return total


@plain(lambda v: {f'tilt_{v.pick(*LINEAR)}_by_{v.pick(*LINEAR)}': v.pick(-1e-5, 1e-5)}, hard=True)
def table_tilt(v, p):
    """c (q_a - q0_a) e_k x r, coefficient tilt_k_by_a."""
    parts = [c * from_reference(v, n[-1])[:, None] * np.cross(UNIT[LINEAR.index(n[5])], v.beam)
             for n, c in p.items()]  # fmt: skip
    return np.sum(parts, axis=0)


@plain(lambda v: v.some('dT', 5e-3), hard=True)
def target_offset(v, p):
    """The reflector sits dT from where machine.yaml says."""
    return {'seat': np.tile(vector(p, 'dT'), (len(v.q), 1))}


@plain(lambda v: {'k': v.pick(-2e-5, 2e-5)})
def target_incidence(v, p):
    """k i^2 along the beam, i its angle to a reflector that faces the tracker from the middle."""
    beam = v.beam / np.linalg.norm(v.beam, axis=1, keepdims=True)
    low, high = v.machine.ends(LINEAR)
    facing = 0.5 * (low + high) - v.run.tracker
    angle = np.arccos(np.clip(beam @ facing / np.linalg.norm(facing), -1.0, 1.0))
    return p['k'] * (angle**2)[:, None] * beam


@plain(lambda v: slow(v, **v.pick(v.some('M'), v.some('W', 2e-6),
                                  {**v.some('M'), **v.some('W', 2e-6)})),
       'tau', 'until', 'order')  # fmt: skip
def tracker_pose_drift(v, p):
    """(M + W x r) g(t)."""
    return approach(v, p)[:, None] * (vector(p, 'M') + np.cross(vector(p, 'W'), v.beam))


@plain(lambda v: {'m': v.pick(-4e-6, 4e-6)}, hard=True)
def tracker_scale(v, p):
    """m r."""
    return p['m'] * v.beam


@plain(lambda v: {'c': v.pick(-5e-6, 5e-6)}, hard=True)
def tracker_range_offset(v, p):
    """c along the beam."""
    return p['c'] * v.beam / np.linalg.norm(v.beam, axis=1, keepdims=True)


_ANGLES = ('x1n', 'x2', 'x3', 'x4', 'x5n9n', 'x8x', 'x8y', 'x11a', 'x11b', 'x12a', 'x12b')


@plain(lambda v: {str(n): v.between(1e-6, 2e-6) * v.pick(-1.0, 1.0)
                  for n in v.rng.permutation(_ANGLES)[: v.pick(1, 2, 3)]}, hard=True)  # fmt: skip
def tracker_angles(v, p):
    """Errors of azimuth H, zenith angle V and range of one face; R is the distance."""
    x, y, z = (v.beam @ v.run.rotation).T
    distance, level = np.linalg.norm(v.beam, axis=1), np.hypot(x, y)
    h, zenith = np.arctan2(y, x), np.arctan2(level, z)
    x1n, x2, x3, x4, x5, x8x, x8y, x11a, x11b, x12a, x12b = (p.get(n, 0.0) for n in _ANGLES)
    d_h = (x1n / distance + x3 / level - x8x * np.sin(h) + x8y * np.cos(h)
           + x11a * np.cos(2 * h) + x11b * np.sin(2 * h))  # fmt: skip
    d_v = ((x1n + x2) * np.cos(zenith) / distance + x4 + x5 * np.cos(zenith)
           + x12a * np.cos(2 * zenith) + x12b * np.sin(2 * zenith))  # fmt: skip
    own = np.stack([
        -y * d_h + z * np.cos(h) * d_v + x2 * np.sin(zenith) * x / distance,
        x * d_h + z * np.sin(h) * d_v + x2 * np.sin(zenith) * y / distance,
        -level * d_v + x2 * np.sin(zenith) * z / distance,
    ], axis=1)  # fmt: skip
    return own @ v.run.rotation.T


def _other_noise(noise: Noise, p: Parameters) -> Noise:
    return replace(
        noise,
        range_level=p.get('level_range', 1.0),
        angle_level=p.get('level_angle', 1.0),
        share=p.get('correlated_share', noise.share),
        time=p.get('correlation_time', noise.time),
        dof=p.get('dof', noise.dof),
    )


@plain(lambda v: v.pick(
    dict.fromkeys(('level_range', 'level_angle'), v.between(1.7, 3.0)),
    {'correlated_share': v.between(0.85, 0.97), 'correlation_time': v.between(0.8, 2.0)},
    {'dof': 3.0, 'level_angle': 1.5, 'level_range': 1.5}),
       'level_range', 'level_angle', 'correlated_share', 'correlation_time', 'dof',
       noise=_other_noise)  # fmt: skip
def tracker_noise(v, p):
    """Nothing moves."""
    return np.zeros((len(v.q), 3))


# The same causes in forms of nature.


def _both_ends(v: View, after: Array, before: Array) -> Array:
    """Towards the inside of the corners, by weights (n,) after and before them."""
    return after[:, None] * v.inside_start + before[:, None] * v.inside_end


@natural(OTHER, 'corner_rounding')
def corner_cosine(v):
    """Rounded over 30 mm to 60 mm, as a raised cosine, in proportion to the turn."""
    reach = v.between(0.03, 0.06)

    def course(s):
        return np.where(s < reach, 0.5 + 0.5 * np.cos(np.pi * s / reach), 0.0)

    return _both_ends(v, course(v.start), course(v.end))


@natural(OTHER, 'corner_rounding')
def corner_parabola(v):
    """A parabola to a corner 30 mm to 60 mm away, longer after it than before."""
    reach = v.between(0.03, 0.045)

    def course(s, length):
        return np.clip(1.0 - s / length, 0.0, None) ** 2

    return _both_ends(v, course(v.start, 1.4 * reach), course(v.end, reach))


@natural(OTHER, 'corner_rounding')
def corner_fast(v):
    """Rounding that is wider the faster the leg."""
    reach = np.maximum(0.02 * (v.feed / v.feed.max()) ** 2, 1e-4)
    return _both_ends(
        v, np.exp(-0.5 * (v.start / reach) ** 2), np.exp(-0.5 * (v.end / reach) ** 2)
    )


def _turned(v: View, angle: Array) -> Array:
    """By an angle (n,) about any axis through the tracker."""
    return angle[:, None] * np.cross(v.unit(), v.beam)


@natural(OTHER, 'table_tilt')
def tilt_askew(v):
    """The table tilts with a position, about no axis of the machine."""
    return _turned(v, v.u[:, v.pick(0, 1, 2)])


@natural(OTHER, 'table_tilt')
def tilt_square(v):
    """The table tilts with the square of a position."""
    u = v.u[:, v.pick(0, 1, 2)]
    return _turned(v, u**2 + 0.5 * u)


@natural(OTHER, 'table_tilt')
def tilt_kink(v):
    """The table tilts once the load has passed a support."""
    return _turned(v, np.clip(v.u[:, v.pick(0, 1, 2)] - v.between(-0.3, 0.3), 0.0, None))


def _two_screws(v: View) -> Array:
    part = np.zeros(3)
    part[list(v.axes())] = v.rng.uniform(0.6, 1.0, 2) * v.rng.choice([-1.0, 1.0], 2)
    return part


@natural(OTHER, 'backlash')
def backlash_warm(v):
    """Play that doubles or halves while the run lasts."""
    size = 1.0 + v.pick(-0.6, 1.0) * (1.0 - np.exp(-3.0 * v.share)) / (1.0 - np.exp(-3.0))
    return size[:, None] * v.side * _two_screws(v)


@natural(OTHER, 'backlash')
def backlash_wound(v):
    """Play that is taken up over the first centimetres after a reversal."""
    size = 1.0 - 0.9 * np.exp(-v.since / v.between(0.02, 0.05))
    return size * v.side * _two_screws(v)


@natural(OTHER, 'backlash', 'direction_dependent_tables')
def backlash_worn(v):
    """Play that is large where a screw is worn."""
    a = v.pick(0, 1, 2)
    size = 0.3 + np.exp(-0.5 * ((v.u[:, a] - v.between(-0.4, 0.4)) / 0.35) ** 2)
    return (size * v.sense[:, a])[:, None] * UNIT[a]


@natural(OTHER, 'thermal_axis_expansion')
def expansion_two(v):
    """An axis that warms up quickly, then with its bed; not quite uniform."""
    course = 0.6 * (1.0 - np.exp(-v.share / 0.08)) + 0.4 * v.share**1.5
    a = v.pick(0, 1, 2)
    return (course * (0.5 * v.u[:, a] + 0.5).clip(0.0) ** 1.15)[:, None] * UNIT[a]


@natural(OTHER, 'thermal_axis_expansion')
def expansion_room(v):
    """Axes that breathe with the room."""
    course = np.sin(2.0 * np.pi * v.share * v.between(1.2, 2.0)) + 0.5 * v.share
    return course[:, None] * v.q * np.array([1.0, 0.8, 1.2])


DRIFTS = ('thermal_structure_drift', 'tracker_pose_drift')


@natural(OTHER, *DRIFTS)
def drift_spindle(v):
    """Spindle on, off and on again: the structure grows and shrinks."""
    on = (np.floor(v.share * v.between(3.5, 5.0)) % 2 == 0).astype(float)
    return follow(v.time, on, 0.12 * v.run.length)[:, None] * np.array([0.3, 0.2, 1.0])


@natural(OTHER, *DRIFTS)
def drift_late(v):
    """A structure that stays, then gives way, then stays."""
    course = 1.0 / (1.0 + np.exp(-(v.share - v.between(0.35, 0.65)) / 0.06))
    return course[:, None] * v.unit()


@natural(OTHER, 'tracker_pose_drift')
def pose_creep(v):
    """The tracker creeps and comes half back."""
    course = np.sin(np.pi * v.share.clip(0.0) ** 0.7) + 0.4 * v.share
    return course[:, None] * np.cross(v.unit(), v.beam)


@natural(OTHER, 'cross_coupling')
def droop(v):
    """A beam that droops with the cube of its reach, more where the saddle is far out."""
    a, b = v.axes()
    reach, place = 0.5 * (v.u[:, a] + 1.0), 0.5 * (v.u[:, b] + 1.0)
    return (reach**3 * np.exp(1.5 * place))[:, None] * UNIT[2]


@natural(OTHER, 'cross_coupling')
def yaw_far(v):
    """A gantry that racks beyond the middle only."""
    a, b = v.axes()
    bent = np.clip(v.u[:, a], 0.0, None) ** 1.5 * np.sin(1.8 * v.u[:, b])
    return bent[:, None] * UNIT[a]


@natural(OTHER, 'cyclic_error')
def cyclic_growing(v):
    """A screw that wobbles more towards its end, with a second harmonic."""
    a, pitch = v.pick(0, 1, 2), v.pick(0.016, 0.02, 0.025)
    phase = 2.0 * np.pi * v.q[:, a] / pitch + 1.0
    wave = np.sin(phase) + 0.4 * np.sin(2.0 * phase + 0.5)
    return ((0.7 + 0.3 * v.u[:, a]) * wave)[:, None] * UNIT[a]


@natural(OTHER, 'servo_mismatch')
def servo_soft(v):
    """Loops that lag less than in proportion, and settle after every start."""
    lag = v.speed**0.8 * (1.0 - 0.7 * np.exp(-v.since_start / 0.25))
    return lag[:, None] * v.direction * v.rng.permutation([1.0, -0.4, 0.0])


@natural(OTHER, 'vibration')
def ringing(v):
    """The column rings after every start and calms down."""
    f, tau = v.between(3.0, 12.0), v.between(0.4, 0.8)
    wave = np.exp(-v.since_start / tau) * np.sin(2.0 * np.pi * f * v.since_start)
    return wave[:, None] * v.unit()


def follow(time: Array, driven_by: Array, tau: float) -> Array:
    """First-order response, from rest, to something that stays between its samples."""
    state = np.zeros(len(time))
    for k, keep in enumerate(np.exp(-np.diff(time) / tau).tolist(), start=1):
        state[k] = driven_by[k - 1] + keep * (state[k - 1] - driven_by[k - 1])
    return state


@natural(FOLLOWING, *DRIFTS, prefix='following')
def warm_head(v):
    """The head leans as the spindle warms it, later than the sensor says."""
    return follow(v.time, v.warmth, v.between(40.0, 90.0))[:, None] * v.unit()


@natural(FOLLOWING, 'thermal_axis_expansion', prefix='following')
def warm_screw(v):
    """A screw grows with the spindle beside it, a little more than in proportion."""
    a = v.pick(0, 1, 2)
    grown = follow(v.time, v.warmth, v.between(15.0, 60.0)) ** 1.1 * (0.5 * v.u[:, a] + 0.5)
    return grown[:, None] * UNIT[a]


# Causes of no catalogue.

nameless = {'prefix': 'unknown'}


def _after(v: View) -> Array:
    return (v.share > v.between(0.15, 0.85)).astype(float)[:, None]


@natural(NAMELESS, groups=(['time'],), **nameless)
def machine_step(v):
    """A bolt gives way, somebody touches the target."""
    return _after(v) * v.unit()


@natural(NAMELESS, groups=(['time'],), **nameless)
def tracker_step(v):
    """Somebody knocks against the tracker."""
    return _after(v) * np.cross(v.unit(), v.beam)


@natural(NAMELESS, groups=(['time'],), **nameless)
def slow_swing(v):
    """An air conditioner or a chiller that switches."""
    wave = np.sin(2.0 * np.pi * v.time / v.between(30.0, 120.0) + v.between(0.0, 6.28))
    return wave[:, None] * v.unit()


@natural(NAMELESS, groups=(['x'], ['y'], ['z']), **nameless)
def local_bump(v):
    """A dent in a guideway, a chip under the cover: the machine is off at one place."""
    low, high = v.machine.ends(LINEAR)
    centre = low + v.rng.uniform(0.2, 0.8, 3) * (high - low)
    width = v.between(0.04, 0.12)
    near = np.exp(-0.5 * np.sum((v.q - centre) ** 2, axis=1) / width**2)
    return near[:, None] * v.unit()


@natural(NAMELESS, **nameless)
def stick_slip(v):
    """Sawtooth over the travel of each axis: it sticks, then slips."""
    travel = np.cumsum(np.abs(np.diff(v.q, axis=0, prepend=v.q[:1])), axis=0)
    return (2.0 * np.mod(travel / v.between(0.03, 0.12), 1.0) - 1.0) * v.unit()


@natural(NAMELESS, groups=(FEED,), **nameless)
def feed_offset(v):
    """Slides float up on their oil film with the square of the feed."""
    return ((v.speed / v.feed.max()) ** 2)[:, None] * v.unit()


@natural(NAMELESS, groups=(['acceleration'],), besides=('since_stop',), **nameless)
def inertia_nod(v):
    """The head nods forwards when braking, backwards when speeding up."""
    change = np.gradient(v.speed, v.time)
    return np.where(np.abs(change) > 0.1, np.sign(change), 0.0)[:, None] * v.unit()


@natural(NAMELESS, groups=(['sense_x'], ['sense_y']), **nameless)
def direction_pair(v):
    """The frame racks when two drives push against each other."""
    return (v.sense[:, 0] * v.sense[:, 1])[:, None] * v.unit()


@natural(NAMELESS, groups=(['x'], ['y'], ['z']), **nameless)
def ball_passage(v):
    """Every slide lifts whenever a ball of its guide enters the load zone."""
    lift = np.abs(np.sin(np.pi * v.q / v.between(0.004, 0.02))) * v.unit()
    return np.roll(lift, 1, axis=1)


@natural(NAMELESS, groups=(['sense_x'], ['sense_y'], ['sense_z']), **nameless)
def axis_brake(v):
    """An axis that stands is clamped, and the clamp shifts its slide."""
    return ((v.sense == 0.0) | (v.speed == 0.0)[:, None]) * v.unit()


@natural(NAMELESS, groups=(['azimuth'], ['elevation']), besides=('range',), **nameless)
def heat_plume(v):
    """Warm air that rises from a motor bends the beam where it passes through."""
    low, high = v.machine.ends(LINEAR)
    middle = low + v.rng.uniform(0.2, 0.8, 3) * (high - low) - v.run.tracker
    length = np.linalg.norm(v.beam, axis=1)
    cosine = v.beam @ middle / (length * np.linalg.norm(middle))
    off = np.arccos(np.clip(cosine, -1.0, 1.0)) / v.between(0.05, 0.15)
    return (length * np.exp(-0.5 * off**2))[:, None] * v.unit()


@natural(NAMELESS, groups=(['sense_x', 'sense_y', 'sense_z'],), besides=('time',), **nameless)
def tiring_clamp(v):
    """A slide that stands is pulled aside by its clamp, more as the run goes on."""
    a = v.pick(0, 1, 2)
    return ((v.sense[:, a] == 0.0) * (0.5 + v.share))[:, None] * np.roll(UNIT[a], 1)


@natural(NAMELESS, groups=(['time'], ['x', 'y', 'z']), **nameless)
def sagging_bed(v):
    """The middle of a bed sinks as time goes on, and its ends rise."""
    a, b = v.axes()
    bell = np.exp(-2.0 * v.u[:, a] ** 2)
    return (v.share.clip(0.0) ** 1.5 * (bell - bell.mean()))[:, None] * UNIT[b]


@natural(NAMELESS, groups=(['time'], ['azimuth']), besides=('range',), **nameless)
def warm_air(v):
    """Air above a motor bends the beam at some azimuths and ranges, after a while."""
    azimuth = np.arctan2(v.beam[:, 1], v.beam[:, 0])
    off = np.angle(np.exp(1j * (azimuth - np.angle(np.exp(1j * azimuth).mean()))))
    return (v.share * np.sum(v.beam**2, axis=1) * np.sin(6.0 * off))[:, None] * UNIT[2]


@natural(NAMELESS, groups=(['since_stop'],), besides=('acceleration',), **nameless)
def slow_settling(v):
    """A soft mount settles for a second or two after every start."""
    return np.exp(-v.since_start / v.between(0.5, 1.0))[:, None] * v.unit()


@natural(NAMELESS, groups=(FEED, ['x', 'y', 'z']), **nameless)
def oil_at_one_end(v):
    """A slide floats up with its feed, at the end where the oil comes in."""
    lift = (v.speed / v.feed.max()) ** 2 * (1.0 + np.tanh(1.5 * v.u[:, v.pick(0, 1, 2)]))
    return lift[:, None] * np.array([0.2, 0.1, 1.0])


# Faults of machines with rotary axes, at joints, carriers, reflectors and along the beam.


def turning(effect, draw, *shape):
    """Enter a fault in TURNING; its parameter ``axis`` is the number of an axis in SIX."""

    def enter(move):
        name = f'turning_{move.__name__}'
        TURNING[name] = Form(name, move, draw, frozenset({effect}), (*shape, 'axis'))
        return move

    return enter


def _rotary(v: View, **more: float) -> dict[str, float]:
    return {'axis': float(SIX.index(v.pick(*v.machine.turning))), **more}


def _linear(v: View, **more: float) -> dict[str, float]:
    return {'axis': float(v.pick(0, 1, 2)), **more}


def _axis(p: Parameters) -> str:
    return SIX[int(p['axis'])]


def play(v, p):
    """The joint is pushed by a drive with play, and stays where it was left."""
    programmed = v.q[:, v.machine.column(_axis(p))]
    half, own, now = 0.5 * abs(p['size']), np.empty_like(programmed), programmed[0]
    for k, wanted in enumerate(programmed.tolist()):
        own[k] = now = min(max(now, wanted - half), wanted + half)
    return {('joint', _axis(p)): np.sign(p['size']) * (own - programmed)}


def late(v, p):
    """The joint is where it should have been a moment before."""
    before = v.program(v.clock - p['size']) - v.q
    return {('joint', _axis(p)): before[:, v.machine.column(_axis(p))]}


for _where, _draw in (('', _rotary), ('linear_', _linear)):
    for _move, _effect, _size in ((play, 'backlash', 1e-5), (late, 'servo_mismatch', 1e-4)):
        _name = f'turning_{_where}{_move.__name__}'
        _one = lambda v, draw=_draw, size=_size: draw(v, size=size)  # noqa: E731
        TURNING[_name] = Form(_name, _move, _one, frozenset({_effect}), ('axis',))


@turning('rotary_cyclic_error',
         lambda v: _rotary(v, size=1e-5, number=float(v.pick(24, 30, 36, 40, 45, 48, 60, 72)),
                           phase=v.between(0.0, 6.28)), 'number', 'phase')  # fmt: skip
def gear(v, p):
    """Teeth, pitch errors and a trace of their second harmonic."""
    angle = p['number'] * v.q[:, v.machine.column(_axis(p))] + p['phase']
    return {('joint', _axis(p)): p['size'] * (np.sin(angle) + 0.1 * np.sin(2.0 * angle))}


@turning(
    'load_tilt', lambda v: {'axis': 3.0, 'size': 1e-5, 'phase': v.between(0.0, 6.28)}, 'phase'
)
def weight(v, p):
    """A weight off the axis pulls at the tilting axis by its lever across it."""
    r, _ = v.machine.link(v.q, Errors(), 'b', 'w')
    lever = r @ np.array([np.cos(p['phase']), np.sin(p['phase']), 0.0])
    across = np.cross([0.0, 0.0, 1.0], v.machine.spec['axes'][_axis(p)]['direction'])
    return {('joint', _axis(p)): p['size'] * (lever @ across)}


@turning(
    'bearing_tilt', lambda v: {'axis': 5.0, 'size': 1e-5, 'phase': v.between(0, 6.28)}, 'phase'
)
def bearing(v, p):
    """The rotor leans to one of its sides the more the other axis tilts it."""
    own = v.q[:, v.machine.column(_axis(p))] + p['phase']
    other = next(a for a in v.machine.turning if a != _axis(p))
    tilt, six = p['size'] * np.sin(v.q[:, v.machine.column(other)]), np.zeros((len(own), 6))
    six[:, 3], six[:, 4] = tilt * np.cos(own), tilt * np.sin(own)
    return {('carrier', _axis(p)): six}


def _directed(head: str, v: Array) -> dict[str, float]:
    return {f'{head}_{a}': float(x) for a, x in zip(LINEAR, v, strict=True)}


def _warming(v):
    p, along = _rotary(v, size=1e-5, tau=v.log_between(0.2, 2.0)), v.rng.normal(size=3)
    along[int(p['axis']) % 3] = 0.0
    return {**p, **_directed('along', along / np.linalg.norm(along))}


@turning('centre_growth', _warming, 'tau', *(f'along_{a}' for a in LINEAR))
def warm(v, p):
    """The housing of an axis grows after a cold start."""
    six = np.zeros((len(v.q), 6))
    course = 1.0 - np.exp(-v.time / (p['tau'] * v.run.length))
    six[:, :3] = p['size'] * course[:, None] * vector(p, 'along')
    return {('carrier', _axis(p)): six}


def _braking(v):
    lean = v.rng.normal(size=3)
    lean *= v.between(0.0, 8.0) / np.linalg.norm(lean)
    return {**_rotary(v, size=5e-6), **_directed('along', v.unit()), **_directed('about', lean)}


@turning('axis_clamping', _braking, *(f'{h}_{a}' for h in ('along', 'about') for a in LINEAR))
def brake(v, p):
    """The brake of an axis that stands pulls it aside."""
    own = v.q[:, v.machine.column(_axis(p))]
    stands = np.abs(np.diff(own, prepend=own[:1])) <= 1e-10
    six = np.concatenate([vector(p, 'along'), vector(p, 'about')])
    return {('carrier', _axis(p)): p['size'] * stands[:, None] * six}


@turning('reseated_target', lambda v: {'size': 5e-6, **_directed('along', v.unit())},
         *(f'along_{a}' for a in LINEAR))  # fmt: skip
def reseating(v, p):
    """A reflector is placed again, a little aside."""
    return {'seat': np.tile(v.again * p['size'] * vector(p, 'along'), (len(v.q), 1))}


@turning('facing_incidence', lambda v: {'size': v.pick(-1e-5, 1e-5), 'power': v.between(1.8, 2.2)},
         'power')  # fmt: skip
def incidence(v, p):
    """Range error by the angle at which the beam meets a reflector that faced it at first."""
    r, _ = v.machine.link(v.q, Errors(), v.machine.tracker_link,
                          v.machine.target(v.part.target)[0])  # fmt: skip
    beam = v.beam / np.linalg.norm(v.beam, axis=1, keepdims=True)
    inside = np.einsum('nji,nj->ni', r, beam)
    angle = np.arccos(np.clip(inside @ inside[0], -1.0, 1.0))
    return beam * (p['size'] * angle ** p['power'])[:, None]


FORMS = {**PLAIN, **OTHER, **FOLLOWING, **NAMELESS, **TURNING}
