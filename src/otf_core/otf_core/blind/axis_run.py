# SPDX-License-Identifier: Apache-2.0
"""Cells of machines with rotary axes: machine, parts that are driven, tracker; all from one seed.

A tilting table seen from the bed, a rotary table that carries the tracker, a swivel head. Lines
through the volume with two reflectors on the tool; circles, arcs and both rotary axes together
with three nests on the table, or moves on which the linear axes follow the rotation but for a
slow creep. In most runs the first of them comes again at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.axis_nature import (
    LINEAR,
    Driven,
    Errors,
    Nature,
    Rng,
    Spec,
    draw_errors,
    turned,
)
from otf_core.model.axis_path import AxisPath
from otf_core.model.observation import Samples

MACHINES = {'trunnion': 0.6, 'rotary': 0.25, 'head': 0.15}
"""Kinds of machines, and how often they are drawn."""
RATE = 100.0
"""Hz; of the tracker."""
EPOCH_NS = 1_760_000_000 * 10**9
DRIVEN_THROUGH = np.radians(12.0)
"""rad; between two legs, a rotation counted on ``LEVER``: a sharper corner is stopped at."""
LEVER = 0.2
"""m."""
LINEAR_ACCELERATION, TURN_ACCELERATION = 0.3, np.radians(60.0)
"""m/s^2 and rad/s^2."""


# Machines.


def draw_spec(kind: str, rng: Rng) -> Spec:
    """Draw machine.yaml of a kind of machine."""

    def about(value: float, share: float = 0.2) -> float:
        return float(np.round(value * rng.uniform(1.0 - share, 1.0 + share), 3))

    def near(values: Sequence[float], by: float = 0.02) -> list[float]:
        return [float(np.round(v + by * rng.uniform(-1.0, 1.0), 3)) for v in values]

    wide, deep, high = about(0.32), about(0.27), about(0.6, 0.1)
    if kind == 'head':
        wide, deep = about(0.4, 0.1), about(0.4, 0.1)
    axes: dict[str, dict[str, object]] = {
        'X': {'min': -wide, 'max': wide, 'table_pitch': 0.05},
        'Y': {'min': -deep, 'max': deep, 'table_pitch': 0.05},
        'Z': {'min': 0.0, 'max': high, 'table_pitch': 0.05},
    }
    turn = {'kind': 'rotary', 'direction': [0, 0, 1], 'table_pitch': 0.2618}
    tilt = {'kind': 'rotary', 'direction': [1, 0, 0], 'table_pitch': 0.1745}
    chain, link, offset = 'w-C-A-b-Y-X-Z-t', 'b', near([0.0, 0.0, -0.15])
    if kind == 'head':
        chain, link, offset = 'w-b-X-Y-Z-C-A-t', 'w', near([0.0, 0.0, -0.2])
        most = about(1.5, 0.1)
        axes['A'] = {**tilt, 'min': -most, 'max': most, 'centre': near([0.0, 0.02, 0.0], 0.01)}
        axes['C'] = {**turn, 'min': -3.1416, 'max': 3.1416, 'centre': near([0.0, 0.0, 0.1], 0.01)}
    else:
        if kind == 'trunnion':
            axes['A'] = {**tilt, 'min': -about(0.5), 'max': about(1.8, 0.07),
                         'centre': near([0.0, 0.0, 0.05])}  # fmt: skip
        else:
            chain, link = 'w-C-b-X-Y-Z-t', 'w'
        axes['C'] = {**turn, 'min': 0.0, 'max': 6.283185307179586, 'endless': True,
                     'centre': near([0.0, 0.0, 0.0], 0.005)}  # fmt: skip
    longer = [offset[0], offset[1], float(np.round(offset[2] - about(0.1), 3))]
    targets: dict[str, dict[str, object]] = {'long': {'link': 't', 'place': longer, 'u': 0.0}}
    if kind == 'head':
        aside = [float(np.round(offset[0] + 0.08, 3)), *offset[1:]]
        targets['side'] = {'link': 't', 'place': aside, 'u': 0.0}
    if kind == 'trunnion':
        start = rng.uniform(0.0, 2 * np.pi)
        for k in range(3):
            r, a = about(0.19, 0.1), start + 2 * np.pi * k / 3 + rng.uniform(-0.3, 0.3)
            place = [float(np.round(v, 3)) for v in
                     (r * np.cos(a), r * np.sin(a), rng.uniform(0.03, 0.14))]  # fmt: skip
            targets[f'nest-{k + 1}'] = {'link': 'w', 'place': place, 'u': 1e-3}
    tracker = {'u_range': 0.5e-6, 'u_angle': round(float(rng.uniform(1.0, 2.2)), 2) * 1e-6,
               'link': link}  # fmt: skip
    return {'name': kind, 'chain': chain, 'axes': axes, 'target_offset': offset,
            'tracker': tracker, 'targets': targets}  # fmt: skip


TRACKER_PLACES = {
    'trunnion': (-1.0, 0.7, 1.0),
    'rotary': (-0.9, 0.8, 0.6),
    'head': (-1.0, -1.0, 0.5),
}
"""m; in its link."""


# Corners of the parts.


def _at(machine: Nature, count: int, **positions: Array | float) -> Array:
    """Corners, axes that are not given at zero or the end next to it."""
    rest = [np.clip(0.0, *machine.range_of(a)) for a in machine.letters]
    q = np.tile(np.array(rest, dtype=float), (count, 1))
    for axis, values in positions.items():
        q[:, machine.column(axis)] = values
    return q


def _without_repeats(q: Array) -> Array:
    return np.asarray(q[np.append(True, np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-9)])


def lines(machine: Nature, rng: Rng, count: int) -> Array:
    """Space diagonals, then chords between faces, there and back."""
    points = [np.array([(k >> b) & 1 for b in range(3)], dtype=float)
              for k in (0, 7, 1, 6, 3, 4, 2, 5)]  # fmt: skip
    while len(points) <= count:
        one = rng.uniform(size=3)
        one[rng.integers(3)] = rng.integers(2)
        if np.linalg.norm(one - points[-1]) > 0.75:
            points.append(one)
    both = np.array(points[: count + 1] + points[count - 1 :: -1])
    low, high = np.array([machine.range_of(a) for a in LINEAR]).T
    xyz = low + both * (high - low)
    return _at(machine, len(xyz), **dict(zip(LINEAR, xyz.T, strict=True)))


def nest_turns(machine: Nature, number: int) -> Array:
    """Circles, arcs, and both rotary axes together in both senses, for one nest."""
    (a0, a1), (c0, c1) = machine.range_of('A'), machine.range_of('C')
    corners = [(0.0, c0), (0.0, c1), (0.0, c0), (a0, c0), (a1, c0), (a0, c0)]
    sweeps = number % 3 + 1
    for first, last in ((a0, a1), (a1, a0)):
        leg = [(last if k % 2 else first, c0 + (c1 - c0) * k / sweeps) for k in range(sweeps + 1)]
        corners += leg + leg[::-1]
    a, c = np.array(corners).T
    return _without_repeats(_at(machine, len(a), A=a, C=c, Z=0.5))


def held_at(machine: Nature, name: str, q: Array, points: Array) -> Array:
    """Positions at which a reflector on the tool is at points (n, 3) of the table's frame, m."""
    q, place, none = q.copy(), machine.target(name)[1], Errors()

    def where(at: Array) -> Array:
        r, p = machine.link(at, none, 'w', 't')
        return np.asarray(r @ place + p)

    for _ in range(2):  # linear in these axes
        now, slopes = where(q), np.zeros((len(q), 3, 3))
        for k, axis in enumerate(LINEAR):
            other = q.copy()
            other[:, machine.column(axis)] += 0.1
            slopes[:, :, k] = (where(other) - now) / 0.1
        step = np.linalg.solve(slopes, (points - now)[..., None])[..., 0]
        for k, axis in enumerate(LINEAR):
            q[:, machine.column(axis)] += step[:, k]
    return q


