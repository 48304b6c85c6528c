# SPDX-License-Identifier: Apache-2.0
"""Machines, what is driven on them and where their tracker stands, drawn from a generator.

Three linear axes on any chain, of 0.3 m to 6 m; a tilting table seen from the bed, a rotary table
that carries the tracker, a swivel head. A kind of machine is one function that returns a machine
and its parts; ``nature`` takes any chain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from blind.effects import DRIFTS, SENSOR, follow
from blind.nature import LINEAR, Array, Machine, Noise, Part, Rng, Run, draw_errors, turned

CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
OTHER_CHAINS = ('w-X-b-Y-Z-t', 'w-Z-b-X-Y-t', 'w-b-Y-X-Z-t', 'w-Y-X-b-Z-t', 'w-X-b-Z-Y-t')
RECORDED = ((0.19e-6, 0.83e-6), (0.21e-6, 1.40e-6), (0.05e-6, 1.15e-6), (0.23e-6, 1.11e-6))
"""m and rad; medians of the standard deviations at rest of a real tracker along and across its
beam, by session (MarvinGravert, Vive-Accuracy-Experiment, MIT licence)."""
RECORDED_COLOUR = (0.8, 0.12)
"""Share of the variance that is correlated, and for how long, s: of a standstill of a real tracker
(THL Smart Factory Lab, look-where-you-work, UDP_dyn2, MIT licence)."""
ROTARY_MACHINES = {'trunnion': 0.6, 'rotary': 0.25, 'head': 0.15}
"""Kinds of machines with rotary axes, and how often they are drawn."""
BESIDE = {'trunnion': (-1.0, 0.7, 1.0), 'rotary': (-0.9, 0.8, 0.6), 'head': (-1.0, -1.0, 0.5)}
"""m; where their tracker stands in its link."""
_PLANE = ((0, 0), (1, 1), (1, 0), (0, 1), (0, 0), (0.5, 0), (0.5, 1), (1, 1), (1, 0.5),
          (0, 0.5), (0, 0))  # fmt: skip
_SPACE = ((0, 0, 0), (1, 1, 1), (1, 0, 0), (0, 1, 1), (0, 1, 0), (1, 0, 1), (0, 0, 1), (1, 1, 0),
          (0.3, 0.2, 0.1))  # fmt: skip


def _without_repeats(q: Array) -> Array:
    return np.asarray(q[np.append(True, np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-9)])


# Three linear axes.


def three_axes(rng: Rng, *, large: bool = False, sensor: bool = False) -> Machine:
    """Draw chain, ranges, node spacing, target offset and tracker; ``large``: of 2 m to 6 m."""
    chain = str(rng.choice(CHAINS if rng.random() < 0.75 else OTHER_CHAINS))
    size, pitch = np.array([0.6, 0.5, 0.4]), 0.03 if rng.random() < 0.7 else 0.05
    if large:
        size, pitch = np.round(rng.uniform([2.0, 1.2, 0.8], [6.0, 2.5, 1.2]), 1), 0.1
    elif rng.random() < 0.4:
        size = np.round(rng.uniform([0.45, 0.4, 0.3], [0.9, 0.7, 0.5]), 2)
    low = np.array([0.0, 0.0, -size[2]])
    levels = RECORDED[int(rng.integers(len(RECORDED)))]
    if rng.random() < 0.6:
        levels = 0.5e-6, float(rng.uniform(1.0e-6, 2.2e-6))
    spec: dict[str, Any] = {
        'name': 'cell',
        'chain': chain,
        'axes': {a: {'min': float(low[k]), 'max': float(low[k] + size[k]), 'table_pitch': pitch}
                 for k, a in enumerate(LINEAR)},
        'target_offset': np.round(rng.normal((0.0, 0.0, -0.15), 0.02), 4).tolist(),
        'tracker': {'u_range': levels[0], 'u_angle': levels[1]},
    }  # fmt: skip
    if sensor:
        acts_on = ['thermal_axis_expansion', *DRIFTS]
        spec['signals'] = {SENSOR: {'unit': 'degC', 'acts_on': acts_on}}
    return Machine(spec)


def figures(rng: Rng) -> Array:
    """Corners of one lap in the unit cube: face figures at three levels, space diagonals."""
    points: list[Array] = []
    for normal in rng.permutation(3):
        for level in (0.0, 0.5, 1.0):
            points.extend(np.insert(np.array(_PLANE, float), normal, level, axis=1))
    lap = np.array([*points, *np.array(_SPACE, float)])
    mirrored = rng.random(3) < 0.5
    lap[:, mirrored] = 1.0 - lap[:, mirrored]
    return _without_repeats(lap)


def chords(rng: Rng) -> Array:
    """Corners in the unit cube: lines along the axes, then chords; all there and back."""
    points: list[Array] = []
    for axis in (*range(3), *range(3), *range(3), *rng.integers(3, size=14)):
        ends = rng.uniform(0.0, 1.0, (2, 3))
        if len(points) < 27:
            ends[1] = ends[0]
        ends[:, axis] = 0.0, 1.0
        points.extend(ends[[0, 1, 0]])
    return _without_repeats(np.array(points))


def path_of_three(machine: Machine, rng: Rng, *, large: bool = False) -> Part:
    """Draw one or two laps of figures; ``large``: one lap of fast chords."""
    low, high = machine.ends(LINEAR)
    if large:
        lap = low + chords(rng) * (high - low)
        feed = rng.uniform(0.4, 0.8) * rng.choice([0.7, 1.0], len(lap) - 1)
        return Part('tool', lap, feed, rest=3.0)
    lap, feed = low + figures(rng) * (high - low), float(rng.uniform(0.12, 0.25))
    feeds, laps = [np.full(len(lap) - 1, feed)], [lap]
    if rng.random() < 0.75:
        back = lap[::-1] if rng.random() < 0.85 else np.concatenate([lap[-1:], lap])
        laps.append(back[1:])
        ratio = float(rng.choice([1.5, 1.5, 0.67, 1.25, 1.0]))
        feeds.append(np.full(len(back) - 1, feed * ratio))
    return Part('tool', np.concatenate(laps), np.concatenate(feeds),
                rest=float(rng.uniform(0.4, 3.0)))  # fmt: skip


def runs_of_three(
    rng: Rng, places: int = 1, *, large: bool = False, sensor: bool = False
) -> list[Run]:
    """Draw a machine, its path, and as many places of the tracker."""
    machine = three_axes(rng, large=large, sensor=sensor)
    part = path_of_three(machine, rng, large=large)
    errors = draw_errors(machine, rng, float(np.exp(rng.uniform(np.log(0.6), np.log(3.0)))))
    share, time = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.1, 0.5))
    if rng.random() < 0.25:
        share, time = RECORDED_COLOUR
    low, high = machine.ends(LINEAR)
    runs = []
    for _ in range(places):
        side, beside = rng.uniform(0, 2 * np.pi), 0.5 * float(np.hypot(*(high - low)[:2]))
        beside += rng.uniform(0.15, 0.35)
        place = 0.5 * (low + high) + beside * np.array([np.cos(side), np.sin(side), 0.0])
        place[2] += (high - low)[2] * rng.uniform(-0.6, 0.2)
        axis = rng.normal(size=3)
        runs.append(Run(
            machine, errors, (part,), (0.0,), {'tool': machine.target('tool')[1]},
            turned(axis * rng.uniform(0.0, np.pi) / np.linalg.norm(axis)), place,
            Noise(share, time), 500.0 if large else 100.0, float(rng.normal(0, 1e-5)),
            int(rng.integers(2**31 - 1)), _warming(rng) if sensor else (np.zeros(0), np.zeros(0)),
        ))  # fmt: skip
    return runs


def _warming(rng: Rng) -> tuple[Array, Array]:
    """What a sensor beside the spindle says while the spindle goes on and off."""
    time = np.arange(0.0, 3600.0)
    on = (np.floor(time / rng.uniform(90.0, 240.0)) % 2 == 0).astype(float)
    return time, 20.0 + 8.0 * follow(time, on, rng.uniform(60.0, 150.0)) + 0.02 * rng.normal(
        size=len(time)
    )


# Machines with rotary axes.


def rotary_spec(kind: str, rng: Rng) -> dict[str, Any]:
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


def _at(machine: Machine, count: int, **positions: Array | float) -> Array:
    """Corners, axes that are not given at zero or the end next to it."""
    low, high = machine.ends(machine.letters)
    q = np.tile(np.clip(0.0, low, high), (count, 1))
    for axis, values in positions.items():
        q[:, machine.column(axis)] = values
    return q


def lines(machine: Machine, rng: Rng, count: int) -> Array:
    """Space diagonals, then chords between faces, there and back."""
    points = [np.array([(k >> b) & 1 for b in range(3)], float) for k in (0, 7, 1, 6, 3, 4, 2, 5)]
    while len(points) <= count:
        one = rng.uniform(size=3)
        one[rng.integers(3)] = rng.integers(2)
        if np.linalg.norm(one - points[-1]) > 0.75:
            points.append(one)
    low, high = machine.ends(LINEAR)
    xyz = low + np.array(points[: count + 1] + points[count - 1 :: -1]) * (high - low)
    return _at(machine, len(xyz), **dict(zip(LINEAR, xyz.T, strict=True)))


def nest_turns(machine: Machine, number: int) -> Array:
    """Circles, arcs, and both rotary axes together in both senses, for one nest."""
    (a0, a1), (c0, c1) = machine.range_of('A'), machine.range_of('C')
    corners = [(0.0, c0), (0.0, c1), (0.0, c0), (a0, c0), (a1, c0), (a0, c0)]
    sweeps = number % 3 + 1
    for first, last in ((a0, a1), (a1, a0)):
        leg = [(last if k % 2 else first, c0 + (c1 - c0) * k / sweeps) for k in range(sweeps + 1)]
        corners += leg + leg[::-1]
    a, c = np.array(corners).T
    return _without_repeats(_at(machine, len(a), A=a, C=c, Z=0.5))


def held_at(machine: Machine, name: str, q: Array, points: Array) -> Array:
    """Positions at which a reflector on the tool is at points (n, 3) of the table's frame, m."""
    q = q.copy()
    for _ in range(2):  # linear in these axes
        now, slopes = machine.at(q, name), np.zeros((len(q), 3, 3))
        for k, axis in enumerate(LINEAR):
            other = q.copy()
            other[:, machine.column(axis)] += 0.1
            slopes[:, :, k] = (machine.at(other, name) - now) / 0.1
        step = np.linalg.solve(slopes, (points - now)[..., None])[..., 0]
        for k, axis in enumerate(LINEAR):
            q[:, machine.column(axis)] += step[:, k]
    return q


