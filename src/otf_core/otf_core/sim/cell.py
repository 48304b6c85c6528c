# SPDX-License-Identifier: Apache-2.0
"""A simulated run of any chain: truth machine with exact kinematics, drive, tracker.

The machine drives the parts of a plan, a reflector in view in each; between parts it is moved by
hand and the beam is broken. The tracker stands on the table or the bed and has its own clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.config import SimulationConfig
from otf_core.effects import AppliedEffect
from otf_core.errors import ConfigError
from otf_core.model.axis_path import AxisPath
from otf_core.model.chain import Sight, exact_position
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import TABLE, Machine
from otf_core.model.motions import unit_of
from otf_core.model.nodes import axis_nodes
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_core.model.sections import SignalSpec
from otf_core.model.signals import Courses, Signal
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.sim.drive import Drive, drives_of
from otf_core.sim.effects import changed_noise, run_state, total_displacement
from otf_core.sim.simulated_signals import simulated_signals
from otf_core.sim.tracker import draw_received, measure, place_tracker, specified_noise

EPOCH_NS = 1_700_000_000_000_000_000
"""ns; start of the simulated tracker clock, arbitrary."""
MOST_SAMPLES = 50_000_000
"""A run of more is refused: it needs tens of gigabytes of memory."""
BROKEN_BEAM = 4.0
"""s; for which the beam is broken between two parts."""


@dataclass(frozen=True)
class SimulatedRun:
    """Samples of a run and the truth behind them.

    Attributes
    ----------
    pose : RigidTransform
        Tracker to the link that it stands on.
    drives : tuple of Drive
        What was driven, part by part.
    places : mapping of target to ndarray, shape (3,), m
        Where the reflectors really were.
    signals : mapping of SignalSpec to Signal
        What is recorded beside the samples.
    """

    samples: Samples
    truth: ErrorTables
    pose: RigidTransform
    drives: tuple[Drive, ...]
    places: Mapping[str, Array]
    signals: Mapping[SignalSpec, Signal]

    @property
    def parts(self) -> tuple[AxisPath, ...]:
        """Axis positions at the corners of every part, and its target."""
        return tuple(drive.part.path for drive in self.drives)

    @property
    def path(self) -> NominalPath | None:
        """Corner points, where they say all: linear axes alone, the tool seen from the table."""
        plan = Plan(tuple(drive.part for drive in self.drives))
        plain = plan.is_plain and self.truth.machine.tracker.link == TABLE
        return plan.path if plain else None


def _random_curve(nodes: Array, rng: np.random.Generator) -> Array:
    """Return a smooth random curve of unit size over the nodes: slope, bow, waves, roughness."""
    x = (nodes - nodes[0]) / (nodes[-1] - nodes[0])
    curve = rng.normal() * (x - 0.5) + 2 * rng.normal() * (x - 0.5) ** 2
    for waves in (1, 2, 3):
        curve += rng.normal() / waves * np.sin(2 * np.pi * (waves * x + rng.uniform()))
    return np.asarray(curve + 0.1 * rng.standard_normal(nodes.size))


def random_tables(machine: Machine, size: float, rng: np.random.Generator) -> ErrorTables:
    """Draw error tables whose mean volumetric error on a lattice is ``size``.

    Parameters
    ----------
    size : float
        m; mean length of the error vectors once the best rigid motion is taken out.
    """
    motions: dict[str, MotionTable] = {}
    longest = max((a.max - a.min for a in machine.axes.values() if not a.rotary), default=1.0)
    reach = {'m': 1.0, 'rad': 1.0 / longest}
    for name in machine.motions:
        nodes = axis_nodes(machine.axes[name.axis])
        value = reach[unit_of(name)] * _random_curve(nodes, rng)
        if machine.axes[name.axis].endless:
            value -= np.linspace(0.0, value[-1] - value[0], len(value))
        motions[name] = MotionTable(nodes, value, np.zeros_like(value))
    squareness = {name: ScalarError(float(rng.normal())) for name in machine.squareness}
    location = {n: ScalarError(reach[unit_of(n)] * float(rng.normal())) for n in machine.location}
    tables = ErrorTables(machine, motions, squareness, location)
    seen = Sight.of_tool(machine).at(lattice(machine))
    now = mean_length(without_rigid_motion(seen.displacement(tables), seen.position))
    return tables.scaled(size / now)


def simulate(
    machine: Machine,
    plan: Plan,
    config: SimulationConfig,
    tables: ErrorTables | None = None,
    effects: Sequence[AppliedEffect] = (),
    tracker_place: Array | None = None,
) -> SimulatedRun:
    """Simulate a run of the plan.

    Parameters
    ----------
    tables : ErrorTables, optional
        Errors of the truth machine; drawn from the seed if not given.
    effects : sequence of AppliedEffect, optional
        What else displaces the measured point, and how the noise departs from its specification;
        all random numbers stay the same.
    tracker_place : ndarray, shape (3,), m, optional
        Beam origin in the frame of the tracker's link; drawn from the seed if not given.

    Returns
    -------
    SimulatedRun
        Places of targets with u > 0 are drawn about the stated ones.

    Raises
    ------
    ConfigError
        If an effect's parameters are wrong, or the run takes more than ``MOST_SAMPLES``.
    InputError
        If the plan is not of this machine, or leaves the range of an axis.
    """
    rngs = [np.random.default_rng([config.seed, part]) for part in range(6)]
    truth = tables if tables is not None else random_tables(machine, config.error_size, rngs[0])
    pose = place_tracker(machine, rngs[1])
    if tracker_place is not None:
        pose = RigidTransform(pose.rotation, tracker_place)
    places = _drawn_places(machine, rngs[5])
    drives = drives_of(machine, plan, config.acceleration)
    starts = np.cumsum([0.0, *(drive.duration + BROKEN_BEAM for drive in drives)])
    duration = float(starts[-1] - BROKEN_BEAM)
    if duration * config.rate >= MOST_SAMPLES:
        raise ConfigError(
            f'a run of {duration:.3g} s at {config.rate:g} samples/s is too long to '
            f'simulate, {MOST_SAMPLES} samples at most; check feeds (m/s) and dwells (s), or '
            f'lower the rate'
        )
    signals = simulated_signals(machine, effects, duration, EPOCH_NS, rngs[4])
    times, points = [], []
    for number, (drive, start) in enumerate(zip(drives, starts[:-1], strict=True)):
        time = np.arange(int(drive.duration * config.rate) + 1) / config.rate
        name = drive.part.target
        sight = Sight(machine, machine.tracker.link, machine.targets[name].link, places[name])
        position = exact_position(truth, drive.at(time), sight)
        if effects:
            clock = (start + time) * (1 + config.clock_drift)
            beside = Courses({s.name: own for s, own in signals.items()}, EPOCH_NS, clock)
            state = run_state(drives, number, time, clock, truth, places, pose, duration, beside)
            position += total_displacement(state, effects)
        times.append(start + time)
        points.append((position - pose.translation) @ pose.rotation)
    time = np.concatenate(times)
    noise = changed_noise(specified_noise(machine, config), effects)
    xyz = measure(np.concatenate(points), noise, config.rate, rngs[2])
    if config.resolution:
        xyz = np.rint(xyz / config.resolution) * config.resolution
    stamp_ns = EPOCH_NS + np.rint(time * (1 + config.clock_drift) * 1e9).astype(np.int64)
    if config.packet_loss:
        arrived = draw_received(time, config.packet_loss, rngs[3])
        stamp_ns, xyz = stamp_ns[arrived], xyz[arrived]
    return SimulatedRun(Samples(stamp_ns, xyz), truth, pose, drives, places, signals)


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
