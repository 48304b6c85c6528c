# SPDX-License-Identifier: Apache-2.0
"""A simulated run: truth machine with exact kinematics, drive, tracker with its own clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from otf_core.arrays import Array
from otf_core.config import SimulationConfig
from otf_core.effects import AppliedEffect
from otf_core.errors import ConfigError
from otf_core.model.declared_signals import SignalSpec
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.frames import RigidTransform
from otf_core.model.kinematics import displacement, exact_position, nominal_position
from otf_core.model.machine import Machine
from otf_core.model.motions import SQUARENESS, unit_of
from otf_core.model.nodes import axis_nodes
from otf_core.model.observation import Samples
from otf_core.model.plan import Plan
from otf_core.model.signals import Signal
from otf_core.model.tables import ErrorTables, LocationError, MotionTable, Squareness
from otf_core.sim.drive import Drive
from otf_core.sim.effects import changed_noise, run_state, total_displacement
from otf_core.sim.simulated_signals import signal_courses, simulated_signals
from otf_core.sim.tracker import draw_received, measure, place_tracker, specified_noise

EPOCH_NS = 1_700_000_000_000_000_000
"""ns; start of the simulated tracker clock, arbitrary."""
MOST_SAMPLES = 50_000_000
"""A run of more is refused: it needs tens of gigabytes of memory."""


@dataclass(frozen=True)
class SimulatedRun:
    """Samples of a run and the truth behind them.

    Attributes
    ----------
    rotation, place : ndarray, shape (3, 3) and (3,), m
        Tracker point = rotation @ (machine point - place).
    signals : mapping of SignalSpec to Signal
        What is recorded beside the samples.
    """

    samples: Samples
    truth: ErrorTables
    rotation: Array
    place: Array
    signals: Mapping[SignalSpec, Signal] = field(default_factory=dict)


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
    longest = float(np.max((machine.upper - machine.lower)[:3]))
    for name in machine.motions:
        nodes = axis_nodes(machine.axes[name.axis])
        reach = 1.0 if unit_of(name) == 'm' else 1.0 / longest
        value = reach * _random_curve(nodes, rng)
        motions[name] = MotionTable(nodes, value, np.zeros_like(value))
        if machine.axes[name.axis].endless:
            value = value - np.linspace(0.0, value[-1] - value[0], len(value))
            motions[name] = MotionTable(nodes, value, np.zeros_like(value))
    squareness = {name: Squareness(float(rng.normal())) for name in SQUARENESS}
    location = {
        n: LocationError((1.0 if unit_of(n) == 'm' else 1.0 / longest) * float(rng.normal()))
        for n in machine.location
    }
    tables = ErrorTables(machine, motions, squareness, location)
    q = lattice(machine) if not machine.rotary_names else lattice(machine, 5)
    at = nominal_position(machine, q)
    now = mean_length(without_rigid_motion(displacement(tables, q), at))
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
        Beam origin in the machine frame; drawn from the seed if not given.

    Raises
    ------
    ConfigError
        If an effect's parameters are wrong, or the run takes more than ``MOST_SAMPLES``.
    """
    rngs = [np.random.default_rng([config.seed, part]) for part in range(5)]
    truth = tables if tables is not None else random_tables(machine, config.error_size, rngs[0])
    rotation, place = place_tracker(machine, rngs[1])
    if tracker_place is not None:
        place = tracker_place
    drive = Drive(plan, config.acceleration)
    if drive.duration * config.rate >= MOST_SAMPLES:
        raise ConfigError(
            f'a run of {drive.duration:.3g} s at {config.rate:g} samples/s is too long to '
            f'simulate, {MOST_SAMPLES} samples at most; check feeds (m/s) and dwells (s), or '
            f'lower the rate'
        )
    count = int(drive.duration * config.rate) + 1
    time = np.arange(count) / config.rate
    clock = time * (1 + config.clock_drift)
    position = exact_position(truth, drive.position(time))
    signals = simulated_signals(machine, effects, drive.duration, EPOCH_NS, rngs[4])
    if effects:
        pose = RigidTransform(rotation.T, place)
        beside = signal_courses(signals, EPOCH_NS, clock)
        state = run_state(machine, plan, drive, time, clock, pose, truth, beside)
        position = position + total_displacement(state, effects)
    noise = changed_noise(specified_noise(machine, config), effects)
    xyz = measure((position - place) @ rotation.T, noise, config.rate, rngs[2])
    if config.resolution:
        xyz = np.rint(xyz / config.resolution) * config.resolution
    stamp_ns = EPOCH_NS + np.rint(clock * 1e9).astype(np.int64)
    if config.packet_loss:
        arrived = draw_received(time, config.packet_loss, rngs[3])
        stamp_ns, xyz = stamp_ns[arrived], xyz[arrived]
    return SimulatedRun(Samples(stamp_ns, xyz), truth, rotation, place, signals)
