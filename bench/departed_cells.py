# SPDX-License-Identifier: Apache-2.0
"""Cells of the independent nature in which causes take forms that no catalogue holds.

Displacements are plain functions of what a simulated drive does; they share no formula and no code
with the effects of ``otf_core``. Every cause is a function of a ``View`` that returns (n, 3), m,
scaled afterwards so that what lies across the path has a given root mean square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from nature import Cell
from nature_tracker import Noise

from otf_core.model.observation import Samples
from otf_core.pieces.runs import Recording


@dataclass(frozen=True)
class View:
    """What a drive does at every sample of a run; arrays over samples (n, ...)."""

    time: np.ndarray
    share: np.ndarray
    q: np.ndarray
    u: np.ndarray
    direction: np.ndarray
    speed: np.ndarray
    feed: np.ndarray
    sense: np.ndarray
    side: np.ndarray
    since: np.ndarray
    start: np.ndarray
    end: np.ndarray
    inside_start: np.ndarray
    inside_end: np.ndarray
    since_start: np.ndarray
    lap: np.ndarray
    beam: np.ndarray
    rng: np.random.Generator

    def pick(self, *choices):
        """One of some values."""
        return choices[self.rng.integers(len(choices))]

    def axes(self):
        """Numbers of two different axes."""
        return self.rng.permutation(3)[:2]

    def unit(self):
        """A random direction, no component of it small."""
        v = self.rng.choice([-1.0, 1.0], 3) * self.rng.uniform(0.3, 1.0, 3)
        return v / np.linalg.norm(v)


def view_of(cell, time, q, velocity, rng):
    """Work out a ``View`` from the drive of a cell."""
    drive, points = cell.drive, cell.path.points
    leg = np.clip(np.searchsorted(drive.start, time, side='right') - 1, 0, None)
    step = np.diff(points, axis=0)
    unit = step / np.linalg.norm(step, axis=1)[:, None]
    along = np.linalg.norm(q - points[leg], axis=1)
    turn = np.diff(unit, axis=0)
    first, last = np.vstack([np.zeros(3), turn]), np.vstack([turn, np.zeros(3)])
    sense_leg = np.where(np.abs(unit) > 1e-9, np.sign(unit), 0.0)
    side, since = np.zeros_like(unit), np.zeros_like(unit)
    travelled, now = np.zeros(3), sense_leg[0].copy()
    for k in range(len(unit)):
        turned = (sense_leg[k] != 0) & (sense_leg[k] != now)
        travelled[turned] = 0.0
        now = np.where(sense_leg[k] != 0, sense_leg[k], now)
        side[k], since[k] = now, travelled
        travelled = travelled + np.abs(step[k])
    length = np.linalg.norm(step, axis=1)
    speed = np.linalg.norm(velocity, axis=1)
    return View(
        time=time,
        share=time / time[-1],
        q=q,
        u=2 * (q - cell.machine.lower) / (cell.machine.upper - cell.machine.lower) - 1,
        direction=unit[leg],
        speed=speed,
        feed=drive.top[leg],
        sense=sense_leg[leg],
        side=side[leg],
        since=since[leg] + np.abs(unit[leg]) * along[:, None],
        start=along,
        end=length[leg] - along,
        inside_start=first[leg],
        inside_end=last[leg],
        since_start=np.maximum(time - drive.start[leg], 0.0),
        lap=(leg >= len(unit) // 2).astype(float),
        beam=q - cell.place,
        rng=rng,
    )


# ---------------------------------------------------------------- known causes, other forms


def corner_cosine(v):
    """Rounded over 30 to 60 mm, as a raised cosine, in proportion to the turn."""
    reach = v.rng.uniform(0.03, 0.06)

    def course(s):
        return np.where(s < reach, 0.5 + 0.5 * np.cos(np.pi * s / reach), 0.0)[:, None]

    return course(v.start) * v.inside_start + course(v.end) * v.inside_end


def corner_parabola(v):
    """A parabola to a corner 30 to 60 mm away, longer after it than before."""
    reach = v.rng.uniform(0.03, 0.045)

    def course(s, r):
        return (np.clip(1.0 - s / r, 0.0, None) ** 2)[:, None]

    first, last = course(v.start, 1.4 * reach), course(v.end, reach)
    return first * v.inside_start + last * v.inside_end


def corner_fast(v):
    """Rounding that is wider the faster the leg."""
    reach = 0.04 * (v.feed / v.feed.max()) ** 2

    def course(s):
        return np.exp(-0.5 * (s / (0.5 * reach)) ** 2)[:, None]

    return course(v.start) * v.inside_start + course(v.end) * v.inside_end


def tilt_square(v):
    """The table tilts with the square of a position."""
    a = v.rng.integers(3)
    angle = v.u[:, a] ** 2 + 0.5 * v.u[:, a]
    return angle[:, None] * np.cross(np.eye(3)[v.rng.integers(2)], v.beam)


def tilt_kink(v):
    """The table tilts once the load has passed a support."""
    a, at = v.rng.integers(3), v.rng.uniform(-0.3, 0.3)
    angle = np.clip(v.u[:, a] - at, 0.0, None)
    return angle[:, None] * np.cross(np.eye(3)[v.rng.integers(2)], v.beam)


def backlash_warm(v):
    """Play that doubles or halves while the run lasts."""
    size = 1.0 + v.pick(-0.6, 1.0) * (1 - np.exp(-3 * v.share)) / (1 - np.exp(-3))
    part = np.zeros(3)
    part[v.axes()] = v.rng.uniform(0.6, 1.0, 2) * v.rng.choice([-1, 1], 2)
    return size[:, None] * v.side * part


def backlash_wound(v):
    """Play that is taken up over the first centimetres after a reversal."""
    size = 1.0 - 0.9 * np.exp(-v.since / v.rng.uniform(0.02, 0.05))
    part = np.zeros(3)
    part[v.axes()] = v.rng.uniform(0.6, 1.0, 2)
    return size * v.side * part


def backlash_worn(v):
    """Play that is large where a screw is worn."""
    a = v.rng.integers(3)
    size = 0.3 + np.exp(-0.5 * ((v.u[:, a] - v.rng.uniform(-0.4, 0.4)) / 0.35) ** 2)
    return (size * v.sense[:, a])[:, None] * np.eye(3)[a]


def expansion_two(v):
    """An axis that warms up quickly, then with its bed; not quite uniform."""
    course = 0.6 * (1 - np.exp(-v.share / 0.08)) + 0.4 * v.share**1.5
    a = v.rng.integers(3)
    way = (v.u[:, a] + 1) / 2
    return (course * way**1.15)[:, None] * np.eye(3)[a]


def expansion_room(v):
    """Axes that breathe with the room."""
    course = np.sin(2 * np.pi * v.share * v.rng.uniform(1.2, 2.0)) + 0.5 * v.share
    return course[:, None] * v.q * np.array([1.0, 0.8, 1.2])


def drift_spindle(v):
    """Spindle on, off and on again: the structure grows and shrinks."""
    on = (np.floor(v.share * v.rng.uniform(3.5, 5.0)) % 2 == 0).astype(float)
    state, tau = np.zeros(len(v.time)), 0.12 * v.time[-1]
    step = v.time[1] - v.time[0]
    for k in range(1, len(state)):
        state[k] = state[k - 1] + step / tau * (on[k] - state[k - 1])
    return state[:, None] * np.array([0.3, 0.2, 1.0])


def drift_late(v):
    """A structure that stays, then gives way, then stays."""
    course = 1 / (1 + np.exp(-(v.share - v.rng.uniform(0.35, 0.65)) / 0.06))
    return course[:, None] * v.unit()


def pose_creep(v):
    """The tracker creeps and comes half back."""
    course = np.sin(np.pi * v.share**0.7) + 0.4 * v.share
    return course[:, None] * np.cross(v.unit(), v.beam)


def droop(v):
    """A beam that droops with the cube of its reach, more where the saddle is far out."""
    a, b = v.axes()
    reach, place = (v.u[:, a] + 1) / 2, (v.u[:, b] + 1) / 2
    return (reach**3 * np.exp(1.5 * place))[:, None] * np.eye(3)[2]


def yaw_far(v):
    """A gantry that racks beyond the middle only."""
    a, b = v.axes()
    bent = np.clip(v.u[:, a], 0, None) ** 1.5 * np.sin(1.8 * v.u[:, b])
    return bent[:, None] * np.eye(3)[a]


def cyclic_growing(v):
    """A screw that wobbles more towards its end, with a second harmonic."""
    a, pitch = v.rng.integers(3), v.pick(0.016, 0.02, 0.025)
    phase = 2 * np.pi * v.q[:, a] / pitch + 1.0
    wave = np.sin(phase) + 0.4 * np.sin(2 * phase + 0.5)
    return ((0.4 + 0.6 * (v.u[:, a] + 1) / 2) * wave)[:, None] * np.eye(3)[a]


def servo_soft(v):
    """Loops that lag less than in proportion, and settle after every start."""
    lag = v.speed**0.8 * (1 - 0.7 * np.exp(-v.since_start / 0.25))
    part = np.array([1.0, -0.4, 0.0])[v.rng.permutation(3)]
    return lag[:, None] * v.direction * part


def ringing(v):
    """The column rings after every start and calms down."""
    f, tau = v.rng.uniform(6.0, 14.0), v.rng.uniform(0.4, 0.8)
    wave = np.exp(-v.since_start / tau) * np.sin(2 * np.pi * f * v.since_start)
    return wave[:, None] * v.unit()


DEPARTED = {
    'corner_cosine': (corner_cosine, {'corner_rounding'}),
    'corner_parabola': (corner_parabola, {'corner_rounding'}),
    'corner_fast': (corner_fast, {'corner_rounding'}),
    'tilt_square': (tilt_square, {'table_tilt'}),
    'tilt_kink': (tilt_kink, {'table_tilt'}),
    'backlash_warm': (backlash_warm, {'backlash'}),
    'backlash_wound': (backlash_wound, {'backlash'}),
    'backlash_worn': (backlash_worn, {'backlash', 'direction_dependent_tables'}),
    'expansion_two': (expansion_two, {'thermal_axis_expansion'}),
    'expansion_room': (expansion_room, {'thermal_axis_expansion'}),
    'drift_spindle': (drift_spindle, {'thermal_structure_drift', 'tracker_pose_drift'}),
    'drift_late': (drift_late, {'thermal_structure_drift', 'tracker_pose_drift'}),
    'pose_creep': (pose_creep, {'tracker_pose_drift'}),
    'droop': (droop, {'cross_coupling'}),
    'yaw_far': (yaw_far, {'cross_coupling'}),
    'cyclic_growing': (cyclic_growing, {'cyclic_error'}),
    'servo_soft': (servo_soft, {'servo_mismatch'}),
    'ringing': (ringing, {'vibration'}),
}

# ---------------------------------------------------------------- causes of no catalogue


def square_of_feed(v):
    """Slides float up with the square of the feed."""
    return ((v.speed / v.feed.max()) ** 2)[:, None] * np.array([0.2, 0.1, 1.0])


def senses_together(v):
    """The frame racks when two drives push against each other."""
    return (v.sense[:, 0] * v.sense[:, 1])[:, None] * np.array([0.3, 0.2, 1.0])


def clamped(v):
    """A slide that stands is pulled aside by its clamp, more as the run goes on."""
    a = v.rng.integers(3)
    stands = (v.sense[:, a] == 0) * (0.5 + v.share)
    return stands[:, None] * np.roll(np.eye(3)[a], 1)


def sagging_clock(v):
    """One side of the machine sinks as time goes on."""
    a, b = v.axes()
    return (v.share**1.5 * np.tanh(2 * v.u[:, a]))[:, None] * np.eye(3)[b]


def hot_beam(v):
    """Air above a motor bends the beam at some azimuths and ranges, after a while."""
    reach = np.linalg.norm(v.beam, axis=1)
    azimuth = np.arctan2(v.beam[:, 1], v.beam[:, 0])
    centre = np.angle(np.exp(1j * azimuth).mean())
    off = np.angle(np.exp(1j * (azimuth - centre)))
    return (v.share * reach**2 * np.sin(6 * off))[:, None] * np.array([0.0, 0.0, 1.0])


UNKNOWN = {
    'square_of_feed': (square_of_feed, {'feed'}),
    'senses_together': (senses_together, {'sense_x', 'sense_y'}),
    'clamped': (clamped, {'time'}),
    'sagging_clock': (sagging_clock, {'time'}),
    'hot_beam': (hot_beam, {'time', 'azimuth'}),
}

# ---------------------------------------------------------------- textbook


def textbook_backlash(v):
    """Constant play of one axis."""
    a = v.rng.integers(3)
    return v.sense[:, a, None] * np.eye(3)[a]


def textbook_expansion(v):
    """An axis that approaches its temperature."""
    a = v.rng.integers(3)
    return ((1 - np.exp(-v.share / 0.4)) * (v.u[:, a] + 1))[:, None] * np.eye(3)[a]


def textbook_drift(v):
    """The structure approaches its temperature."""
    return (1 - np.exp(-v.share / 0.3))[:, None] * np.array([0.3, 0.2, 1.0])


def textbook_lag(v):
    """One axis lags in proportion to its speed."""
    a = v.rng.integers(3)
    return -(v.speed * v.direction[:, a])[:, None] * np.eye(3)[a]


def textbook_coupling(v):
    """Product of two positions."""
    a, b = v.axes()
    return (v.u[:, a] ** 2 * v.u[:, b])[:, None] * np.eye(3)[2]


def textbook_corner(v):
    """Exponential rounding over 10 mm."""

    def inside(turn):
        return turn / np.maximum(np.linalg.norm(turn, axis=1), 1e-9)[:, None]

    first, last = (np.exp(-s / 0.012)[:, None] for s in (v.start, v.end))
    return first * inside(v.inside_start) + last * inside(v.inside_end)


def textbook_tilt(v):
    """Tilt in proportion to a position."""
    return v.u[:, v.rng.integers(3), None] * np.cross(np.eye(3)[v.rng.integers(2)], v.beam)


def textbook_cyclic(v):
    """One wave per turn of the screw."""
    a = v.rng.integers(3)
    return np.sin(2 * np.pi * v.q[:, a] / 0.012)[:, None] * np.eye(3)[a]


TEXTBOOK = {
    'textbook_backlash': (textbook_backlash, {'backlash'}),
    'textbook_expansion': (textbook_expansion, {'thermal_axis_expansion'}),
    'textbook_drift': (textbook_drift, {'thermal_structure_drift', 'tracker_pose_drift'}),
    'textbook_lag': (textbook_lag, {'servo_mismatch'}),
    'textbook_coupling': (textbook_coupling, {'cross_coupling'}),
    'textbook_corner': (textbook_corner, {'corner_rounding'}),
    'textbook_cyclic': (textbook_cyclic, {'cyclic_error'}),
}
CAUSES = {**DEPARTED, **UNKNOWN, **TEXTBOOK}


class DepartedCell(Cell):
    """A cell with causes beside its rigid errors; ``sizes_um`` by name, across the path."""

    def spoiled_recording(self, sizes_um, rate=100.0, seed=0):
        """Record the run with causes, exactly as ``recording`` does without."""
        spec = self.machine.tracker
        rng = np.random.default_rng([4211, self.seed, seed, *self.chain.encode()])
        time = rng.uniform(0, 1 / rate) + np.arange(int(self.drive.duration * rate)) / rate
        q, velocity = self.drive.at(time)
        actual = self.position(q)
        view = view_of(self, time, q, velocity, rng)
        speed = np.linalg.norm(velocity, axis=1)
        unit = velocity / np.maximum(speed, 1e-9)[:, None]
        for name, size in sizes_um.items():
            moved = CAUSES[name][0](view)
            across = moved - np.einsum('ij,ij->i', moved, unit)[:, None] * unit
            loud = np.linalg.norm(across[speed > 0.02], axis=1)
            acts = loud[loud > 0.02 * loud.max()]
            actual = actual + moved * (1e-6 * size / np.sqrt(np.mean(acts**2)))
        noise = Noise(spec.u_range, spec.u_angle, 0.6)
        xyz = self.measured(actual, noise, 1 / rate, rng)
        clock = rng.uniform(0, 1e8) + time * (1.0 + rng.uniform(-2e-5, 2e-5))
        stamp = np.int64(1_700_000_000_000_000_000) + np.rint(clock * 1e9).astype(np.int64)
        return Recording(Samples(stamp, xyz), self.path, self.machine)