def creep(
    machine: Nature, name: str, axis: str, middle: Array, slow: Array, rest: Mapping[str, float]
) -> Array:
    """One rotary axis through its range and back while the reflector creeps by ``slow``, m."""
    low, high = machine.range_of(axis)
    count = int(np.ceil((high - low) / CORNER)) + 1
    share = np.linspace(0.0, 1.0, count)
    q = _at(machine, count, **dict(rest), **{axis: low + (high - low) * share})
    q = held_at(machine, name, q, middle + np.outer(share - 0.5, slow))
    return np.concatenate([q, q[-2::-1]])


def _inside(machine: Nature, q: Array) -> bool:
    low, high = np.array([machine.range_of(a) for a in machine.letters]).T
    return bool(np.all((q > low - 1e-9) & (q < high + 1e-9)))


CORNER = np.radians(0.5)
"""rad; between two corners of a creep: the chord is then some micrometres off the arc."""
CREEPS = ((0.0, 0.0, 0.075), (0.055, 0.05, 0.0))
"""m; slow travel during one turn; at the rates that are drawn never as slow as a standstill."""


def creeps(machine: Nature, name: str, rng: Rng, places: Sequence[Sequence[float]]) -> Array:
    """Creeps of every rotary axis at places of the table, nudged until they are in range."""
    parts: list[Array] = []
    for number, place in enumerate(places):
        for slow in CREEPS:
            for axis in machine.turning:
                for other in _others(machine, axis, number):
                    for share in (1.0, 0.8, 0.6, 0.4, 0.2):
                        middle = np.array(place) * [share, share, 1.0]
                        middle = middle + rng.uniform(-0.01, 0.01, 3)
                        q = creep(machine, name, axis, middle, np.array(slow), other)
                        if _inside(machine, q):
                            parts.append(q)
                            break
    return _without_repeats(np.concatenate(parts))