CORNER = np.radians(0.5)
"""rad; between two corners of a creep: the chord is then some micrometres off the arc."""
CREEPS = ((0.0, 0.0, 0.075), (0.055, 0.05, 0.0))
"""m; slow travel during one turn; at the rates that are drawn never as slow as a standstill."""


def creep(
    machine: Machine, name: str, axis: str, middle: Array, slow: Array, rest: Mapping[str, float]
) -> Array:
    """One rotary axis through its range and back while the reflector creeps by ``slow``, m."""
    low, high = machine.range_of(axis)
    count = int(np.ceil((high - low) / CORNER)) + 1
    share = np.linspace(0.0, 1.0, count)
    q = _at(machine, count, **dict(rest), **{axis: low + (high - low) * share})
    q = held_at(machine, name, q, middle + np.outer(share - 0.5, slow))
    return np.concatenate([q, q[-2::-1]])


def creeps(machine: Machine, name: str, rng: Rng, places: Sequence[Sequence[float]]) -> Array:
    """Creeps of every rotary axis at places of the table, nudged until they are in range."""
    low, high = machine.ends(machine.letters)
    stands, parts = {'A': (0.6, -0.9), 'C': (0.0, 1.6)}, []
    for number, place in enumerate(places):
        for slow in CREEPS:
            for axis in machine.turning:
                rest = [a for a in machine.turning if a != axis]
                for other in [{a: v} for a in rest for v in stands[a][: 1 if number else 2]] or [
                    {}
                ]:
                    for share in (1.0, 0.8, 0.6, 0.4, 0.2):
                        middle = np.array(place) * [share, share, 1.0]
                        middle = middle + rng.uniform(-0.01, 0.01, 3)
                        q = creep(machine, name, axis, middle, np.array(slow), other)
                        if np.all((q > low - 1e-9) & (q < high + 1e-9)):
                            parts.append(q)
                            break
    return _without_repeats(np.concatenate(parts))


