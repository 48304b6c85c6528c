# SPDX-License-Identifier: Apache-2.0
"""Drawing of a trial: machine, path, tracker places, noise, tables; all from one seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.view import SENSOR
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.effects import AppliedEffect
from otf_core.effects.catalogue.tracker_noise import TrackerNoise
from otf_core.model.declared_signals import DRIVEN, HEAD, USUAL, SignalSpec
from otf_core.model.machine import Axis, Chain, Machine, TrackerSpec
from otf_core.model.motions import ErrorMotion
from otf_core.model.nodes import axis_nodes
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables, MotionTable
from otf_core.planning.path_creation import plan_path
from otf_core.sim.cell import SimulatedRun, random_tables, simulate

Rng = np.random.Generator

CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
OTHER_CHAINS = ('w-X-b-Y-Z-t', 'w-Z-b-X-Y-t', 'w-b-Y-X-Z-t', 'w-Y-X-b-Z-t', 'w-X-b-Z-Y-t')
SPINDLE = SignalSpec(SENSOR.removeprefix(HEAD), '', 'degC', USUAL, DRIVEN)
_PLANE = ((0, 0), (1, 1), (1, 0), (0, 1), (0, 0), (0.5, 0), (0.5, 1), (1, 1), (1, 0.5),
          (0, 0.5), (0, 0))  # fmt: skip
_SPACE = ((0, 0, 0), (1, 1, 1), (1, 0, 0), (0, 1, 1), (0, 1, 0), (1, 0, 1), (0, 0, 1), (1, 1, 0),
          (0.3, 0.2, 0.1))  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """One cell to be diagnosed, without its effects.

    Attributes
    ----------
    configs : tuple of SimulationConfig
        One per tracker place; their seeds draw place and noise.
    tables : ErrorTables
        Errors of the truth machine.
    tails : AppliedEffect, optional
        Heavy tails of the noise; not counted as an effect.
    """

    name: str
    machine: Machine
    plan: Plan
    configs: tuple[SimulationConfig, ...]
    tables: ErrorTables
    tails: AppliedEffect | None = None

    def runs(self, effects: Sequence[AppliedEffect] = ()) -> list[SimulatedRun]:
        """Simulate one run per tracker place."""
        every = (*effects, *((self.tails,) if self.tails else ()))
        return [simulate(self.machine, self.plan, c, self.tables, every) for c in self.configs]


def draw_machine(rng: Rng) -> Machine:
    """Draw chain, ranges, node spacing, target offset and tracker."""
    chain = Chain.parse(str(rng.choice(CHAINS if rng.random() < 0.75 else OTHER_CHAINS)))
    size = np.array([0.6, 0.5, 0.4])
    if rng.random() < 0.4:
        size = np.round(rng.uniform([0.45, 0.4, 0.3], [0.9, 0.7, 0.5]), 2)
    low = np.array([0.0, 0.0, -size[2]])
    pitch = 0.03 if rng.random() < 0.7 else 0.05
    names = enumerate(chain.axis_names)
    axes = {a: Axis(float(low[k]), float(low[k] + size[k]), pitch) for k, a in names}
    offset = np.round(rng.normal((0.0, 0.0, -0.15), (0.02, 0.02, 0.02)), 4)
    spec = TrackerSpec(0.5e-6, float(rng.uniform(1.0e-6, 2.2e-6)))
    return Machine('cell', chain, axes, offset, spec)


def unit_lap(rng: Rng) -> Array:
    """Corner points of one lap in the unit cube: face figures at three levels, space diagonals."""
    points: list[Array] = []
    for normal in rng.permutation(3):
        in_plane = [a for a in range(3) if a != normal]
        for level in (0.0, 0.5, 1.0):
            corners = np.full((len(_PLANE), 3), level)
            corners[:, in_plane] = _PLANE
            points.extend(corners)
    points.extend(np.array(_SPACE, dtype=float))
    lap = np.array(points)
    mirrored = rng.random(3) < 0.5
    lap[:, mirrored] = 1.0 - lap[:, mirrored]
    moved = np.concatenate([[True], np.any(np.diff(lap, axis=0) != 0, axis=1)])
    return np.asarray(lap[moved])


def draw_plan(machine: Machine, rng: Rng) -> Plan:
    """Draw a path of one or two laps: figures in the faces, or that of the planner."""
    laps = 1 if rng.random() < 0.25 else 2
    feed = float(rng.uniform(0.12, 0.25))
    ratio = float(rng.choice([1.5, 1.5, 0.67, 1.25, 1.0]))
    if rng.random() < 0.25:
        config = PlannerConfig(passes=laps, feed=feed, feed_ratio=0.67, corner_dwell=0.4)
        return plan_path(machine, config)
    lap = machine.lower + unit_lap(rng) * (machine.upper - machine.lower)
    back = lap[::-1] if rng.random() < 0.85 else np.concatenate([lap[-1:], lap])
    points = [lap, back[1:]] if laps == 2 else [lap]
    feeds = [np.full(len(lap) - 1, feed)]
    if laps == 2:
        feeds.append(np.full(len(back) - 1, feed * ratio))
    path = NominalPath(np.concatenate(points))
    dwell = np.full(len(path.points), 0.4)
    dwell[[0, -1]] = rng.uniform(0.4, 3.0)
    return Plan(path, np.concatenate(feeds)[: len(path.points) - 1], dwell)


def draw_tables(machine: Machine, rng: Rng) -> ErrorTables:
    """Draw error tables of 20 um to 100 um; sometimes smooth between the nodes."""
    tables = random_tables(machine, float(rng.uniform(2e-5, 1e-4)), rng)
    return tables if rng.random() < 0.85 else _smooth(tables)


def _smooth(tables: ErrorTables) -> ErrorTables:
    """Low polynomials through the tables instead of straight lines."""
    motions = {}
    for name, table in tables.motions.items():
        low, high = table.position[0], table.position[-1]
        fine = np.linspace(low, high, 40 * len(table.position))
        curve = np.polynomial.Polynomial.fit(table.position, table.value, 3)(fine)
        motions[name] = MotionTable(fine, curve, np.zeros_like(fine))
    return replace(tables, motions=motions)


def nodal(tables: ErrorTables) -> ErrorTables:
    """Return the same tables as straight lines between the nodes of machine.yaml."""
    motions = {}
    for name, table in tables.motions.items():
        nodes = axis_nodes(tables.machine.axes[ErrorMotion.of(name).axis])
        motions[name] = MotionTable(nodes, table.at(nodes), np.zeros_like(nodes))
    return replace(tables, motions=motions)


def draw_trial(name: str, rng: Rng, places: int = 1, *, signals: bool = False) -> Trial:
    """Draw a cell without effects.

    Parameters
    ----------
    rng : numpy.random.Generator
    places : int
        Tracker places it is measured from.
    signals : bool
        Whether the temperature of the spindle is recorded.
    """
    machine = draw_machine(rng)
    if signals:
        machine = replace(machine, signals=(SPINDLE,))
    plan = draw_plan(machine, rng)
    tables = draw_tables(machine, rng)
    share, time = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.1, 0.5))
    configs = tuple(
        SimulationConfig(
            seed=int(rng.integers(2**31 - 1)),
            rate=100.0,
            correlated_share=share,
            correlation_time=time,
            clock_drift=float(rng.normal(0, 1e-5)),
        )
        for _ in range(places)
    )
    tails = None
    if rng.random() < 0.15:
        tails = AppliedEffect(TrackerNoise(), {'dof': float(rng.uniform(3.0, 5.0))})
    return Trial(name, machine, plan, configs, tables, tails)