def _others(machine: Nature, axis: str, number: int) -> list[dict[str, float]]:
    """Where the other rotary axis stands meanwhile; one of two angles at later places."""
    names = [a for a in machine.turning if a != axis]
    at = {'A': (0.6, -0.9), 'C': (0.0, 1.6)}
    return [{n: v} for n in names for v in at[n][: 1 if number else 2]] or [{}]


@dataclass(frozen=True)
class Part:
    """What is driven with one reflector in view.

    Attributes
    ----------
    feed, turn : float, m/s and rad/s
        Of the linear axes together, and of each rotary one.
    """

    target: str
    corners: Array
    feed: float
    turn: float


def draw_parts(machine: Nature, rng: Rng) -> list[Part]:
    """Draw what is driven."""
    feed, turn = rng.uniform(0.06, 0.09), np.radians(rng.uniform(16.0, 24.0))
    kind, names = machine.spec['name'], list(machine.spec['targets'])
    parts = [Part('tool', lines(machine, rng, 8), feed, turn)]
    slower, follow = float(rng.choice([0.45, 0.6])), rng.uniform(0.12, 0.18)
    round_about = np.radians(rng.uniform(22.0, 28.0))
    if kind == 'trunnion':
        parts.append(Part('long', lines(machine, rng, 5), slower * feed, turn))
        for k, name in enumerate(n for n in names if n.startswith('nest')):
            parts.append(
                Part(name, nest_turns(machine, k), feed, turn if k != 1 else slower * turn)
            )
    elif kind == 'rotary':
        parts.append(Part('long', lines(machine, rng, 5), slower * feed, turn))
        places = [(0.14, 0.02, 0.1), (-0.08, 0.12, 0.05), (-0.07, -0.13, 0.2)]
        for ratio, own in ((1.0, places), (0.8, places[:2])):
            q = creeps(machine, 'tool', rng, own)
            parts.append(Part('tool', q, ratio * follow, ratio * round_about))
    else:
        places = [(0.0, 0.0, 0.12), (0.04, -0.03, 0.25)]
        for name, ratio in (('tool', 1.0), ('long', 0.8), ('side', 1.0)):
            q = creeps(machine, name, rng, places if name == 'tool' else places[1:])
            parts.append(Part(name, q, ratio * follow, ratio * round_about))
    if rng.random() < 0.7:
        again = 'nest-1' if kind == 'trunnion' else 'long'
        parts.append(next(p for p in parts if p.target == again))
    return parts


# The drive.


def programmed(
    machine: Nature, part: Part, rest: float = 1.0
) -> tuple[Callable[[Array], Array], float]:
    """Positions as a function of time, s, and how long they take, s; trapezoidal speed."""
    corners, lin = part.corners, np.array([a in LINEAR for a in machine.letters])
    step = np.diff(corners, axis=0)
    scaled = step * np.where(lin, 1.0, LEVER)
    length = np.linalg.norm(scaled, axis=1)
    unit = scaled / length[:, None]
    sharp = np.sum(unit[1:] * unit[:-1], axis=1) < np.cos(DRIVEN_THROUGH)
    stops = np.flatnonzero(np.concatenate([[True], sharp, [True]]))
    reach = np.append(0.0, np.cumsum(length))
    times, way, now = [0.0, rest], [0.0, 0.0], rest
    for first, last in pairwise(stops):
        rate = np.abs(step[first:last]) / length[first:last, None]
        along = np.linalg.norm(rate[:, lin], axis=1).max()
        turning = rate[:, ~lin].max()
        speed = min(part.feed / max(along, 1e-9), part.turn / max(turning, 1e-9))
        most = np.where(lin, LINEAR_ACCELERATION, TURN_ACCELERATION)
        push = float((most / np.maximum(rate.max(axis=0), 1e-9)).min())
        whole = reach[last] - reach[first]
        speed = min(speed, float(np.sqrt(push * whole)))
        ramp, u = speed / push, np.linspace(0.0, 1.0, 40)
        cruise = whole / speed - ramp
        times += [*(now + ramp * u), *(now + ramp + cruise + ramp * u)]
        off = 0.5 * push * (ramp * u) ** 2
        way += [*(reach[first] + off), *(reach[last] - off[::-1])]
        now = times[-1]
        times.append(now + 0.1)
        way.append(reach[last])
        now = times[-1]
    times.append(now + rest)
    way.append(reach[-1])
    at, along_path = np.array(times), np.array(way)

    def program(time: Array) -> Array:
        s = np.interp(time, at, along_path)
        return np.stack([np.interp(s, reach, column) for column in corners.T], axis=1)

    return program, float(at[-1])


