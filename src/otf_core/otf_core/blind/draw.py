# SPDX-License-Identifier: Apache-2.0
"""Drawing of a cell: machine, path, tracker places, noise, tables, effects; all from one seed.

What is drawn of an effect stands in its file (``Effect.trial``), in the words of
``effects.drawing``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import singledispatchmethod
from itertools import pairwise

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.forms import SENSOR
from otf_core.blind.natures import OUTSIDE
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.catalogue.tracker_noise import TrackerNoise
from otf_core.effects.drawing import (
    Axes,
    BetweenNodes,
    Drawn,
    Either,
    LogUniform,
    Maybe,
    Normal,
    Number,
    OfMachine,
    OneOf,
    Several,
    Share,
    Some,
    Uniform,
    Value,
)
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
Parameters = dict[str, float]

CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
OTHER_CHAINS = ('w-X-b-Y-Z-t', 'w-Z-b-X-Y-t', 'w-b-Y-X-Z-t', 'w-Y-X-b-Z-t', 'w-X-b-Z-Y-t')
SIGNS = (-1.0, 1.0)
RECORDED = ((0.19e-6, 0.83e-6), (0.21e-6, 1.40e-6), (0.05e-6, 1.15e-6), (0.23e-6, 1.11e-6))
"""m and rad; medians of the standard deviations at rest of a real tracker along and across its
beam, by session (MarvinGravert, Vive-Accuracy-Experiment, MIT licence)."""
RECORDED_COLOUR = (0.8, 0.12)
"""Share of the variance that is correlated, and for how long, s: of a standstill of a real tracker
(THL Smart Factory Lab, look-where-you-work, UDP_dyn2, MIT licence)."""
LARGE_RATE = 500.0
"""Hz; large machines are measured so."""
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


def draw_machine(rng: Rng, *, large: bool = False) -> Machine:
    """Draw chain, ranges, node spacing, target offset and tracker; ``large``: of 2 m to 6 m."""
    chain = Chain.parse(str(rng.choice(CHAINS if rng.random() < 0.75 else OTHER_CHAINS)))
    size = np.array([0.6, 0.5, 0.4])
    if large:
        size = np.round(rng.uniform([2.0, 1.2, 0.8], [6.0, 2.5, 1.2]), 1)
    elif rng.random() < 0.4:
        size = np.round(rng.uniform([0.45, 0.4, 0.3], [0.9, 0.7, 0.5]), 2)
    low = np.array([0.0, 0.0, -size[2]])
    pitch = 0.03 if rng.random() < 0.7 else 0.05
    pitch = 0.1 if large else pitch
    names = enumerate(chain.axis_names)
    axes = {a: Axis(float(low[k]), float(low[k] + size[k]), pitch) for k, a in names}
    offset = np.round(rng.normal((0.0, 0.0, -0.15), (0.02, 0.02, 0.02)), 4)
    levels = RECORDED[int(rng.integers(len(RECORDED)))]
    if rng.random() < 0.6:
        levels = 0.5e-6, float(rng.uniform(1.0e-6, 2.2e-6))
    return Machine('cell', chain, axes, offset, TrackerSpec(*levels))


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


def chord_lap(rng: Rng) -> Array:
    """Corner points in the unit cube: lines along the axes, then chords; all there and back."""
    points: list[Array] = []
    for axis in (*range(3), *range(3), *range(3), *rng.integers(3, size=14)):
        ends = rng.uniform(0.0, 1.0, (2, 3))
        if len(points) < 27:
            ends[1] = ends[0]
        ends[:, axis] = 0.0, 1.0
        points.extend(ends[[0, 1, 0]])
    return np.array(points)


def draw_plan(machine: Machine, rng: Rng, *, large: bool = False) -> Plan:
    """Draw a path of one or two laps: figures in the faces, or that of the planner.

    ``large``: one lap of chords, fast.
    """
    if large:
        lap = machine.lower + chord_lap(rng) * (machine.upper - machine.lower)
        dwell = np.full(len(lap), 0.4)
        dwell[[0, -1]] = 3.0
        ratios = rng.choice([0.7, 1.0], len(lap) - 1)
        return Plan(NominalPath(lap), rng.uniform(0.4, 0.8) * ratios, dwell)
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


def draw_trial(
    name: str, rng: Rng, places: int = 1, *, signals: bool = False, large: bool = False
) -> Trial:
    """Draw a cell without effects.

    Parameters
    ----------
    places : int
        Tracker places it is measured from.
    signals : bool
        Whether the temperature of the spindle is recorded.
    large : bool
        Whether the machine is of 2 m to 6 m, its path fast chords, its tracker at ``LARGE_RATE``.
    """
    machine = draw_machine(rng, large=large)
    if signals:
        machine = replace(machine, signals=(SPINDLE,))
    plan = draw_plan(machine, rng, large=large)
    tables = draw_tables(machine, rng)
    share, time = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.1, 0.5))
    if rng.random() < 0.25:
        share, time = RECORDED_COLOUR
    configs = tuple(
        SimulationConfig(
            seed=int(rng.integers(2**31 - 1)),
            rate=LARGE_RATE if large else 100.0,
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


def draw_value(value: Value, rng: Rng) -> float:
    """Draw one number."""
    match value:
        case Uniform(low, high):
            return float(rng.uniform(low, high))
        case LogUniform(low, high):
            return float(np.exp(rng.uniform(np.log(low), np.log(high))))
        case Normal(size):
            return float(size * rng.normal())
        case OneOf(values):
            return float(rng.choice(values))
        case Share(size, least, signed):
            drawn = size * rng.uniform(least, 1.0)
            return float(drawn * rng.choice(SIGNS) if signed else drawn)
        case _:
            return float(value)


@dataclass(frozen=True)
class Draw:
    """Draws parameters of effects for one run.

    Attributes
    ----------
    duration : float, s
    """

    rng: Rng
    machine: Machine
    duration: float

    def all(self, items: Iterable[Drawn]) -> Parameters:
        """Draw items in their order; later ones replace earlier ones of the same name."""
        drawn: Parameters = {}
        for item in items:
            drawn |= self.one(item)
        return drawn

    @singledispatchmethod
    def one(self, item: Drawn) -> Parameters:
        """Draw one item."""
        raise NotImplementedError(type(item).__name__)

    @one.register
    def _(self, item: Number) -> Parameters:
        value = draw_value(item.value, self.rng) * (self.duration if item.of_duration else 1.0)
        return dict.fromkeys((item.name, *item.also), value)

    @one.register
    def _(self, item: Axes) -> Parameters:
        count = int(self.rng.integers(1, item.most + 1))
        axes = self.rng.choice(3, count, replace=False)
        values = self.rng.uniform(0.4, 1.0, count) * self.rng.choice(SIGNS, count)
        names = [f'{item.prefix}_{self.machine.axis_names[a]}' for a in axes]
        return {n: float(item.size * v) for n, v in zip(names, values, strict=True)}

    @one.register
    def _(self, item: Some) -> Parameters:
        count = int(self.rng.integers(1, item.most + 1))
        chosen = self.rng.choice(len(item.items), count, replace=False)
        return self.all(item.items[k] for k in chosen)

    @one.register
    def _(self, item: Several) -> Parameters:
        drawn: Parameters = {}
        for sign in self.rng.choice(SIGNS, int(self.rng.integers(1, item.most + 1))):
            drawn |= {n: float(v * sign) for n, v in self.one(item.item).items()}
        return drawn

    @one.register
    def _(self, item: Maybe) -> Parameters:
        return self.one(item.item) if self.rng.random() < item.share else {}

    @one.register
    def _(self, item: Either) -> Parameters:
        return self.all(item.ways[int(self.rng.integers(len(item.ways)))])

    @one.register
    def _(self, item: OfMachine) -> Parameters:
        return self.one(item.item(self.machine.axis_names))

    @one.register
    def _(self, item: BetweenNodes) -> Parameters:
        nodes = axis_nodes(self.machine.axes[item.axis])
        length = self.rng.uniform(*item.lengths) * (nodes[1] - nodes[0])
        phase = self.rng.uniform(0.0, 2.0 * np.pi)
        drawn = {}
        for low, high in pairwise(nodes):
            wave = np.sin(2.0 * np.pi * 0.5 * (low + high) / length + phase)
            rough = item.rough * self.rng.normal()
            drawn[item.name.format(low, high)] = float(item.size * (wave + rough))
        return drawn


def draw_effect(name: str, machine: Machine, duration: float, rng: Rng) -> AppliedEffect:
    """Draw shape and direction of one effect.

    Parameters
    ----------
    name : str
        Of the registry or of ``OUTSIDE``.
    duration : float, s
        Of the run.
    """
    draw = Draw(rng, machine, duration)
    if name in OUTSIDE:
        return AppliedEffect(OUTSIDE[name], draw.all(OUTSIDE[name].drawn))
    return AppliedEffect(REGISTRY[name], draw.all(REGISTRY[name].trial.drawn))


def scale_effect(applied: AppliedEffect, factor: float) -> AppliedEffect:
    """Return the effect with all coefficients, but not its shape, multiplied."""
    own = applied.effect.shape_names
    parameters = {k: v if k in own else v * factor for k, v in applied.parameters.items()}
    return AppliedEffect(applied.effect, parameters)
