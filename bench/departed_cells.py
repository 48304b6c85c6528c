# SPDX-License-Identifier: Apache-2.0
"""Cells of the independent nature in which causes take other forms than the catalogue's.

The forms are those of the blind trial (``otf_core.blind``), textbook ones beside them; machine,
drive and tracker are those of the tests. Every cause is a function of a ``View`` that returns
(n, 3), m, scaled afterwards so that what lies across the path has a given root mean square.
"""

from __future__ import annotations

import numpy as np
from nature import Cell
from nature_tracker import Noise

from otf_core.blind.forms import DEPARTED_FORMS, NAMELESS_FORMS, View
from otf_core.model.observation import Samples
from otf_core.pieces.runs import Recording


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
        beam=q - cell.place,
        warmth=np.zeros(0),
        rng=rng,
    )


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
DEPARTED = {form.__name__: (form, names) for form, names in DEPARTED_FORMS.items()}
UNKNOWN = {form.__name__: (form, frozenset()) for form in NAMELESS_FORMS}
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
            made = CAUSES[name][0](view)
            moved = made[0] if isinstance(made, tuple) else made
            across = moved - np.einsum('ij,ij->i', moved, unit)[:, None] * unit
            loud = np.linalg.norm(across[speed > 0.02], axis=1)
            acts = loud[loud > 0.02 * loud.max()]
            actual = actual + moved * (1e-6 * size / np.sqrt(np.mean(acts**2)))
        noise = Noise(spec.u_range, spec.u_angle, 0.6)
        xyz = self.measured(actual, noise, 1 / rate, rng)
        clock = rng.uniform(0, 1e8) + time * (1.0 + rng.uniform(-2e-5, 2e-5))
        stamp = np.int64(1_700_000_000_000_000_000) + np.rint(clock * 1e9).astype(np.int64)
        return Recording(Samples(stamp, xyz), self.path, self.machine)