# The tracker.


def coloured(rng: Rng, count: int, share: float, time: float) -> Array:
    """White noise and noise that is forgotten within ``time``, s; unit variance."""
    keep = np.exp(-1.0 / (RATE * time))
    kicks = rng.normal(size=count) * np.sqrt(1.0 - keep**2)
    slow, now = np.empty(count), rng.normal()
    for k, kick in enumerate(kicks.tolist()):
        now = keep * now + kick
        slow[k] = now
    return np.asarray(np.sqrt(share) * slow + np.sqrt(1.0 - share) * rng.normal(size=count))


@dataclass(frozen=True)
class AxisCell:
    """A cell without faults.

    Attributes
    ----------
    driven : tuple of Driven
        One per part.
    places : mapping of target to ndarray, shape (3,), m
        Where the reflectors really are.
    rotation, tracker : ndarray, shape (3, 3) and (3,), m
        Axes and place of the tracker in its link.
    share, time : float
        Of the variance of its noise that is correlated, and for how long, s.
    seed : int
        Of the noise.
    """

    machine: Nature
    errors: Errors
    parts: tuple[Part, ...]
    driven: tuple[Driven, ...]
    places: Mapping[str, Array]
    rotation: Array
    tracker: Array
    share: float
    time: float
    seed: int

    def measured(self, positions: Sequence[Array]) -> Samples:
        """What the tracker says of positions (n, 3) in every part."""
        rng, spec = np.random.default_rng(self.seed), self.machine.spec['tracker']
        stamps, points = [], []
        for part, seen in zip(self.driven, positions, strict=True):
            own = (seen - self.tracker) @ self.rotation
            r = np.linalg.norm(own, axis=1)
            polar = [r, np.arctan2(own[:, 1], own[:, 0]), np.arcsin(own[:, 2] / r)]
            levels = spec['u_range'], spec['u_angle'], spec['u_angle']
            r, azimuth, elevation = (
                value + level * coloured(rng, len(r), self.share, self.time)
                for value, level in zip(polar, levels, strict=True)
            )
            level = r * np.cos(elevation)
            points.append(np.stack([level * np.cos(azimuth), level * np.sin(azimuth),
                                    r * np.sin(elevation)], axis=1))  # fmt: skip
            stamps.append(EPOCH_NS + np.rint(part.time * 1e9).astype(np.int64))
        return Samples(np.concatenate(stamps), np.concatenate(points))

    def paths(self) -> tuple[AxisPath, ...]:
        """Corners of the parts, as they are published."""
        letters = tuple(self.machine.letters)
        return tuple(AxisPath(letters, p.corners, p.target) for p in self.parts)


def draw_axis_cell(kind: str, rng: Rng) -> AxisCell:
    """Draw a cell of a kind of machine."""
    machine = Nature(draw_spec(kind, rng))
    parts, errors = draw_parts(machine, rng), draw_errors(machine, rng)
    programs = [programmed(machine, part) for part in parts]
    breaks = rng.uniform(5.0, 20.0, len(parts))
    starts = np.append(0.0, np.cumsum([took for _, took in programs] + breaks)[:-1])
    length, driven = float(starts[-1] + programs[-1][1]), []
    for k, ((program, took), start) in enumerate(zip(programs, starts, strict=True)):
        clock = np.arange(rng.uniform(0.0, 1.0 / RATE), took, 1.0 / RATE)
        again = parts[k].target in [p.target for p in parts[:k]] and k == len(parts) - 1
        driven.append(Driven(program, clock, float(start), length, parts[k].target, again))
    places = {}
    for name in dict.fromkeys(p.target for p in parts):
        u = machine.spec['targets'].get(name, {}).get('u', 0.0)
        places[name] = machine.target(name)[1] + u * rng.normal(size=3)
    heading = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    rotation = turned(heading) @ turned(0.1 * rng.normal(size=3))
    tracker = np.array(TRACKER_PLACES[kind]) + rng.uniform(-0.1, 0.1, 3)
    return AxisCell(
        machine, errors, tuple(parts), tuple(driven), places, rotation, tracker,
        float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.1, 0.5)), int(rng.integers(2**31 - 1)),
    )  # fmt: skip