def parts_of_rotary(machine: Machine, rng: Rng) -> list[Part]:
    """Draw what is driven."""
    feed, turn = rng.uniform(0.06, 0.09), np.radians(rng.uniform(16.0, 24.0))
    slower, around = float(rng.choice([0.45, 0.6])), rng.uniform(0.12, 0.18)
    round_about = np.radians(rng.uniform(22.0, 28.0))

    def part(name: str, q: Array, feed: float, turn: float) -> Part:
        return Part(name, q, np.full(len(q) - 1, feed), turn, (0.3, np.radians(60.0)), 0.1)

    parts = [part('tool', lines(machine, rng, 8), feed, turn)]
    if machine.spec['name'] != 'head':
        parts.append(part('long', lines(machine, rng, 5), slower * feed, turn))
    if machine.spec['name'] == 'trunnion':
        for k in range(3):
            rate = slower * turn if k == 1 else turn
            parts.append(part(f'nest-{k + 1}', nest_turns(machine, k), feed, rate))
    elif machine.spec['name'] == 'rotary':
        places = [(0.14, 0.02, 0.1), (-0.08, 0.12, 0.05), (-0.07, -0.13, 0.2)]
        for ratio, own in ((1.0, places), (0.8, places[:2])):
            q = creeps(machine, 'tool', rng, own)
            parts.append(part('tool', q, ratio * around, ratio * round_about))
    else:
        places = [(0.0, 0.0, 0.12), (0.04, -0.03, 0.25)]
        for name, ratio in (('tool', 1.0), ('long', 0.8), ('side', 1.0)):
            q = creeps(machine, name, rng, places if name == 'tool' else places[1:])
            parts.append(part(name, q, ratio * around, ratio * round_about))
    if rng.random() < 0.7:
        again = 'nest-1' if machine.spec['name'] == 'trunnion' else 'long'
        parts.append(next(p for p in parts if p.target == again))
    return parts


