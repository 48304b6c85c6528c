# SPDX-License-Identifier: Apache-2.0
"""What a cell hides: none, one or two effects, or one that the catalogue lacks; and its size.

The size of an effect is the root mean square of what it leaves in the residual once tables and
poses have followed it (``trace``); effects that leave next to nothing get a typical size instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.blind.draw import Trial, draw_trial, nodal
from otf_core.blind.draw_effects import draw_effect, scaled
from otf_core.blind.trace import Ruler, make_ruler
from otf_core.blind.unknown_effects import UNKNOWN_EFFECTS
from otf_core.effects import REGISTRY, AppliedEffect, BelongsTo
from otf_core.model.kinematics import displacement

Array = NDArray[np.float64]
Rng = np.random.Generator

KINDS = {'none': 0.15, 'one': 0.45, 'two': 0.12, 'unknown': 0.16, 'places': 0.12}
"""Kinds of cells and how often they are drawn; 'places': one effect, two tracker places."""
PLACE_EFFECTS = tuple(
    sorted(
        (n for n, e in REGISTRY.items() if e.trial.second_place),
        key=lambda n: REGISTRY[n].trial.second_place,
    )
)
SMALLEST, LARGEST = 0.3e-6, 10e-6
"""m; sizes of effects in the residual."""
MOST = 25e-6
"""m; root mean square of a displacement itself is not drawn larger."""


@dataclass(frozen=True)
class Part:
    """One hidden effect.

    Attributes
    ----------
    applied : AppliedEffect
    size : float
        m; root mean square left in the residual per piece.
    raw : float
        m; root mean square of the displacement itself.
    snr : float
        Length of what is left once freed of the noise: a perfect observer who knew its shape
        would see so many standard deviations.
    """

    applied: AppliedEffect
    size: float
    raw: float
    snr: float

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.applied.effect.name


@dataclass(frozen=True)
class Case:
    """A cell with what it hides.

    Attributes
    ----------
    trial : Trial
    kind : str
    parts : tuple of Part
    measured, simulated : float
        m; residual per piece with and without the effects, for the same noise.
    bends : float
        m; residual that smooth tables leave between the nodes of machine.yaml.
    first_only : tuple of Part
        The same parts as the first tracker place alone shows them.
    """

    trial: Trial
    kind: str
    parts: tuple[Part, ...]
    measured: float
    simulated: float
    bends: float
    first_only: tuple[Part, ...] = ()

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """All hidden effects."""
        return tuple(p.applied for p in self.parts)


def weigh(ruler: Ruler, applied: AppliedEffect) -> Part:
    """Measure one effect."""
    moved = ruler.displacement([applied])
    return Part(applied, ruler.size(moved), ruler.raw(moved), ruler.snr(moved))


def sized(ruler: Ruler, applied: AppliedEffect, rng: Rng) -> Part:
    """Give an effect a random size."""
    effect = applied.effect
    part = weigh(ruler, applied)
    if effect.belongs_to is BelongsTo.NOISE or part.raw == 0.0:
        return part
    wanted = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
    have = part.size
    # where means over pieces wash an effect out, its size is that of the samples
    blurred = effect.wave is not None and part.size < 0.3 * part.raw
    if effect.trial.hard_to_see or blurred:
        wanted, have = 1.5 * wanted, part.raw
    factor = min(wanted / max(have, 1e-12), MOST / part.raw)
    return weigh(ruler, scaled(applied, factor))


def _names(kind: str, turn: int, rng: Rng) -> list[str]:
    known, unknown = list(REGISTRY), list(UNKNOWN_EFFECTS)
    if kind == 'none':
        return []
    if kind == 'one':
        return [known[turn % len(known)]]
    if kind == 'unknown':
        return [unknown[turn % len(unknown)]]
    if kind == 'places':
        return [PLACE_EFFECTS[turn % len(PLACE_EFFECTS)]]
    visible = [
        n for n, e in REGISTRY.items()
        if not e.trial.hard_to_see and e.belongs_to is not BelongsTo.NOISE
    ]  # fmt: skip
    return [str(n) for n in rng.choice(visible, 2, replace=False)]


def kinds_of(count: int, seed: int) -> list[tuple[str, int]]:
    """Kind of every cell and how many of its kind came before, in shares of ``KINDS``."""
    rng = np.random.default_rng([seed, 0])
    names, shares = list(KINDS), np.array(list(KINDS.values()))
    wanted = shares * count
    numbers = np.floor(wanted).astype(int)
    for k in np.argsort(numbers - wanted)[: count - numbers.sum()]:
        numbers[k] += 1
    start = rng.integers(0, 1000, len(names))
    cells = [(n, int(s + i)) for n, c, s in zip(names, numbers, start, strict=True)
             for i in range(c)]  # fmt: skip
    return [cells[i] for i in rng.permutation(len(cells))]


def draw_case(seed: int, number: int, kind: str, turn: int, names: Sequence[str] = ()) -> Case:
    """Draw one cell with its effects.

    Parameters
    ----------
    seed, number : int
        All random numbers hang on these.
    kind : str
        Of ``KINDS``.
    turn : int
        How many cells of this kind came before: effects take turns.
    names : sequence of str, optional
        Effects to hide instead.
    """
    rng = np.random.default_rng([seed, number + 1])
    trial = draw_trial(f'{number:03d}', rng, 2 if kind == 'places' else 1)
    ruler = make_ruler(trial)
    parts = []
    for name in names or _names(kind, turn, rng):
        applied = draw_effect(name, trial.machine, trial.plan.duration, rng)
        parts.append(sized(ruler, applied, rng))
    measured = ruler.residual(ruler.displacement([p.applied for p in parts]))
    bends = ruler.size([
        displacement(trial.tables, s.q) - displacement(nodal(trial.tables), s.q)
        for s in ruler.states
    ])  # fmt: skip
    first: tuple[Part, ...] = ()
    if kind == 'places':
        alone = make_ruler(replace(trial, configs=trial.configs[:1]))
        first = tuple(weigh(alone, p.applied) for p in parts)
    return Case(trial, kind, tuple(parts), measured, ruler.residual(), bends, first)
