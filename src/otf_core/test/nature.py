# SPDX-License-Identifier: Apache-2.0
"""An independent nature to judge the solver by: shares no formula with otf_core's solver or sim.

A cell is a machine with true error motions of some form (``nature_forms``), a drive, a tracker
and an own way of judging error tables. The kinematics are homogeneous 4x4 transforms along the
chain string of docs/conventions.md. Of otf_core only plain data types and the default path are
used, since the path is what is driven.

On the target side, axis a is the transform travel(q_a) . error(q_a) from its frame to that of
the body before it; on the table side error(q_a) . travel(q_a). The error of an axis is a
translation and the rotation Rz(C) Ry(B) Rx(A); the direction of its travel is tilted by the
squareness errors. The target relative to the table is the product from w to t applied to T.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from nature_forms import draw_curve
from nature_tracker import Noise, spoiled

from otf_core.config import PlannerConfig
from otf_core.model.machine import machine_from_dict
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.pieces.runs import Recording
from otf_core.planning.path_creation import plan_path

LETTERS = 'XYZ'
NAMES = tuple(f'E{d}{a}' for a in LETTERS for d in 'XYZABC')
SQUARE = ('C0Y', 'B0Z', 'A0Z')
ACCELERATION = 2.0
FEED_RATIO = 0.67
CHUNK = 40_000


def rotations(a, b, c):
    """Rz(c) Ry(b) Rx(a) for angles (n,), as (n, 3, 3)."""
    (sa, sb, sc), (ca, cb, cc) = np.sin([a, b, c]), np.cos([a, b, c])
    rows = [
        [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
        [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
        [-sb, cb * sa, cb * ca],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def homogeneous(rotation, translation):
    """Transforms (n, 4, 4) of rotations (n, 3, 3) and translations (n, 3)."""
    result = np.zeros((len(translation), 4, 4))
    result[:, :3, :3], result[:, :3, 3], result[:, 3, 3] = rotation, translation, 1.0
    return result


def tilted(c0y=0.0, b0z=0.0, a0z=0.0):
    """Directions of travel of X, Y, Z, rows (3, 3): X is primary, Y and Z are tilted."""
    zero = np.zeros(1)
    y = rotations(zero, zero, np.array([c0y]))[0] @ [0.0, 1.0, 0.0]
    z = rotations(np.array([a0z]), np.array([b0z]), zero)[0] @ [0.0, 0.0, 1.0]
    return np.array([[1.0, 0.0, 0.0], y, z])


def target_on_table(chain, offset, curves, square, q):
    """Exact position of the target relative to the table, less the offset; (n, 3), m.

    Parameters
    ----------
    chain : str
    offset : array (3,), m
    curves : mapping of EXX ... ECZ to callables of axis positions
    square : mapping of C0Y, B0Z, A0Z to rad
    q : array (n, 3), m
    """
    links = chain.split('-')[1:-1]
    base = links.index('b')
    travel = tilted(square['C0Y'], square['B0Z'], square['A0Z'])
    point = np.column_stack([np.tile(offset, (len(q), 1)), np.ones(len(q))])
    for place in reversed(range(len(links))):
        if place == base:
            continue
        k = LETTERS.index(links[place])
        six = [curves[f'E{d}{links[place]}'](q[:, k]) for d in 'XYZABC']
        error = homogeneous(rotations(*six[3:]), np.stack(six[:3], axis=1))
        slide = homogeneous(np.eye(3), q[:, k, None] * travel[k])
        for step in (error, slide) if place > base else (slide, error):
            point = np.matmul(step, point[:, :, None])[:, :, 0]
    return point[:, :3] - offset


def tour(low, high):
    """Corner points of a closed lap of outlines, diagonals and oblique lines."""
    square = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (1, 1), (0.5, 0), (0, 1), (1, 0.5), (0, 0)]
    points = []
    for normal in range(3):
        for level in (0.0, 0.5, 1.0):
            for pair in square:
                points.append(np.insert(np.array(pair, float), normal, level))
    space = ['000', '111', '110', '001', '011', '100', '101', '010', '000']
    points += [np.array([float(c) for c in text]) for text in space]
    moved = [True] + [bool(np.any(a != b)) for a, b in pairwise(points)]
    return low + np.array(points)[moved] * (high - low)


class Drive:
    """Programmed motion: trapezoidal speed on every leg, standstill at every corner."""

    def __init__(self, points, feed, dwell):
        length = np.linalg.norm(np.diff(points, axis=0), axis=1)
        self.points, self.length = points, length
        self.top = np.minimum(feed, np.sqrt(ACCELERATION * length))
        self.ramp = self.top / ACCELERATION
        self.cruise = np.where(length > 0, length / np.maximum(self.top, 1e-9) - self.ramp, 0.0)
        moving = 2 * self.ramp + self.cruise
        self.start = np.cumsum(dwell[:-1]) + np.concatenate([[0.0], np.cumsum(moving)[:-1]])
        self.moving = moving
        self.duration = float(self.start[-1] + moving[-1] + dwell[-1])

    def at(self, time):
        """Programmed position and speed vector, both (n, 3), at times (n,)."""
        leg = np.clip(np.searchsorted(self.start, time, side='right') - 1, 0, None)
        t = np.clip(time - self.start[leg], 0.0, self.moving[leg])
        top, ramp = self.top[leg], self.ramp[leg]
        left = self.moving[leg] - t
        way = np.where(
            t < ramp,
            0.5 * ACCELERATION * t**2,
            np.where(
                left < ramp,
                self.length[leg] - 0.5 * ACCELERATION * left**2,
                top * (t - 0.5 * ramp),
            ),
        )
        speed = np.minimum(np.minimum(t, left) * ACCELERATION, top)
        step = np.diff(self.points, axis=0)[leg]
        unit = step / np.maximum(self.length[leg], 1e-12)[:, None]
        return self.points[leg] + way[:, None] * unit, speed[:, None] * unit


@dataclass(frozen=True)
class Extra:
    """What a rigid machine lacks: drift, growth of axes, lag of drives, waves of a scale.

    Attributes
    ----------
    drift : vector (3,), m
        Reached at last: drift (1 - exp(-t / drift_time)).
    drift_time : float, s
    lag : vector (3,), s
        The target is lag * speed behind on each axis.
    cyclic : vector (3,), m
        Amplitude of a wave of the position along each axis.
    period : float, m
    growth : vector (3,), m
        Each axis is longer by so much over its whole range at the end of the run. Two bodies
        warm up one after the other: the course is half of (1 - exp(-t / a)) and half of
        (1 - (1 + t / b) exp(-t / b)), a = 0.25 and b = 0.3 of the run.
    """

    drift: tuple = (0.0, 0.0, 0.0)
    drift_time: float = 200.0
    lag: tuple = (0.0, 0.0, 0.0)
    cyclic: tuple = (0.0, 0.0, 0.0)
    period: float = 0.04
    growth: tuple = (0.0, 0.0, 0.0)

    def grown(self, share):
        """Growth at shares of the run (n,), 1 at its end."""

        def course(s):
            late = s / 0.3
            return 0.5 * (1 - np.exp(-s / 0.25)) + 0.5 * (1 - (1 + late) * np.exp(-late))

        return course(share) / course(1.0)


class Cell:
    """One machine with true errors, a path and a place of the tracker, all from one seed.

    Sizes in m; ``pitch`` of the nodes for all axes or for each of three; ``translation`` (m) and
    ``rotation`` (rad) are peaks of the error motions, about. ``path``: 'default' and 'short'
    (fewer planes) of the project's planner, 'tour' (own: outlines, diagonals and oblique lines
    of nine planes, space diagonals), or the corner points of a lap, (n, 3), m.
    """

    def __init__(
        self,
        seed=1,
        chain='w-b-X-Y-Z-t',
        size=(0.6, 0.5, 0.4),
        pitch=0.03,
        form='waves',
        translation=60e-6,
        rotation=90e-6,
        offset=(0.0, 0.0, -0.15),
        u_range=0.5e-6,
        u_angle=1.5e-6,
        path='default',
        passes=2,
        feed=0.25,
        dwell=0.2,
        extra=None,
    ):
        rng = np.random.default_rng([20261101, seed, *chain.encode()])
        ends = {'X': (0.0, size[0]), 'Y': (0.0, size[1]), 'Z': (-size[2], 0.0)}
        pitches = dict(zip(LETTERS, np.broadcast_to(np.array(pitch), 3).tolist(), strict=True))
        axes = {a: {'min': e[0], 'max': e[1], 'table_pitch': pitches[a]} for a, e in ends.items()}
        self.machine = machine_from_dict(
            {
                'name': f'nature-{seed}',
                'chain': chain,
                'axes': axes,
                'target_offset': [float(v) for v in offset],
                'tracker': {'u_range': u_range, 'u_angle': u_angle},
            }
        )
        self.seed, self.chain, self.form, self.extra = seed, chain, form, extra or Extra()
        self.offset, self.translation, self.rotational = np.array(offset), translation, rotation
        self.curves = {
            n: draw_curve(
                rng,
                form,
                *ends[n[2]],
                translation if n[1] in LETTERS else rotation,
                pitches[n[2]],
            )
            for n in NAMES
        }
        self.square = {n: float(0.5 * rotation * rng.normal()) for n in SQUARE}
        self._cyclic_phase = rng.uniform(0, 2 * np.pi, 3)
        low, high = np.array([ends[a] for a in LETTERS]).T
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        self.rotation = turn * np.sign(np.linalg.det(turn))
        side, reach = rng.uniform(0, 2 * np.pi), 0.5 * np.linalg.norm(high - low)
        reach += rng.uniform(0.2, 0.5)
        self.place = 0.5 * (low + high) + reach * np.array(
            [np.cos(side), np.sin(side), rng.uniform(-0.3, 0.3)]
        )
        self._plan(path, passes, feed, dwell)

    def _plan(self, path, passes, feed, dwell):
        if isinstance(path, str) and path == 'tour':
            lap = tour(self.machine.lower, self.machine.upper)
        elif isinstance(path, str):
            config = {'default': {'levels': 3}, 'short': {'levels': 2}}[path]
            lap = plan_path(self.machine, PlannerConfig(passes=1, **config)).path.points
        else:
            lap = np.asarray(path, float)
        parts = [lap if k % 2 == 0 else lap[::-1] for k in range(passes)]
        parts = [parts[0], *(p[1:] for p in parts[1:])]
        points = np.concatenate(parts)
        self.path = NominalPath(points)
        speeds = [feed * (FEED_RATIO if k % 2 else 1.0) for k in range(passes)]
        self.feed = np.repeat(speeds, len(lap) - 1)
        self.dwell = np.full(len(points), float(dwell))
        self.dwell[[0, -1]] = 3.0
        self.drive = Drive(points, self.feed, self.dwell)

    def position(self, q):
        """Exact position of the target relative to the table, (n, 3), m."""
        done = []
        for start in range(0, len(q), CHUNK):
            part = q[start : start + CHUNK]
            wave = 2 * np.pi * part / self.extra.period + self._cyclic_phase
            own = np.array(self.extra.cyclic) * np.sin(wave)
            done.append(
                own + target_on_table(self.chain, self.offset, self.curves, self.square, part)
            )
        return np.concatenate(done)

    def error(self, q):
        """Displacement of the target relative to the table at programmed q; (n, 3), m."""
        return self.position(q) - q

    def recording(self, rate=200.0, noise=None, noise_seed=0, **levels):
        """Record the run; ``levels``: fields of ``Noise``. The levels default to machine.yaml."""
        spec = self.machine.tracker
        noise = noise or Noise(**{'u_range': spec.u_range, 'u_angle': spec.u_angle, **levels})
        rng = np.random.default_rng([977, self.seed, noise_seed, *self.chain.encode()])
        time = rng.uniform(0, 1 / rate) + np.arange(int(self.drive.duration * rate)) / rate
        q, speed = self.drive.at(time)
        actual = self.position(q) - np.array(self.extra.lag) * speed
        gone = 1.0 - np.exp(-time / self.extra.drift_time)
        actual += gone[:, None] * np.array(self.extra.drift)
        longer = np.array(self.extra.growth) / (self.machine.upper - self.machine.lower)
        actual += self.extra.grown(time / time[-1])[:, None] * longer * q
        xyz = self.measured(actual, noise, 1 / rate, rng)
        clock = rng.uniform(0, 1e8) + time * (1.0 + rng.uniform(-2e-5, 2e-5))
        stamp = np.int64(1_700_000_000_000_000_000) + np.rint(clock * 1e9).astype(np.int64)
        return Recording(Samples(stamp, xyz), self.path, self.machine)

    def measured(self, actual, noise, step, rng):
        """What the tracker reads of points (n, 3) in the machine frame: its own frame, noise."""
        return spoiled((actual - self.place) @ self.rotation.T, noise, step, rng)

    def lattice(self, count=6):
        """Points in the driven volume that meet neither nodes nor corners; (count^3, 3), m."""
        rng = np.random.default_rng([31, self.seed])
        low, high = self.path.points.min(axis=0), self.path.points.max(axis=0)
        grids = [
            low[k] + (np.arange(count) + rng.uniform(0.07, 0.93, count)) / count * (high - low)[k]
            for k in range(3)
        ]
        return np.stack(np.meshgrid(*grids, indexing='ij'), axis=-1).reshape(-1, 3)


def levers(chain, offset, q):
    """Lever arm of every axis as docs/conventions.md states it: name to (n, 3), m."""
    links = chain.split('-')[1:-1]
    base = links.index('b')
    found = {}
    for place, axis in enumerate(links):
        if axis == 'b':
            continue
        carried = links[place + 1 :] if place > base else links[place:]
        mask = np.array([letter in carried for letter in LETTERS], float)
        found[axis] = offset + mask * q
    return found


def influences(chain, offset, q):
    """Displacement per unit of every error at q: names of SQUARE and NAMES to (n, 3)."""
    arms, unit, none = levers(chain, offset, q), np.eye(3), np.zeros(len(q))
    x, y = unit[0], unit[1]
    found = {
        'C0Y': -q[:, 1, None] * x,
        'B0Z': q[:, 2, None] * x,
        'A0Z': -q[:, 2, None] * y,
    }
    for name in NAMES:
        if name[1] in LETTERS:
            found[name] = none[:, None] + unit[LETTERS.index(name[1])]
        else:
            found[name] = np.cross(unit['ABC'.index(name[1])], arms[name[2]])
    return found


def hat(nodes, q):
    """Weights of table nodes at positions q, (n, k); constant outside."""
    return np.stack([np.interp(q, nodes, row) for row in np.eye(len(nodes))], axis=1)


def table_rows(tables, chain, offset, q):
    """Derivatives (n, 3, m) by C0Y, B0Z, A0Z and the nodes of EXX ... ECZ, and their values."""
    influence = influences(chain, offset, q)
    rows = [influence[n][:, :, None] for n in SQUARE]
    values = [[tables.squareness[n].value for n in SQUARE]]
    for name in NAMES:
        table = tables.motions[name]
        weights = hat(table.position, q[:, LETTERS.index(name[2])])
        rows.append(influence[name][:, :, None] * weights[:, None, :])
        values.append(table.value)
    return np.concatenate(rows, axis=2), np.concatenate(values)


def no_rigid_motion(q):
    """Projector (3n, 3n) that takes translations and small rotations out of a field at q."""
    columns = [np.tile(unit, (len(q), 1)).ravel() for unit in np.eye(3)]
    columns += [np.cross(unit, q).ravel() for unit in np.eye(3)]
    basis = np.linalg.qr(np.stack(columns, axis=1))[0]
    return np.eye(3 * len(q)) - basis @ basis.T


@dataclass(frozen=True)
class Judgement:
    """Grid error before and after, um; share of it, %; components within 2 u, %; |error|/u."""

    before_um: float
    left_um: float
    left_percent: float
    within_2u_percent: float
    median_ratio: float


def judge(cell, tables, covariance=None, count=6):
    """Compare tables with the true errors on a lattice, rigid motion removed of both."""
    q = cell.lattice(count)
    rows, values = table_rows(tables, cell.chain, cell.offset, q)
    flat = rows.reshape(3 * len(q), -1)
    truth = cell.error(q).ravel()
    return judge_field(q, truth, flat, values, covariance)


def judge_field(q, truth, flat, values, covariance=None):
    """Judge a prediction flat @ values (3n,) by the truth (3n,) at q; a ``Judgement``."""
    free = no_rigid_motion(q)
    left = free @ (flat @ values - truth)
    lengths = [np.linalg.norm(f.reshape(-1, 3), axis=1).mean() for f in (free @ truth, left)]
    within = median = np.nan
    if covariance is not None:
        part = free @ flat
        u = np.sqrt(np.maximum(np.einsum('ij,ij->i', part @ covariance, part), 1e-30))
        ratio = np.abs(left) / u
        within, median = 100 * float(np.mean(ratio <= 2)), float(np.median(ratio))
    before, after = 1e6 * float(lengths[0]), 1e6 * float(lengths[1])
    return Judgement(before, after, 100 * after / before, within, median)