def run_of_rotary(kind: str, rng: Rng) -> Run:
    """Draw a run of a machine with rotary axes: one place of the tracker, several parts."""
    machine = Machine(rotary_spec(kind, rng))
    return run_along(machine, parts_of_rotary(machine, rng), rng)


def run_along(machine: Machine, parts: Sequence[Part], rng: Rng) -> Run:
    """Draw errors, places, tracker and breaks between given parts."""
    errors = draw_errors(machine, rng)
    places = {}
    for name in dict.fromkeys(p.target for p in parts):
        u = machine.spec['targets'].get(name, {}).get('u', 0.0)
        places[name] = machine.target(name)[1] + u * rng.normal(size=3)
    heading = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    run = Run(
        machine, errors, tuple(parts), (0.0,) * len(parts), places,
        turned(heading) @ turned(0.1 * rng.normal(size=3)),
        np.array(BESIDE[machine.spec['name']]) + rng.uniform(-0.1, 0.1, 3),
        Noise(float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.1, 0.5))),
        seed=int(rng.integers(2**31 - 1)),
    )  # fmt: skip
    breaks = rng.uniform(5.0, 20.0, len(parts))
    lasted = np.array([p.duration for p in run.programs])
    starts = np.append(0.0, np.cumsum(lasted + breaks)[:-1])
    return replace(run, starts=tuple(starts.tolist()))
