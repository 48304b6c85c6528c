# SPDX-License-Identifier: Apache-2.0
"""A machine of any chain as it is: exact transforms, its drive, and the tracker that watches it.

p_w = T_1(q_1) T_2(q_2) ... T_n(q_n) p from the workpiece to the tool (docs/conventions.md). Every
joint is a full rigid motion; its errors are smooth functions of its position (waves and bells),
besides squareness and location errors. What is hidden acts where it arises: at a joint, at the
carrier of an axis, at the seat of a reflector, or as a shift of what the tracker sees. Nothing is
shared with model, simulation, solution or catalogue of the package.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
Rng = np.random.Generator
Transform = tuple[Array, Array]
Motion = Callable[[Array], Array]
Moves = dict[Any, Array]
"""('joint', axis): (n,), m or rad; ('carrier', axis): shifts and turns (n, 6); 'seat': (n, 3) in
the frame of what carries the reflector; 'shift': (n, 3), m, in that of the tracker's link."""

LINEAR, ROTARY, SIX = 'XYZ', 'ABC', 'XYZABC'
SQUARE = {'C0Y': 'XY', 'B0Z': 'XZ', 'A0Z': 'YZ'}
"""Squareness errors, each with the axes that it is between."""
LOCATION = {
    'A': ('Y0A', 'Z0A', 'B0A', 'C0A'),
    'B': ('X0B', 'Z0B', 'A0B', 'C0B'),
    'C': ('X0C', 'Y0C', 'A0C', 'B0C'),
}
EPOCH_NS = 1_760_000_000 * 10**9


