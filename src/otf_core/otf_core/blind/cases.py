# SPDX-License-Identifier: Apache-2.0
"""What a cell hides, and how large it is.

Nothing; one, two or three effects of the catalogue; known causes in forms of nature; causes of no
catalogue. The size of an effect is the root mean square of what it leaves in the residual once
tables and poses have followed it (``trace``); effects that leave next to nothing get a typical
size instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.depends import Depends, catalogue_depends
from otf_core.blind.draw import Trial, draw_effect, draw_trial, nodal, scaled
from otf_core.blind.natures import DEPARTED, FOLLOWING, OUTSIDE, UNKNOWN_EFFECTS
from otf_core.blind.observer import Ruler, make_ruler
from otf_core.effects import REGISTRY, AppliedEffect, BelongsTo
from otf_core.model.kinematics import displacement

Rng = np.random.Generator


@dataclass(frozen=True)
class Kind:
    """A family of cells.

    Attributes
    ----------
    share : float
        Of the cells of a trial.
    smallest, largest : float
        m; sizes of its effects, their logarithm evenly spread.
    displaced : bool
        True if that is the size of the displacement itself where it acts, not of what is left in
        the residual.
    """

    share: float
    smallest: float = 0.3e-6
    largest: float = 10e-6
    displaced: bool = False


KINDS = {
    'none': Kind(0.10),
    'one': Kind(0.18, 0.7e-6),
    'faint': Kind(0.07, 0.3e-6, 0.7e-6),
    'departed': Kind(0.22, 1e-6, 6e-6),
    'large': Kind(0.08, 20e-6, 30e-6, displaced=True),
    'two': Kind(0.03),
    'three': Kind(0.06, 0.7e-6, 6e-6),
    'unknown': Kind(0.14, 1e-6, 6e-6),
    'signal': Kind(0.05, 1e-6, 6e-6),
    'places': Kind(0.07),
}
"""Families: nothing; one of the catalogue; a faint one; a known cause in another form; a very
large one, of either; two and three of the catalogue; a cause of no catalogue; a known one that
follows a signal recorded beside the samples; one of the catalogue seen from two tracker places."""
PLACE_EFFECTS = tuple(
    sorted(
        (n for n, e in REGISTRY.items() if e.trial.second_place),
        key=lambda n: REGISTRY[n].trial.second_place,
    )
)
CLEAR = tuple(
    n for n, e in REGISTRY.items()
    if not e.trial.hard_to_see and e.belongs_to is not BelongsTo.NOISE
)  # fmt: skip
"""Effects that leave a trace from one tracker place."""
SIGNAL = 'signal'
"""Family whose cells record a signal."""
ACTS = 0.02
"""Share of the largest displacement from which an effect counts as acting."""
MOST = 25e-6
"""m; root mean square of a displacement itself is not drawn larger, but where it is the size."""
PEAK = 25e-6
"""m; nor does it displace any sample by more: dents and tolerances of corners are not larger."""


@dataclass(frozen=True)
class Part:
    """One hidden effect.

    Attributes
    ----------
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
    depends: Depends

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.applied.effect.name

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the catalogue that are right for it; none for a cause of no catalogue."""
        if self.name in OUTSIDE:
            return tuple(sorted(OUTSIDE[self.name].stands_for))
        return (self.name,)


@dataclass(frozen=True)
class Case:
    """A cell with what it hides.

    Attributes
    ----------
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
    outside = OUTSIDE.get(applied.effect.name)
    depends = (
        outside.depends_on(ruler.states[0], applied.parameters)
        if outside
        else catalogue_depends(applied)
    )
    return Part(applied, ruler.size(moved), ruler.raw(moved), ruler.snr(moved), depends)


def sized(ruler: Ruler, applied: AppliedEffect, kind: Kind, rng: Rng) -> Part:
    """Give an effect a random size."""
    effect = applied.effect
    part = weigh(ruler, applied)
    if effect.belongs_to is BelongsTo.NOISE or part.raw == 0.0:
        return part
    wanted = float(np.exp(rng.uniform(np.log(kind.smallest), np.log(kind.largest))))
    if kind.displaced:
        return weigh(ruler, scaled(applied, wanted / _where_it_acts(ruler, applied)))
    have = part.size
    # where means over pieces wash an effect out, its size is that of the samples
    blurred = effect.wave is not None and part.size < 0.3 * part.raw
    if effect.trial.hard_to_see or blurred:
        wanted, have = 1.5 * wanted, part.raw
    factor = min(wanted / max(have, 1e-12), MOST / part.raw, PEAK / _lengths(ruler, applied).max())
    return weigh(ruler, scaled(applied, factor))


def _lengths(ruler: Ruler, applied: AppliedEffect) -> Array:
    """Size of a displacement at every sample, shape (n,), m."""
    return np.asarray(np.linalg.norm(np.concatenate(ruler.displacement([applied])), axis=1))


def _where_it_acts(ruler: Ruler, applied: AppliedEffect) -> float:
    """Root mean square of a displacement at the samples that it moves, m."""
    length = _lengths(ruler, applied)
    return float(np.sqrt(np.mean(length[length > ACTS * length.max()] ** 2)))


def places_of(kind: str) -> int:
    """Tracker places from which cells of a family are measured."""
    return 2 if kind == 'places' else 1


TAKE_TURNS = {
    'none': (),
    'one': tuple(REGISTRY),
    'faint': CLEAR,
    'departed': tuple(DEPARTED),
    'large': tuple(n for pair in zip(CLEAR, DEPARTED, strict=False) for n in pair),
    'unknown': tuple(UNKNOWN_EFFECTS),
    'signal': tuple(FOLLOWING),
    'places': PLACE_EFFECTS,
}
"""What the cells of a family hide in turn."""


def _names(kind: str, turn: int, rng: Rng) -> list[str]:
    if kind in ('two', 'three'):
        count = 2 if kind == 'two' else 3
        return [str(n) for n in rng.choice(CLEAR, count, replace=False)]
    known = TAKE_TURNS[kind]
    return [known[turn % len(known)]] if known else []


def kinds_of(count: int, seed: int) -> list[tuple[str, int]]:
    """Kind of every cell and how many of its kind came before, in shares of ``KINDS``."""
    rng = np.random.default_rng([seed, 0])
    names, shares = list(KINDS), np.array([k.share for k in KINDS.values()])
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
        Seed of all random draws.
    kind : str
        Of ``KINDS``.
    turn : int
        How many cells of this kind came before: effects take turns.
    names : sequence of str, optional
        Effects to hide instead.
    """
    rng = np.random.default_rng([seed, number + 1])
    trial = draw_trial(f'{number:03d}', rng, places_of(kind), signals=kind == SIGNAL)
    ruler = make_ruler(trial)
    parts = []
    for name in names or _names(kind, turn, rng):
        applied = draw_effect(name, trial.machine, trial.plan.duration, rng)
        parts.append(sized(ruler, applied, KINDS[kind], rng))
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
