# SPDX-License-Identifier: Apache-2.0
"""Drawing of effects: shape and direction at random, of any size; ``trace`` scales them.

What is drawn stands in the file of each effect (``Effect.trial``) in the words of
``effects.drawing``; the random numbers come from here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import singledispatchmethod
from itertools import pairwise

import numpy as np

from otf_core.blind.natures import OUTSIDE
from otf_core.effects import REGISTRY, AppliedEffect
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
from otf_core.model.machine import Machine
from otf_core.model.nodes import axis_nodes

Rng = np.random.Generator
Parameters = dict[str, float]

SIGNS = (-1.0, 1.0)


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
    rng : numpy.random.Generator
    duration : float, s
    """

    rng: Rng
    machine: Machine
    duration: float

    def all(self, items: Iterable[Drawn]) -> Parameters:
        """Draw items in their order; later ones replace earlier ones of the same name."""
        found: Parameters = {}
        for item in items:
            found |= self.one(item)
        return found

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
        found: Parameters = {}
        for sign in self.rng.choice(SIGNS, int(self.rng.integers(1, item.most + 1))):
            found |= {n: float(v * sign) for n, v in self.one(item.item).items()}
        return found

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
        found = {}
        for low, high in pairwise(nodes):
            wave = np.sin(2.0 * np.pi * 0.5 * (low + high) / length + phase)
            rough = item.rough * self.rng.normal()
            found[item.name.format(low, high)] = float(item.size * (wave + rough))
        return found


def draw_effect(name: str, machine: Machine, duration: float, rng: Rng) -> AppliedEffect:
    """Draw shape and direction of one effect.

    Parameters
    ----------
    name : str
        Of the registry or of ``OUTSIDE``.
    duration : float, s
        Of the run.
    rng : numpy.random.Generator
    """
    draw = Draw(rng, machine, duration)
    if name in OUTSIDE:
        return AppliedEffect(OUTSIDE[name], draw.all(OUTSIDE[name].drawn))
    return AppliedEffect(REGISTRY[name], draw.all(REGISTRY[name].trial.drawn))


def scaled(applied: AppliedEffect, factor: float) -> AppliedEffect:
    """Return the effect with all coefficients, but not its shape, multiplied."""
    own = applied.effect.shape_names
    parameters = {k: v if k in own else v * factor for k, v in applied.parameters.items()}
    return AppliedEffect(applied.effect, parameters)
