# SPDX-License-Identifier: Apache-2.0
"""A simulated run of a machine with rotary axes: parts driven in joint space, a target in each.

Between corners all axes move linearly in their positions; on a smooth chain of corners the drive
does not stop. Between parts the reflector is moved by hand and the beam is broken. Every axis may
lag behind its programmed position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.effects import AppliedEffect
from otf_core.effects.state import state_in_parts
from otf_core.errors import ConfigError
from otf_core.model.axis_path import AxisPath, Stretches, position_at
from otf_core.model.frames import RigidTransform
from otf_core.model.joints import Sight, exact_position
from otf_core.model.machine import Machine
from otf_core.model.nodes import axis_nodes
from otf_core.model.observation import Samples
from otf_core.model.tables import ErrorTables
from otf_core.sim.cell import EPOCH_NS, MOST_SAMPLES, random_tables
from otf_core.sim.effects import changed_noise, total_displacement
from otf_core.sim.tracker import measure, place_tracker, specified_noise

BROKEN_BEAM = 4.0
"""s; for which the beam is broken between two parts."""
STANDS = 1e-6
"""m/s and rad/s; a slower axis stands."""


@dataclass(frozen=True)
class SimulatedParts:
    """Samples of a run and the truth behind them.

    Attributes
    ----------
    rotation, place : ndarray, shape (3, 3) and (3,), m
        Tracker point = rotation @ (point of its link - place).
    places : mapping of target to ndarray, shape (3,), m
        Where the reflectors really were.
    """

    samples: Samples
    truth: ErrorTables
    rotation: Array
    place: Array
    parts: tuple[AxisPath, ...]
    places: Mapping[str, Array]


class JointDrive:
    """Programmed motion along one part: trapezoidal speed on every smooth stretch.

    Parameters
    ----------
    positions : ndarray, shape (n, k), m and rad
    feed, acceleration : float
        m/s and m/s^2, of the linear axes; rotary ones turn no faster than ``axis_path.TURN_RATE``.
    dwell : float
        s, between two stretches.
    stops : bool
        Every leg is a stretch: the drive stops at smooth corners, too.
    end_dwell : float
        s, before the first stretch and after the last.
    """

    def __init__(
        self,
        machine: Machine,
        positions: Array,
        feed: float,
        acceleration: float,
        dwell: float,
        stops: bool = False,
        end_dwell: float = PlannerConfig.end_dwell,
    ) -> None:
        self._positions, self._acceleration = positions, acceleration
        self._own = Stretches.of(machine, positions, feed, acceleration, stops=stops)
        moving = self._own.moving
        self._start = end_dwell + np.append(0.0, np.cumsum(moving + dwell)[:-1])
        self.duration = float(self._start[-1] + moving[-1] + end_dwell)

    def stretch_at(self, time: Array) -> Index:
        """Number of the smooth stretch at times (n,), s."""
        return np.clip(np.searchsorted(self._start, time, side='right') - 1, 0, None)

    def at(self, time: Array) -> Array:
        """Programmed positions (n, k) at times (n,), s."""
        k, own = self.stretch_at(time), self._own
        elapsed = np.clip(time - self._start[k], 0.0, own.moving[k])
        peak, remaining = own.peak[k], own.moving[k] - elapsed
        ramp = peak / self._acceleration
        travelled = np.select(
            [elapsed < ramp, remaining < ramp],
            [
                0.5 * self._acceleration * elapsed**2,
                own.size[k] - 0.5 * self._acceleration * remaining**2,
            ],
            peak * (elapsed - 0.5 * ramp),
        )
        corners = np.arange(len(own.reach), dtype=float)
        return position_at(self._positions, np.interp(own.low[k] + travelled, own.reach, corners))


def simulate_parts(
    machine: Machine,
    parts: Sequence[AxisPath],
    config: SimulationConfig,
    tables: ErrorTables | None = None,
    *,
    feed: float | Sequence[float] = 0.05,
    dwell: float | Sequence[float] = 0.5,
    stops: bool | Sequence[bool] = False,
    end_dwell: float = PlannerConfig.end_dwell,
    lag: Mapping[str, float] | None = None,
    tracker_place: Array | None = None,
    effects: Sequence[AppliedEffect] = (),
) -> SimulatedParts:
    """Simulate a run.

    Parameters
    ----------
    tables : ErrorTables, optional
        Errors of the truth machine; drawn from the seed if not given.
    feed : float, m/s
        Of all parts, or one of each.
    dwell : float, s
        At every corner that is not driven through; the same.
    stops : bool
        Whether smooth corners are stopped at; the same.
    end_dwell : float, s
        At start and end of every part.
    lag : mapping of axis to float, s, optional
        By which an axis is late.
    tracker_place : ndarray, shape (3,), m, optional
        Beam origin in the frame of the tracker's link; drawn from the seed if not given.
    effects : sequence of AppliedEffect

    Returns
    -------
    SimulatedParts
        Places of targets with u > 0 are drawn about the stated ones.

    Raises
    ------
    ConfigError
        If the run is too long to be simulated.
    """
    rngs = [np.random.default_rng([config.seed, part]) for part in range(6)]
    truth = tables if tables is not None else random_tables(machine, config.error_size, rngs[0])
    rotation, place = place_tracker(machine, rngs[1])
    if tracker_place is not None:
        place = tracker_place
    places = _drawn_places(machine, rngs[5])
    own = [part.of(machine) for part in parts]
    every = [np.broadcast_to(given, len(own)).tolist() for given in (feed, dwell, stops)]
    drives = [
        JointDrive(machine, p.positions, f, config.acceleration, max(d, 1e-3), s, end_dwell)
        for p, f, d, s in zip(own, *every, strict=True)
    ]
    if sum(d.duration for d in drives) * config.rate >= MOST_SAMPLES:
        raise ConfigError(f'the run is too long to simulate, {MOST_SAMPLES} samples at most')
    stamps, points, start = [], [], 0.0
    length = sum(d.duration + BROKEN_BEAM for d in drives) - BROKEN_BEAM
    pose = RigidTransform(rotation.T, place)
    for number, (part, drive) in enumerate(zip(own, drives, strict=True)):
        time = np.arange(int(drive.duration * config.rate) + 1) / config.rate
        q = drive.at(time)
        for axis, late in (lag or {}).items():
            column = machine.column(axis)
            q[:, column] = drive.at(time - late)[:, column]
        target = machine.targets[part.target]
        sight = Sight(machine, machine.tracker.link, target.link, places[part.target])
        position = exact_position(truth, sight, q)
        if effects:
            moving = _Moving(machine, [p.target for p in own], places, pose, truth, length)
            position += moving.displaced(effects, number, drive, start, time)
        points.append((position - place) @ rotation.T)
        clock = (start + time) * (1 + config.clock_drift)
        stamps.append(EPOCH_NS + np.rint(clock * 1e9).astype(np.int64))
        start += drive.duration + BROKEN_BEAM
    noise = changed_noise(specified_noise(machine, config), effects)
    xyz = measure(np.concatenate(points), noise, config.rate, rngs[2])
    return SimulatedParts(
        Samples(np.concatenate(stamps), xyz), truth, rotation, place, tuple(own), places
    )


def _drawn_places(machine: Machine, rng: np.random.Generator) -> dict[str, Array]:
    """Places of the reflectors, and of one that is turned in its nest after every turn."""
    targets = machine.targets
    nests = {
        name: np.array(t.place) + t.u * rng.standard_normal(3)
        for name, t in targets.items()
        if t.nest in ('', name)
    }
    return {
        name: nests[t.nest] + t.u_facing * rng.standard_normal(3) if t.nest else nests[name]
        for name, t in targets.items()
    }


@dataclass(frozen=True)
class _Moving:
    """What effects need to know of a run."""

    machine: Machine
    targets: Sequence[str]
    places: Mapping[str, Array]
    pose: RigidTransform
    truth: ErrorTables
    length: float

    def displaced(
        self,
        effects: Sequence[AppliedEffect],
        number: int,
        drive: JointDrive,
        start: float,
        time: Array,
    ) -> Array:
        """Displacements (n, 3), m, in one part that begins at ``start``, s."""
        q, axes = drive.at(time), self.machine.axes
        rates = np.gradient(q, time, axis=0)
        sense = np.sign(np.where(np.abs(rates) > STANDS, rates, 0.0))
        last = np.maximum.accumulate(np.where(sense != 0.0, np.arange(len(q))[:, None], 0), axis=0)
        state = state_in_parts(
            self.machine,
            self.targets,
            self.places,
            np.full(len(q), number),
            drive.stretch_at(time),
            q,
            rates,
            np.take_along_axis(sense, last, axis=0),
            start + time,
            self.pose,
            {a: axis_nodes(axes[a]) for a in axes},
            self.truth,
            self.length,
        )
        return total_displacement(state, effects)


def usual_parts(machine: Machine) -> tuple[AxisPath, ...]:
    """Parts that show the errors of a machine, where no path is given.

    Lines through the volume with the tool; with every target on the table circles and arcs of each
    rotary axis and both together, seen from the bed; else rotary axes together with linear ones.
    """
    low, high = machine.lower, machine.upper
    middle = np.clip(0.0, low, high)
    names, parts = machine.axis_names, []
    corners = np.array([[0, 0, 0], [1, 1, 1], [1, 0, 0], [0, 1, 1], [0, 1, 0], [1, 0, 1],
                        [1, 1, 0], [0, 0, 1], [0.5, 0, 0], [0.5, 1, 1], [0, 0.5, 0],
                        [1, 0.5, 1],
                        [0, 0, 0.5], [1, 1, 0.5], [0, 1, 0.5], [1, 0, 0.5],
                        [0, 0, 0]])  # fmt: skip
    lines = np.tile(middle, (len(corners), 1))
    lines[:, :3] = low[:3] + corners * (high - low)[:3]
    tools = [n for n, t in machine.targets.items() if t.link == 't']
    parts += [AxisPath(names, lines, name) for name in tools]
    turning = [machine.column(a) for a in machine.rotary_names]
    nests = [n for n, t in machine.targets.items() if t.link == 'w']
    if machine.tracker.link == 'b' and nests:
        q = _turns(middle, low, high, turning)
        return (*parts, *(AxisPath(names, q, name) for name in nests))
    for name in tools:
        parts.append(AxisPath(names, _with_lines(middle, low, high, turning), name))
    return tuple(parts)


def _turns(middle: Array, low: Array, high: Array, turning: Sequence[int]) -> Array:
    rows = [middle.copy()]

    def go(**to: float) -> None:
        rows.append(rows[-1].copy())
        for column, value in to.items():
            rows[-1][int(column[1:])] = value

    for k in turning:
        for end in (low[k], high[k], low[k], middle[k]):
            go(**{f'c{k}': end})
    if len(turning) > 1:
        a, c = turning
        for x, y in ((low, low), (high, high), (low, low), (low, high), (high, low), (low, high)):
            go(**{f'c{a}': x[a], f'c{c}': y[c]})
    return np.array(rows)


def _with_lines(middle: Array, low: Array, high: Array, turning: Sequence[int]) -> Array:
    rows = [middle.copy()]
    for k in turning:
        for linear in range(3):
            for share in (0.2, 0.8):
                place = middle.copy()
                other = (linear + 1) % 3
                place[other] = low[other] + share * (high - low)[other]
                ends = []
                for end in (low, high):
                    row = place.copy()
                    row[k], row[linear] = end[k], end[linear]
                    ends.append(row)
                rows += [ends[0], ends[1], ends[0]]
    return np.array(rows)
