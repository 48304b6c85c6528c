# SPDX-License-Identifier: Apache-2.0
"""What a cell hides, and how large it is.

Nothing; one effect of the catalogue; a known cause in a form of nature; two or three of either;
one amid small ones; a cause of no catalogue. The size of an effect is the root mean square of what
it leaves in the residual once tables and poses have followed it (``observer``); effects that leave
next to nothing get a typical size instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.axis_cases import AXIS_KINDS
from otf_core.blind.depends import EffectInputs, catalogue_depends
from otf_core.blind.draw import Trial, draw_effect, draw_trial, nodal, scale_effect
from otf_core.blind.forms import TILT
from otf_core.blind.natures import DEPARTED, FOLLOWING, OUTSIDE, UNKNOWN_EFFECTS
from otf_core.blind.observer import Ruler, make_ruler
from otf_core.effects import REGISTRY, AppliedEffect, BelongsTo
from otf_core.model.kinematics import displacement

Rng = np.random.Generator


@dataclass(frozen=True)
class CellFamily:
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
    seen : bool
        True if effects are drawn anew until they leave that much in the residual.
    small : bool
        True if small causes act besides.
    """

    share: float
    smallest: float = 0.3e-6
    largest: float = 10e-6
    displaced: bool = False
    seen: bool = False
    small: bool = False


KINDS = {
    'none': CellFamily(0.05),
    'one': CellFamily(0.10, 0.7e-6),
    'faint': CellFamily(0.05, 0.3e-6, 0.7e-6),
    'departed': CellFamily(0.11, 1e-6, 6e-6),
    'tilt': CellFamily(0.07, 1e-6, 6e-6, seen=True),
    'large': CellFamily(0.05, 20e-6, 30e-6, displaced=True),
    'mixture': CellFamily(0.10, 0.7e-6, 6e-6, seen=True),
    'as_is': CellFamily(0.08, 2e-6, 6e-6, seen=True, small=True),
    'small': CellFamily(0.03, small=True),
    'unknown': CellFamily(0.08, 1e-6, 6e-6),
    'signal': CellFamily(0.03, 1e-6, 6e-6),
    'places': CellFamily(0.03),
    'long': CellFamily(0.04, 2e-6, 10e-6, seen=True),
    **{name: CellFamily(share) for name, share in AXIS_KINDS.items()},
}
"""Families: nothing; one of the catalogue; a faint one; a known cause in another form; a table
that tilts; a very large one, of either; two or three of either; one of either amid small ones;
small ones alone; a cause of no catalogue; a known one that follows a signal recorded beside the
samples; one of the catalogue seen from two tracker places; one of either on a machine of 2 m to
6 m; and those of machines with rotary axes, see ``axis_cases``."""
SMALL = (0.1e-6, 0.5e-6)
"""m; sizes of small causes."""
SMALL_COUNT = (4, 6)
"""How many there are at least and at most."""
DRAWS = 20
"""Draws of an effect until it leaves what it should."""
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
KNOWN = (*CLEAR, *DEPARTED)
"""These, and known causes in other forms."""
TILTS = tuple(n for n, e in DEPARTED.items() if TILT in e.stands_for)
SIGNAL, LONG, MIXTURE = 'signal', 'long', 'mixture'
"""Families whose cells record a signal, are large machines, hide two or three causes."""
ACTS = 0.02
"""Share of the largest displacement from which an effect counts as acting."""
MOST = 25e-6
"""m; root mean square of a displacement itself is not drawn larger, but where it is the size. On
machines longer than ``USUAL`` in proportion."""
PEAK = 25e-6
"""m; nor does it displace any sample by more: dents and tolerances of corners are not larger."""
USUAL = 1.2
"""m; diagonal of the volume."""


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
    depends: EffectInputs

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


def draw_size(
    ruler: Ruler, applied: AppliedEffect, kind: CellFamily, rng: Rng, sizes: tuple[float, float]
) -> Part:
    """Give an effect a random size."""
    effect = applied.effect
    part = weigh(ruler, applied)
    if effect.belongs_to is BelongsTo.NOISE or part.raw == 0.0:
        return part
    wanted = float(np.exp(rng.uniform(*np.log(sizes))))
    if kind.displaced:
        return weigh(ruler, scale_effect(applied, wanted / _where_it_acts(ruler, applied)))
    have = part.size
    # where means over pieces wash an effect out, its size is that of the samples
    blurred = effect.wave is not None and part.size < 0.3 * part.raw
    if (effect.trial.hard_to_see and not kind.seen) or blurred:
        wanted, have = 1.5 * wanted, part.raw
    machine = ruler.trial.machine
    longer = max(1.0, float(np.linalg.norm(machine.upper - machine.lower)) / USUAL)
    most = min(MOST / part.raw, PEAK / _lengths(ruler, applied).max())
    return weigh(ruler, scale_effect(applied, min(wanted / max(have, 1e-12), longer * most)))