def turned(v: Array) -> Array:
    """Rotation matrices of rotation vectors (..., 3), rad, after Rodrigues."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    k = np.zeros((*v.shape[:-1], 3, 3))
    k[..., 1, 0], k[..., 2, 0], k[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    k -= np.swapaxes(k, -1, -2)
    half = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * k + half * (k @ k))


def applied(f: Transform, points: Array) -> Array:
    """Points (3,) or (n, 3) after transforms."""
    return np.asarray((f[0] @ np.broadcast_to(points, f[1].shape)[..., None])[..., 0] + f[1])


def chained(f: Transform, g: Transform) -> Transform:
    """First g, then f."""
    return f[0] @ g[0], applied(f, g[1])


def undone(f: Transform) -> Transform:
    """Inverse."""
    back = np.swapaxes(f[0], -1, -2)
    return back, -(back @ f[1][..., None])[..., 0]


def moved(d: Array, centre: Array) -> Transform:
    """Shift d[:3] after a rotation d[3:] about a point."""
    r = turned(d[..., 3:])
    return r, d[..., :3] + centre - r @ centre


@dataclass(frozen=True)
class Errors:
    """Errors that calibrations look for: motions by name, squareness and location by name."""

    motions: Mapping[str, Motion] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Machine:
    """Kinematics of the content of a machine.yaml."""

    spec: Mapping[str, Any]

    @cached_property
    def letters(self) -> list[str]:
        """Its axes, in the order of positions."""
        return [a for a in SIX if a in self.spec['axes']]

    @cached_property
    def order(self) -> list[str]:
        """Its axes from the table to the tool."""
        return [a for a in str(self.spec['chain']).split('-') if a not in 'wbt']

    @cached_property
    def table_side(self) -> list[str]:
        """Those between table and bed."""
        parts = str(self.spec['chain']).split('-')
        return parts[1 : parts.index('b')]

    @property
    def linear(self) -> list[str]:
        """Linear axes."""
        return [a for a in self.letters if a in LINEAR]

    @property
    def turning(self) -> list[str]:
        """Rotary axes."""
        return [a for a in self.letters if a in ROTARY]

    @property
    def constants(self) -> list[str]:
        """Squareness and location errors that exist."""
        square = [n for n, pair in SQUARE.items() if set(pair) <= set(self.letters)]
        return square + [n for a in self.turning for n in LOCATION[a]]

    @property
    def tracker_link(self) -> str:
        """What the tracker stands on."""
        return str(self.spec['tracker'].get('link', 'w'))

    def column(self, axis: str) -> int:
        """Column of the positions."""
        return self.letters.index(axis)

    def range_of(self, axis: str) -> tuple[float, float]:
        """Travel, m or rad."""
        one = self.spec['axes'][axis]
        return one['min'], one['max']

    def ends(self, axes: Sequence[str]) -> tuple[Array, Array]:
        """Lower and upper ends of axes."""
        low, high = np.array([self.range_of(a) for a in axes]).T
        return low, high

    def nodes(self, axis: str) -> Array:
        """Nodes of the table: min + k pitch, the last one at max."""
        low, high = self.range_of(axis)
        pitch = self.spec['axes'][axis]['table_pitch']
        return np.append(np.arange(low, high - 1e-6 * pitch, pitch), high)

    def target(self, name: str) -> tuple[str, Array]:
        """Link and nominal place of a reflector, m."""
        one = self.spec.get('targets', {}).get(name, {})
        return one.get('link', 't'), np.array(one.get('place', self.spec['target_offset']), float)

    def joint(
        self, axis: str, q: Array, errors: Errors, carrier: Array | None = None
    ) -> Transform:
        """Transform of one axis at positions (n,); ``carrier``: shifts and turns (n, 6) of it."""
        d = np.zeros((len(q), 6))
        for k, letter in enumerate(SIX):
            if motion := errors.motions.get(f'E{letter}{axis}'):
                d[:, k] = motion(q)
        known, one = errors.constants, self.spec['axes'][axis]
        table_side = axis in self.table_side
        if axis in LINEAR:
            centre, along = np.zeros(3), np.eye(3)[LINEAR.index(axis)]
            tilt = {'Y': (0.0, 0.0, known.get('C0Y', 0.0)),
                    'Z': (known.get('A0Z', 0.0), known.get('B0Z', 0.0), 0.0)}  # fmt: skip
            along = turned(np.array(tilt.get(axis, (0.0, 0.0, 0.0)))) @ along
            move: Transform = np.tile(np.eye(3), (len(q), 1, 1)), q[:, None] * along
            outside = table_side
        else:
            centre = np.array(one['centre'], float)
            turn = np.zeros((len(q), 6))
            turn[:, 3:] = q[:, None] * np.array(one['direction'], float)
            place = np.zeros(6)
            for name in LOCATION[axis]:
                place[SIX.index(name[0])] = known.get(name, 0.0)
            line = moved(np.tile(place, (len(q), 1)), centre)
            move = chained(chained(line, moved(turn, centre)), undone(line))
            outside = not table_side
        off = moved(d, centre)
        move = chained(off, move) if outside else chained(move, off)
        if carrier is None:
            return move
        shift = moved(carrier, centre)
        return chained(move, shift) if table_side else chained(shift, move)

    def link(
        self,
        q: Array,
        errors: Errors,
        seen_from: str,
        link: str,
        carriers: Mapping[str, Array] | None = None,
    ) -> Transform:
        """Transforms of a link (w, b or t) seen from another one, at positions (n, k)."""
        none: Transform = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
        where = {'b': none, 'w': none, 't': none}
        sides = {'w': self.table_side, 't': [a for a in self.order if a not in self.table_side]}
        for end in {seen_from, link} - {'b'}:
            for axis in sides[end]:
                carrier = (carriers or {}).get(axis)
                one = self.joint(axis, q[:, self.column(axis)], errors, carrier)
                where[end] = chained(where[end], one)
        where['w'] = undone(where['w'])
        return chained(undone(where[seen_from]), where[link])

    def at(self, q: Array, name: str = 'tool', errors: Errors | None = None) -> Array:
        """Positions (n, 3) of a reflector in the frame of the table, m."""
        link, place = self.target(name)
        return applied(self.link(q, errors or Errors(), 'w', link), place)


def draw_errors(machine: Machine, rng: Rng, factor: float = 1.0) -> Errors:
    """Draw smooth motions of some 20 um and 50 urad times a factor, and constants like them."""
    motions, constants = {}, {}
    for axis in machine.letters:
        for letter in SIX:
            size = 40e-6 if letter in ROTARY else 8e-6 if axis in ROTARY else 15e-6
            motions[f'E{letter}{axis}'] = _wave(rng, machine, axis, factor * size)
    for name in machine.constants:
        size = 30e-6 if name[0] in LINEAR else 60e-6
        constants[name] = factor * size * rng.uniform(0.3, 1.2) * rng.choice((-1.0, 1.0))
    return Errors(motions, constants)


def _wave(rng: Rng, machine: Machine, axis: str, size: float) -> Motion:
    """A few waves over the range, and mostly a bell; of an endless axis whole waves."""
    low, high = machine.range_of(axis)
    bell = np.zeros(3)
    if machine.spec['axes'][axis].get('endless'):
        number, share = np.arange(1.0, 4.0), np.array([0.8, 0.5, 0.2])
    else:
        number = np.array([0.2, 0.45, 0.75, 1.1]) * rng.uniform(0.9, 1.1, 4)
        share = np.array([1.0, 0.7, 0.4, 0.15])
        bell = np.array([0.3 * rng.normal(), rng.uniform(0.2, 0.8), rng.uniform(0.2, 0.35)])
    amplitude, phase = size * share * rng.normal(size=len(share)), rng.uniform(0, 6.28, len(share))

    def value(q: Array) -> Array:
        s = (np.asarray(q) - low) / (high - low)
        waves = np.sin(2 * np.pi * number * s[..., None] + phase) @ amplitude
        if not bell[0]:
            return np.asarray(waves)
        return np.asarray(waves + size * bell[0] * np.exp(-0.5 * ((s - bell[1]) / bell[2]) ** 2))

    return value


LEVER = 0.2
"""m; a rotation counts as a way on this lever."""
DRIVEN_THROUGH = np.radians(12.0)
"""rad; at a sharper corner the drive stops."""


@dataclass(frozen=True)
class Part:
    """What is driven with one reflector in view.

    Attributes
    ----------
    corners : ndarray, shape (m, k), m and rad
    feed : ndarray, shape (m - 1,), m/s
        Of the linear axes together, on every leg; ``turn``: of each rotary one, rad/s.
    push : tuple of float, m/s^2 and rad/s^2
        Acceleration of every linear and rotary axis.
    dwell, rest : float, s
        At corners where the drive stops, and before and after all.
    """

    target: str
    corners: Array
    feed: Array
    turn: float = np.inf
    push: tuple[float, float] = (2.0, 1.0)
    dwell: float = 0.4
    rest: float = 1.0


class Program:
    """Programmed positions of a part over time: trapezoidal speed from stop to stop."""

    def __init__(self, machine: Machine, part: Part) -> None:
        lin = np.array([a in LINEAR for a in machine.letters])
        step = np.diff(part.corners, axis=0)
        scaled = step * np.where(lin, 1.0, LEVER)
        length = np.linalg.norm(scaled, axis=1)
        unit = scaled / length[:, None]
        sharp = np.sum(unit[1:] * unit[:-1], axis=1) < np.cos(DRIVEN_THROUGH)
        self.corners, self.unit = part.corners, unit
        self.reach = np.append(0.0, np.cumsum(length))
        self.stops = np.flatnonzero(np.concatenate([[True], sharp, [True]]))
        most = np.where(lin, *part.push)
        top, push = [], []
        for first, last in pairwise(self.stops):
            rate = np.abs(step[first:last]) / length[first:last, None]
            along = np.linalg.norm(rate[:, lin], axis=1).max()
            turning = rate[:, ~lin].max(initial=0.0)
            limit = float((most / np.maximum(rate.max(axis=0), 1e-9)).min())
            whole = self.reach[last] - self.reach[first]
            speed = part.feed[first:last].min() / max(along, 1e-9)
            top.append(min(speed, part.turn / max(turning, 1e-9), np.sqrt(limit * whole)))
            push.append(limit)
        self.top, self.push = np.array(top), np.array(push)
        self.whole = np.diff(self.reach[self.stops])
        self.takes = self.whole / self.top + self.top / self.push
        self.start = part.rest + np.append(0.0, np.cumsum(self.takes + part.dwell)[:-1])
        self.duration = float(self.start[-1] + self.takes[-1] + part.rest)

    def way(self, time: Array) -> tuple[Array, Array, NDArray[np.int64]]:
        """Way and speed along the path, m and m/s, and number of the stretch from stop to stop."""
        k = np.clip(np.searchsorted(self.start, time, side='right') - 1, 0, None)
        t = np.clip(time - self.start[k], 0.0, self.takes[k])
        left, top, push = self.takes[k] - t, self.top[k], self.push[k]
        ramp = top / push
        s = np.where(t < ramp, 0.5 * push * t**2, top * (t - 0.5 * ramp))
        s = np.where(left < ramp, self.whole[k] - 0.5 * push * left**2, s)
        return self.reach[self.stops[k]] + s, np.minimum(top, push * np.minimum(t, left)), k

    def __call__(self, time: Array) -> Array:
        """Positions (n, k), m and rad, at times (n,) in this part, s."""
        s = self.way(time)[0]
        return np.stack([np.interp(s, self.reach, column) for column in self.corners.T], axis=1)


def since_reversal(q: Array) -> tuple[Array, Array]:
    """Sign of the last motion of an axis (n,) and its travel since it last reversed (n,), m."""
    step = np.diff(q, prepend=q[0])
    moving = np.abs(step) > 1e-10
    last = np.maximum.accumulate(np.where(moving, np.arange(len(q)), -1))
    sign = np.sign(step)[np.where(last < 0, int(np.argmax(moving)), last)]
    total = np.cumsum(np.abs(step))
    begun = np.concatenate([[True], np.diff(sign) != 0])
    start = np.maximum.accumulate(np.where(begun, np.arange(len(q)), 0))
    return sign, total - total[start]


@dataclass(frozen=True)
class Noise:
    """Noise of a tracker: factors on its levels, colour, tails (degrees of freedom of Student)."""

    share: float = 0.5
    time: float = 0.3
    range_level: float = 1.0
    angle_level: float = 1.0
    dof: float | None = None

    def drawn(self, rng: Rng, count: int, step: float) -> Array:
        """Unit variance: a share forgotten within ``time``, s, the rest white; shape (count,)."""
        keep = np.exp(-step / self.time)
        kicks = rng.normal(size=count) * np.sqrt(1.0 - keep**2)
        kicks[0] = rng.normal()
        white = rng.normal(size=count)
        if self.dof:
            white = rng.standard_t(self.dof, count) * np.sqrt(1.0 - 2.0 / self.dof)
        slow = lfilter([1.0], [1.0, -keep], kicks)
        return np.asarray(np.sqrt(self.share) * slow + np.sqrt(1.0 - self.share) * white)


@dataclass(frozen=True)
class Run:
    """One recording of a machine from one place of the tracker, without what is hidden.

    Attributes
    ----------
    places : mapping of target to ndarray, shape (3,), m
        Where the reflectors really are.
    starts : tuple of float, s
        When each part begins.
    rotation, tracker : ndarray, shape (3, 3) and (3,), m
        Axes and place of the tracker in its link.
    drift : float
        Of its clock.
    warmth : tuple of two ndarrays, shape (m,)
        Times, s, and readings of the sensor beside the spindle, degC; empty without one.
    """

    machine: Machine
    errors: Errors
    parts: tuple[Part, ...]
    starts: tuple[float, ...]
    places: Mapping[str, Array]
    rotation: Array
    tracker: Array
    noise: Noise
    rate: float = 100.0
    drift: float = 0.0
    seed: int = 0
    warmth: tuple[Array, Array] = (np.zeros(0), np.zeros(0))

    @cached_property
    def programs(self) -> list[Program]:
        """Of the parts."""
        return [Program(self.machine, p) for p in self.parts]

    @property
    def length(self) -> float:
        """Duration, s."""
        return self.starts[-1] + self.programs[-1].duration

    @cached_property
    def clocks(self) -> list[Array]:
        """Times of the samples of every part since it began, s."""
        first = np.random.default_rng([self.seed, 1]).uniform(0.0, 1.0, len(self.parts))
        return [np.arange(f / self.rate, p.duration, 1.0 / self.rate)
                for f, p in zip(first, self.programs, strict=True)]  # fmt: skip

    @cached_property
    def plain(self) -> list[Array]:
        """Positions without anything hidden, part by part, (n, 3), m."""
        return [self.seen(k) for k in range(len(self.parts))]

    def seen(self, k: int, moves: Moves | None = None, errors: Errors | None = None) -> Array:
        """Where the tracker sees the reflector of a part, in the frame of its link, (n, 3), m."""
        moves, machine, q = moves or {}, self.machine, self.programs[k](self.clocks[k])
        for axis in machine.letters:
            q[:, machine.column(axis)] += moves.get(('joint', axis), 0.0)
        carriers = {key[1]: m for key, m in moves.items() if key[0] == 'carrier'}
        name = self.parts[k].target
        pose = machine.link(
            q, errors or self.errors, machine.tracker_link, machine.target(name)[0], carriers
        )
        return applied(pose, self.places[name] + moves.get('seat', 0.0)) + moves.get('shift', 0.0)

    def measured(self, seen: Sequence[Array], noise: Noise) -> tuple[NDArray[np.int64], Array]:
        """Stamps (n,), ns, and points (n, 3), m, of what the tracker says of positions."""
        rng, spec = np.random.default_rng([self.seed, 2]), self.machine.spec['tracker']
        levels = np.array([spec['u_range'] * noise.range_level, spec['u_angle'], spec['u_angle']])
        levels[1:] *= noise.angle_level
        stamps, points = [], []
        for k, position in enumerate(seen):
            own = (position - self.tracker) @ self.rotation
            distance = np.linalg.norm(own, axis=1)[:, None]
            along = own / distance
            level = np.cross(along, [0.0, 0.0, 1.0])
            level /= np.linalg.norm(level, axis=1, keepdims=True)
            reach = np.concatenate([np.ones_like(distance), distance, distance], axis=1) * levels
            for way, r in zip((along, level, np.cross(level, along)), reach.T, strict=True):
                off = noise.drawn(rng, len(own), 1.0 / self.rate)
                own = own + (r * off)[:, None] * way
            clock = (self.starts[k] + self.clocks[k]) * (1.0 + self.drift)
            stamps.append(EPOCH_NS + np.rint(clock * 1e9).astype(np.int64))
            points.append(own)
        return np.concatenate(stamps), np.concatenate(points)


class View:
    """What a part of a run does at every sample, for causes to act on; arrays over its samples.

    Attributes
    ----------
    time, share : ndarray, shape (n,), s and 1
        Of the run, by the clock of the tracker, and as a share of it.
    q : ndarray, shape (n, k), m and rad
    u : ndarray, shape (n, k)
        Positions as -1 to 1 over the range of each axis.
    direction, sense, side, since : ndarray, shape (n, k)
        Of the leg; its signs; signs of the last travel; travel since the last reversal.
    speed, feed : ndarray, shape (n,), m/s
        At the sample, and the highest of the motion that it belongs to.
    start, end : ndarray, shape (n,), m
        Way from the last stop and to the next.
    inside_start, inside_end : ndarray, shape (n, k)
        Change of direction at those corners: it points to their inside.
    since_start : ndarray, shape (n,), s
        Since the target last began to move.
    beam : ndarray, shape (n, 3), m
        From the tracker to the reflector, in the frame of its link.
    again : bool
        True if this is the last part, and its reflector was in view before.
    rng : Generator
        What a cause draws itself.
    """

    def __init__(self, run: Run, k: int) -> None:
        machine, program, clock = run.machine, run.programs[k], run.clocks[k]
        self.run, self.k, self.machine = run, k, machine
        self.program, self.clock, self.part = program, clock, run.parts[k]
        last = k == len(run.parts) - 1
        self.again = last and any(p.target == self.part.target for p in run.parts[:k])
        self.time = (run.starts[k] + clock) * (1.0 + run.drift)
        self.share = self.time / run.length
        self.q = program(clock)
        low, high = machine.ends(machine.letters)
        self.u = 2.0 * (self.q - low) / (high - low) - 1.0
        way, self.speed, stretch = program.way(clock)
        leg = np.clip(np.searchsorted(program.reach, way, side='left') - 1, 0, None)
        self.direction = program.unit[leg]
        self.sense = np.where(np.abs(self.direction) > 1e-9, np.sign(self.direction), 0.0)
        both = [since_reversal(column) for column in self.q.T]
        self.side = np.stack([s for s, _ in both], axis=1)
        self.since = np.stack([s for _, s in both], axis=1)
        self.feed = program.top[stretch]
        stops = program.reach[program.stops]
        self.start, self.end = way - stops[stretch], stops[stretch + 1] - way
        first, last = program.unit[program.stops[:-1]], program.unit[program.stops[1:] - 1]
        before, after = (
            np.concatenate([first[:1], last[:-1]]),
            np.concatenate([first[1:], last[-1:]]),
        )
        self.inside_start, self.inside_end = (first - before)[stretch], (after - last)[stretch]
        self.since_start = np.maximum(clock - program.start[stretch], 0.0)
        self.beam = run.plain[k] - run.tracker
        self.rng = np.random.default_rng(0)

    @cached_property
    def warmth(self) -> Array:
        """Reading of the sensor at the samples, from 0 to 1."""
        time, value = self.run.warmth
        value = (value - value.min()) / (value.max() - value.min())
        return np.interp(self.time, time, value)

    def influence(self, name: str) -> Array:
        """Displacement of the reflector per unit of an error motion, shape (n, 3), at all q."""
        known = self.run.errors.motions
        more = Errors({**known, name: lambda q: known[name](q) + 1e-6}, self.run.errors.constants)
        return np.asarray((self.run.seen(self.k, errors=more) - self.run.plain[self.k]) / 1e-6)

    # Draws of a cause.

    def between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def log_between(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def pick(self, *choices: Any) -> Any:
        return choices[int(self.rng.integers(len(choices)))]

    def axes(self) -> tuple[int, int]:
        """Numbers of two different linear axes."""
        first, second, _ = self.rng.permutation(3).tolist()
        return first, second

    def unit(self) -> Array:
        """A direction, no component of it small."""
        v = self.rng.choice([-1.0, 1.0], 3) * self.rng.uniform(0.3, 1.0, 3)
        return np.asarray(v / np.linalg.norm(v))

    def some(self, head: str, size: float = 1e-6, most: int = 3) -> dict[str, float]:
        """Coefficients of one to ``most`` linear axes, of either sign."""
        chosen = self.rng.permutation(3)[: int(self.rng.integers(1, most + 1))]
        return {f'{head}_{LINEAR[k]}': size * self.between(0.4, 1.0) * self.pick(-1.0, 1.0)
                for k in sorted(chosen.tolist())}  # fmt: skip