def draw_part(
    ruler: Ruler, name: str, kind: CellFamily, rng: Rng, sizes: tuple[float, float]
) -> Part:
    """Draw an effect with its size, anew where it has to be seen and leaves too little."""
    trial = ruler.trial
    for _ in range(DRAWS):
        applied = draw_effect(name, trial.machine, trial.plan.duration, rng)
        part = draw_size(ruler, applied, kind, rng, sizes)
        if not kind.seen or max(part.size, _blurred(part)) > 0.9 * sizes[0]:
            break
    return part


def _blurred(part: Part) -> float:
    """Size of a wave that means over pieces wash out, of the samples, m."""
    waves = [REGISTRY[n].wave for n in part.names]
    return part.raw if any(w is not None for w in waves) else 0.0


def _lengths(ruler: Ruler, applied: AppliedEffect) -> Array:
    """Size of a displacement at every sample, shape (n,), m."""
    return np.asarray(np.linalg.norm(np.concatenate(ruler.displacement([applied])), axis=1))


def _where_it_acts(ruler: Ruler, applied: AppliedEffect) -> float:
    """Root mean square of a displacement at the samples that it moves, m."""
    length = _lengths(ruler, applied)
    return float(np.sqrt(np.mean(length[length > ACTS * length.max()] ** 2)))


def trial_of(kind: str, name: str, rng: Rng) -> Trial:
    """Draw a cell of a family, without effects; one is measured from two tracker places."""
    places = 2 if kind == 'places' else 1
    return draw_trial(name, rng, places, signals=kind == SIGNAL, large=kind == LONG)


TAKE_TURNS = {
    'one': tuple(REGISTRY),
    'faint': CLEAR,
    'departed': tuple(n for n in DEPARTED if n not in TILTS),
    'tilt': TILTS,
    'large': tuple(n for pair in zip(CLEAR, DEPARTED, strict=False) for n in pair),
    'unknown': tuple(UNKNOWN_EFFECTS),
    'signal': tuple(FOLLOWING),
    'places': PLACE_EFFECTS,
}
"""What the cells of a family hide in turn; of the others, any of ``KNOWN``."""


def names_of(effect: str) -> frozenset[str]:
    """Names of the catalogue that are right for an effect."""
    return OUTSIDE[effect].stands_for if effect in OUTSIDE else frozenset({effect})


def _apart(count: int, rng: Rng, besides: Sequence[str] = ()) -> list[str]:
    """Draw causes no two of which have a name in common."""
    chosen = list(besides)
    for name in map(str, rng.permutation(KNOWN)):
        if len(chosen) < count + len(besides) and not any(
            names_of(name) & names_of(other) for other in chosen
        ):
            chosen.append(name)
    return chosen[len(besides) :]


def draw_names(kind: str, turn: int, rng: Rng) -> list[str]:
    """Draw what a cell hides, but for small causes; ``turn``: how many of its kind came before."""
    if known := TAKE_TURNS.get(kind):
        return [known[turn % len(known)]]
    if kind == MIXTURE:
        return _apart(2 + turn % 2, rng)
    if kind == LONG and turn % 2:
        return [TILTS[int(rng.integers(len(TILTS)))]]
    return _apart(int(kind in ('as_is', LONG)), rng)


def kinds_of(
    count: int, seed: int, families: Sequence[str] = tuple(KINDS)
) -> list[tuple[str, int]]:
    """Kind of every cell and how many of its kind came before, in shares of ``KINDS``."""
    rng = np.random.default_rng([seed, 0])
    names, shares = list(families), np.array([KINDS[n].share for n in families])
    wanted = shares / shares.sum() * count
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
    family = KINDS[kind]
    trial = trial_of(kind, f'{number:03d}', rng)
    ruler = make_ruler(trial)
    names = names or draw_names(kind, turn, rng)
    sizes = family.smallest, family.largest
    parts = [draw_part(ruler, name, family, rng, sizes) for name in names]
    if family.small:
        count = int(rng.integers(SMALL_COUNT[0], SMALL_COUNT[1] + 1))
        besides = _apart(count, rng, names)
        parts += [draw_part(ruler, name, family, rng, SMALL) for name in besides]
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
