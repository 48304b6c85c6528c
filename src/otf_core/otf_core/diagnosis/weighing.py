# SPDX-License-Identifier: Apache-2.0
"""Causes weighed: which matter, what else could be, what has no name, and the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from otf_core.arrays import Array
from otf_core.aside import share_out
from otf_core.diagnosis.cause_parameters import Curve, curves_of, fitted_causes, range_words
from otf_core.diagnosis.engine.empirical_structure import (
    AS_RIVALS,
    SCREENED,
    Rival,
    Structure,
    Structures,
    find_another,
    find_structure,
    rival_of,
    try_structures,
)
from otf_core.diagnosis.engine.gap_sizes import (
    NoiseFinding,
    Residuals,
    check_noise,
    gap_um,
    plain_residuals,
    residuals_with,
    shrink_interval,
    shrink_percent,
    simulated_u,
    wave_um,
)
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import (
    Cause,
    displacement_of,
    fit_jointly,
    noise_variance,
    places_of,
    remove_option,
)
from otf_core.diagnosis.engine.time_courses import DECOY_NAMES
from otf_core.diagnosis.place.groups import RunView, part_names
from otf_core.diagnosis.place.where import EVERYWHERE, NO_STRUCTURE, describe_structure
from otf_core.diagnosis.standing_causes import StandingCauses, standing_causes, structures_of
from otf_core.effects import AppliedEffect, Effect
from otf_core.effects.action import (
    RIGID_TABLE,
    RIGID_TRACKER,
    VECTOR,
    Along,
    acting_name,
)
from otf_core.effects.inputs import (
    CYCLE,
    LETTERS,
    MOMENT,
    PLACE,
    SIGNAL,
    TURNS,
    found_input,
    head_of,
    plain_names,
)
from otf_core.model.frames import XYZ

NO_GAP_SHARE = 0.35
"""Gap over simulated residual below which there is nothing to explain."""
PLAIN_GAP_SHARE = 0.6
"""The same for a residual without structure: the level of noise is known to ten percent only."""
EXPLAINED_SHARE, KNOWN_SHARE = 0.3, 0.55
"""Share of the gap left (as amplitude) up to which it counts as explained; as known at all."""
PLACED_EXPLAINED_SHARE, PLACED_KNOWN_SHARE = 0.1, 0.25
"""The same where what is left has a place or a shape: a cause leaves noise, a wrong one a part of
the true one."""


@dataclass(frozen=True)
class Case:
    """What a verdict depends on.

    Attributes
    ----------
    simulated_um : float
        Residual of the simulation.
    before_um, after_um : float
        Gap without and with the causes named.
    beyond_um : float
        Gap with everything of the catalogue that the data speak for, too small to be named or not.
    named : bool
        True if a cause is named.
    structured : bool
        True if neighbouring pieces share more of the residual than noise explains.
    left_structured : bool
        The same of what is left with everything of the catalogue.
    left_has_place : bool
        True if what is left stands out somewhere.
    decoyed : bool
        True if shapes outside the catalogue explain more than the causes.
    """

    simulated_um: float
    before_um: float
    after_um: float
    beyond_um: float
    named: bool
    structured: bool
    left_structured: bool
    left_has_place: bool
    decoyed: bool


def matters(gap_um: float, simulated_um: float) -> bool:
    """Return whether a gap is large enough beside the simulated residual to be explained."""
    return gap_um > NO_GAP_SHARE * simulated_um


def _least_share(*, structured: bool) -> float:
    """Gap over simulated residual from which there is something to explain."""
    return NO_GAP_SHARE if structured else PLAIN_GAP_SHARE


def verdict_of(case: Case) -> str:
    """Return 'none', 'explained', 'partly_explained' or 'unknown'."""
    if not case.named:
        least = _least_share(structured=case.structured or case.decoyed)
        return 'none' if case.before_um < least * case.simulated_um else 'unknown'
    if case.decoyed:
        return 'unknown'
    explained, known = EXPLAINED_SHARE, KNOWN_SHARE
    if case.left_has_place:
        explained, known = PLACED_EXPLAINED_SHARE, PLACED_KNOWN_SHARE
    least = _least_share(structured=case.left_structured or case.left_has_place)
    if case.beyond_um > max(known * case.before_um, least * case.simulated_um):
        return 'unknown'
    remainder = case.after_um if case.after_um > least * case.simulated_um else 0.0
    return 'explained' if remainder <= explained * case.before_um else 'partly_explained'


MATERIAL_SHARE = 0.12
"""Least share of a further cause in the gap, as amplitude."""
FREE_OF_STRUCTURE = 1.2
"""Correlation of neighbouring pieces below which residuals count as noise."""


@dataclass(frozen=True)
class Explanation:
    """Causes that matter and the residuals with them.

    Attributes
    ----------
    causes : tuple of Cause
        Effects of the catalogue, in the order found.
    twin_um, simulated_um : float
        Residual of the simulation, and with its noise corrected by what the causes leave.
    steps : tuple of Residuals
        Without causes, with the first, with the first two ... (held out).
    fitted : Residuals
        With all causes fitted to all legs.
    known_um : float
        Residual with the effects of the catalogue that the data speak for, too small ones to be
        named included (held out), um.
    known_rest : Residuals
        The same, fitted to all legs.
    structured, left_structured : bool
        True if neighbouring pieces share more of the residual than noise explains: without causes,
        and with the effects of the catalogue that the data speak for.
    decoyed : bool
        True if shapes outside the catalogue explain more than the causes.
    besides : Residuals, optional
        With all causes and an empirical effect beside them (held out).
    small : tuple of Cause
        Effects that the data speak for and that are too small to be named.
    """

    causes: tuple[Cause, ...]
    twin_um: float
    simulated_um: float
    steps: tuple[Residuals, ...]
    fitted: Residuals
    known_um: float
    known_rest: Residuals
    structured: bool
    left_structured: bool
    decoyed: bool
    besides: Residuals | None = None
    small: tuple[Cause, ...] = ()

    @property
    def last(self) -> Residuals:
        """With all causes, and with what has no name beside them (held out)."""
        return self.besides or self.steps[-1]

    @property
    def before_um(self) -> float:
        """Gap without causes, um."""
        return gap_um(self.steps[0].rms_um, self.simulated_um)

    @property
    def after_um(self) -> float:
        """Gap with all causes, on legs they were not fitted on, um."""
        return gap_um(self.last.rms_um, self.simulated_um)

    @property
    def simulated_u_um(self) -> float:
        """Standard uncertainty of ``simulated_um``, um; see ``simulated_u``."""
        return simulated_u(self.twin_um, self.simulated_um)

    def doubted(self, rival: Rival) -> Explanation:
        """The same with confidences that count something else and nothing."""
        causes = tuple(replace(c, confidence=rival.confidence(c)) for c in self.causes)
        return replace(self, causes=causes)

    def without_causes(self, simulated_um: float) -> Explanation:
        """The same with nothing named: where no effect explains the gap."""
        first = self.steps[0]
        return replace(
            self, causes=(), simulated_um=simulated_um, steps=(first,), fitted=first, besides=None
        )


def explain(rows: Rows, causes_found: Sequence[Cause], twin_um: float) -> Explanation:
    """Keep the effects that matter.

    Parameters
    ----------
    causes_found : sequence of Cause
        What the search found, decoys among them, in its order.
    twin_um : float
        Residual of the simulation.
    """
    simulated_um = twin_um * noise_level(rows, causes_found)
    causes, steps = _named(rows, causes_found, simulated_um)
    decoyed = _decoyed(causes, steps)
    in_catalogue = [c for c in causes if _in_catalogue(c)]
    if len(in_catalogue) < len(causes):  # what a decoy takes away is not explained
        causes = in_catalogue
        steps = [residuals_with(rows, in_catalogue[:k]) for k in range(len(in_catalogue) + 1)]
    fitted = residuals_with(rows, causes, held_out=False)
    # what is found after a decoy lives on what that left
    first = takewhile(_in_catalogue, causes_found)
    known = [*causes, *(c for c in first if all(c is not named for named in causes))]
    known_um, rest = steps[-1].rms_um, fitted
    if len(known) > len(causes):
        known_um = min(known_um, residuals_with(rows, known).rms_um)
        rest = residuals_with(rows, known, held_out=False)
    structured, left_structured = (
        _structure(rows, part) > FREE_OF_STRUCTURE
        for part in (rows.residual, _less_causes(rows, known))
    )
    levels = twin_um, simulated_um
    return Explanation(
        tuple(causes),
        *levels,
        tuple(steps),
        fitted,
        known_um,
        rest,
        structured,
        left_structured,
        decoyed,
        small=tuple(known[len(causes) :]),
    )


def _named(
    rows: Rows, causes_found: Sequence[Cause], simulated_um: float
) -> tuple[list[Cause], list[Residuals]]:
    """Causes that matter, and the residuals step by step."""
    whole = plain_residuals(rows)
    gap = gap_um(whole.rms_um, simulated_um)
    causes, steps = _material(rows, causes_found, whole, gap, all_alike=False)
    if not causes and matters(gap, simulated_um):
        return _material(rows, causes_found, whole, gap, all_alike=True)
    return causes, steps


def _material(
    rows: Rows, causes_found: Sequence[Cause], whole: Residuals, gap: float, *, all_alike: bool
) -> tuple[list[Cause], list[Residuals]]:
    """Causes whose own trace matters, in itself and beside the whole gap.

    ``all_alike`` asks no more of those that smooth machines have a little of than of others.
    """
    causes: list[Cause] = []
    steps = [whole]
    for cause in causes_found:
        after = residuals_with(rows, [*causes, cause])
        trace = float(np.sqrt(max(0.0, steps[-1].rms_um ** 2 - after.rms_um**2)))
        trace = max(trace, wave_um(cause, rows))
        least = Effect.material_um if all_alike else cause.option.effect.material_um
        if trace > max(least, MATERIAL_SHARE * gap):
            causes.append(cause)
            steps.append(after)
    return causes, steps


def noise_level(rows: Rows, causes_found: Sequence[Cause]) -> float:
    """Correction of the twin's noise, from what the causes leave.

    How fast noise averages out over a piece is known to some ten percent from short stops. If
    what is left has no structure, its size tells better.
    """
    residual = _less_causes(rows, causes_found)
    structure = _structure(rows, residual)
    variance = float(np.mean(residual**2)) * len(residual) / (len(residual) - len(rows.use))
    low, high = rows.noise_range
    if structure > FREE_OF_STRUCTURE or not low < variance < high:
        return 1.0
    return float(np.sqrt(variance))


def _less_causes(rows: Rows, causes: Sequence[Cause]) -> Array:
    """What the best fits of causes leave, one after the other."""
    residual = rows.residual
    for cause in causes:
        residual = remove_option(cause.option, residual)
    return residual


def _structure(rows: Rows, residual: Array) -> float:
    """Inflation by the correlation of neighbouring pieces; 1 for noise as assumed."""
    return noise_variance(rows, residual) / max(float(np.mean(residual**2)), 1.0)


def _in_catalogue(cause: Cause) -> bool:
    return cause.option.effect.name not in DECOY_NAMES


def _decoyed(causes: Sequence[Cause], steps: Sequence[Residuals]) -> bool:
    """Return whether shapes outside the catalogue explain more than the effects named."""
    power = {True: 0.0, False: 0.0}
    for cause, before, after in zip(causes, steps[:-1], steps[1:], strict=True):
        power[not _in_catalogue(cause)] += max(0.0, before.rms_um**2 - after.rms_um**2)
    return power[True] > power[False]


FAR_BETTER = 0.5
"""Share of the gap that the named causes leave, below which a cause without a name beats them."""
LEAST_SHRINK = 20.0
"""Percent; a structure that takes less of the gap is not worth stating."""
MOST, LEAST_BESIDES = 3, 0.15
"""Structures at most, and the share of the squared gap that each but the first must take."""
WORDS = {
    'time': 'time',
    **{a: f'the position of {a.upper()}' for a in LETTERS},
    'feed': 'the feed', 'acceleration': 'the acceleration along the path',
    'since_stop': 'the time since the last stop', 'lap': 'the lap', 'leg': 'the leg',
    'range': 'the length of the beam', 'azimuth': 'the azimuth of the beam',
    'elevation': 'the elevation of the beam',
}  # fmt: skip
ACTS = {
    VECTOR: 'a shift of the target',
    RIGID_TRACKER: 'a shift and rotation of all points measured by the tracker',
    RIGID_TABLE: 'a shift and turn of the table',
}
ALMOST = 0.95
"""Component of a unit vector from which it counts as along an axis."""
MECHANISMS = (
    ({'range', 'azimuth', 'elevation'}, 'air along the beam, the tracker or its stand'),
    ({f'sense_{a}' for a in LETTERS}, 'friction, play or clamps of the drives that reverse'),
    (
        {f'since_reversal_{a}' for a in LETTERS},
        'wind-up and friction that build up after a reversal',
    ),
    ({'since_stop', 'acceleration'}, 'inertia and settling after changes of speed'),
    ({'feed'}, 'forces or films that grow with speed: oil film, air drag, control'),
    ({'lap'}, 'something that changed between the laps'),
    ({PLACE}, 'a fault of a guideway or of the structure at one place'),
    ({MOMENT}, 'a jolt: something slipped, gave way or was knocked'),
    ({*TURNS}, 'a screw, a gear, a rack or the balls of a guide: what repeats with travel'),
    ({CYCLE}, 'something switching periodically: cooling, coolant, air conditioning, a pump'),
    ({'time'}, 'warming, settling or something that switches while the run lasts'),
    ({'x', 'y', 'z'}, 'a structure that bends with the place of its slides'),
)
"""Kinds of mechanism that depend on any of some inputs."""
WITH_WORDS = {CYCLE, MOMENT, PLACE, *TURNS}
"""Inputs with numbers that have kinds of mechanism of their own."""


@dataclass(frozen=True)
class Unnamed:
    """Cause without a name (docs/conventions.md, gap.json).

    Attributes
    ----------
    acts_as : str
        'vector', 'direction', 'rigid_tracker' or 'rigid_table'.
    before_um, after_um : float
        Gap without and with it, on legs it was not fitted on.
    shrink_interval_percent : tuple of two floats
        95 % interval over legs.
    """

    depends_on: tuple[str, ...]
    acts_as: str
    words: str
    before_um: float
    after_um: float
    shrink_percent: float
    shrink_interval_percent: tuple[float, float]
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class UnnamedCause:
    """A cause without a name, and the empirical effects that reproduce it in every run."""

    said: Unnamed
    applied: tuple[tuple[AppliedEffect, ...], ...]
    simulated_um: float
    """Residual of the simulation, its noise corrected by what the structures leave."""
    structures: tuple[Structure, ...] = ()


def find_unnamed(
    rows: Rows, explained: Explanation, verdict: str, tried: Structures, rival: Rival
) -> UnnamedCause | None:
    """Look for a cause without a name where the named ones leave a gap.

    Parameters
    ----------
    verdict : str
        By the effects of the catalogue.
    tried : Structures
        What may explain the gap.
    rival : Rival
        Of the named causes.

    Returns
    -------
    Nameless or None
        None if nothing is left to explain, if no structure explains it, or if the named causes
        are about as good.
    """
    if verdict not in ('unknown', 'partly_explained') and not rival.wins:
        return None
    first = find_structure(tried)
    if first is None:
        return None
    nameless = _with_more(rows, explained, tried, first)
    if nameless.said.shrink_percent < LEAST_SHRINK:
        return None
    enough = (1.0 if rival.wins else FAR_BETTER) * explained.after_um
    remainder = nameless.said.after_um
    worse = remainder > enough and (not rival.wins or matters(remainder, explained.twin_um))
    return None if verdict != 'unknown' and worse else nameless


def _with_more(
    rows: Rows, explained: Explanation, tried: Structures, first: Structure
) -> UnnamedCause:
    """Add to a structure those that take enough of the gap besides."""
    structures = [first]
    nameless = _describe_structures(rows, explained, structures)
    least = LEAST_BESIDES * nameless.said.before_um**2
    while len(structures) < MOST and nameless.said.after_um**2 > least:
        other = find_another(tried, structures)
        if other is None:
            break
        more = _describe_structures(rows, explained, [*structures, other])
        if nameless.said.after_um**2 - more.said.after_um**2 < least:
            break
        structures, nameless = [*structures, other], more
    return nameless


def _describe_structures(
    rows: Rows,
    explained: Explanation,
    structures: Sequence[Structure],
    known: Sequence[Cause] = (),
) -> UnnamedCause:
    """Structures beside known causes, in words and as effects."""
    causes = [*known, *(s.cause for s in structures)]
    before, after = explained.steps[len(known)], residuals_with(rows, causes)
    own_noise = explained.twin_um * noise_level(rows, causes)
    simulated = explained.simulated_um if known else own_noise
    sizes = [gap_um(r.rms_um, simulated) for r in (before, after)]
    parts = fitted_causes(causes, rows)[len(known) :]
    curves = [curves_of(part) for part in parts]
    words = [_words(s, own) for s, own in zip(structures, curves, strict=True)]
    said = Unnamed(
        depends_on=tuple(dict.fromkeys(n for s in structures for n in s.inputs)),
        acts_as=acting_name(structures[0].effect.form.acts),
        words='; and besides it '.join(words),
        before_um=sizes[0],
        after_um=sizes[1],
        shrink_percent=shrink_percent(*sizes),
        shrink_interval_percent=shrink_interval(
            before, after, simulated, simulated_u(explained.twin_um, simulated)
        ),
        curves=tuple(c for own in curves for c in own),
    )
    runs = range(len(rows.states))
    applied = tuple(tuple(part.applied(k) for part in parts) for k in runs)
    return UnnamedCause(said, applied, simulated, tuple(structures))


def input_words(name: str) -> str:
    """Name of an input in words."""
    if name.startswith(SIGNAL):
        return f'the signal {name.removeprefix(SIGNAL)}'
    if found := found_input(name):
        return found.words
    head, _, axis = name.rpartition('_')
    of_axis = {
        'sense': 'the sense of travel of',
        'since_reversal': 'the travel since a reversal of',
    }
    return WORDS.get(name) or f'{of_axis[head]} {axis.upper()}'


def _words(structure: Structure, curves: Sequence[Curve]) -> str:
    inputs = structure.effect.form.inputs
    depends = ' and '.join(input_words(n) for n in inputs)
    acts = structure.effect.form.acts
    moved = f'a shift along {_direction_words(acts)}' if isinstance(acts, Along) else ''
    moved = moved or ACTS[acting_name(acts)]
    sizes = f', {range_words(curves[0])}' if curves else ''
    signals = any(n.startswith(SIGNAL) for n in inputs)
    kinds_of = {head_of(n) or n for n in inputs}
    kinds_of |= set(plain_names([n for n in inputs if head_of(n) not in WITH_WORDS]))
    kinds = [words for names, words in MECHANISMS if names & kinds_of][:2]
    kinds = ['what that signal measures'] if signals else kinds
    return f'depends on {depends}: {moved}{sizes}; typical of: {", or ".join(kinds)}'


def _direction_words(acts: Along) -> str:
    main = int(np.argmax(np.abs(acts.direction)))
    if abs(acts.direction[main]) > ALMOST:
        return XYZ[main]
    return f'X, Y, Z = ({", ".join(f"{v:.2f}" for v in acts.direction)})'


@dataclass(frozen=True)
class WeighedExplanation:
    """What a search gave, after what else could be.

    Attributes
    ----------
    explained : Explanation
        Without causes where they are not enough.
    left : str
        Where what the causes leave lies.
    """

    verdict: str
    explained: Explanation
    noise: NoiseFinding | None
    left: str
    nameless: UnnamedCause | None

    @property
    def noise_cause(self) -> NoiseFinding | None:
        """Noise as a cause: not where something is there that nobody knows."""
        return None if self.verdict == 'unknown' else self.noise


def judge(
    rows: Rows, explained: Explanation, speed: float, exclude: Sequence[str]
) -> WeighedExplanation:
    """Weigh the causes found against noise, and against what has no name.

    Parameters
    ----------
    speed : float, m/s
        Slower is a standstill.
    """
    gap = matters(explained.after_um, explained.simulated_um)
    noise = check_noise(rows, speed, exclude, gap=gap)
    remainder, has_place = _shape_of_rest(rows, explained)
    verdict = verdict_of(_case(explained, noise, has_place=has_place))
    weighed = _or_something_else(rows, explained, verdict, exclude)
    explained, nameless = weighed.explained, weighed.nameless
    if weighed.verdict == 'unknown':
        known = nameless.simulated_um if nameless else explained.simulated_um
        explained = explained.without_causes(known)
    elif noise and weighed.verdict == 'none':
        weighed = replace(weighed, verdict='explained')
    return WeighedExplanation(weighed.verdict, explained, noise, remainder, nameless)


@dataclass(frozen=True)
class _Weighed:
    """A verdict with the causes that it stands on, and what has no name."""

    verdict: str
    explained: Explanation
    nameless: UnnamedCause | None = None


def _or_something_else(
    rows: Rows, explained: Explanation, verdict: str, exclude: Sequence[str]
) -> _Weighed:
    """Doubt the names for what else may explain the gap; keep those that stand beside that."""
    if explained.causes:
        count = AS_RIVALS if verdict == 'explained' else SCREENED
        tried = try_structures(_without_small(rows, explained), count)
        rival = rival_of(explained.causes, tried)
    elif verdict == 'unknown':
        tried, rival = try_structures(rows, SCREENED), Rival()
    else:
        return _Weighed(verdict, explained)
    doubted = explained.doubted(rival)
    alone = find_unnamed(rows, doubted, verdict, tried, rival)
    if verdict == 'explained' and alone is None:
        return _Weighed(verdict, doubted)
    standing = _standing(rows, explained, alone, tried, verdict, exclude)
    if standing is not None:
        return standing
    if alone or _leaves_most(explained, explained.last):
        return _Weighed('unknown', doubted, alone)
    return _Weighed(verdict, doubted)


def _without_small(rows: Rows, explained: Explanation) -> Rows:
    """Rows less effects too small to be named: what explains these as well is no better for it."""
    if not explained.causes or not explained.small:
        return rows
    every = [*explained.causes, *explained.small]
    value, places = fit_jointly(every, rows).value, places_of(every)
    first = places[len(explained.causes)].start
    return rows.without(displacement_of(explained.small, value[first:]))


def _standing(
    rows: Rows,
    explained: Explanation,
    alone: UnnamedCause | None,
    tried: Structures,
    verdict: str,
    exclude: Sequence[str],
) -> _Weighed | None:
    """Causes that stand beside what has no name; None where the gap has no name at all."""
    least = MATERIAL_SHARE * explained.before_um
    standing = standing_causes(rows, explained.causes, least)
    without = StandingCauses.of(rows, (), structures_of(rows, tried)) if alone else None
    if standing and without:  # both for the noise that the better of them leaves
        standing, without = (
            StandingCauses.of(rows, s.causes, s.structures, t.variance)
            for s, t in ((standing, without), (without, standing))
        )
    if standing is None or (without and without.evidence > standing.evidence):
        standing = without
    if standing is None or not _describes(standing, explained, verdict):
        return None
    standing = standing.with_names(exclude)
    if not standing.causes:
        return None
    causes = tuple(
        replace(c, confidence=standing.confidence(k, without))
        for k, c in enumerate(standing.causes)
    )
    every = [*causes, *(s.cause for s in standing.structures)]
    explained = replace(
        explained,
        causes=causes,
        steps=tuple(residuals_with(rows, causes[:k]) for k in range(len(causes) + 1)),
        fitted=residuals_with(rows, every, held_out=False),
        besides=standing.residuals,
    )
    nameless = (
        _describe_structures(rows, explained, standing.structures, causes)
        if standing.structures
        else None
    )
    if nameless and nameless.said.shrink_percent < LEAST_SHRINK:  # not worth stating
        if verdict == 'unknown' or _leaves_most(explained, explained.steps[-1]):
            return None
        nameless, explained = None, replace(explained, besides=None)
    return _Weighed(_verdict_beside(explained, nameless), explained, nameless)


def _describes(standing: StandingCauses, explained: Explanation, verdict: str) -> bool:
    """Return whether causes and what has no name describe the gap well enough to be believed.

    A right cause leaves the other cause, which has a structure of its own. What imitates a cause
    that no smooth function describes leaves a part of it.
    """
    if _leaves_most(explained, standing.residuals):
        return False
    return bool(standing.structures) or verdict != 'unknown'


def _leaves_most(explained: Explanation, rest: Residuals) -> bool:
    """Return whether most of a gap is left."""
    known = max(KNOWN_SHARE * explained.before_um, NO_GAP_SHARE * explained.simulated_um)
    return gap_um(rest.rms_um, explained.simulated_um) > known


def _verdict_beside(explained: Explanation, nameless: UnnamedCause | None) -> str:
    """Whether causes that stand explain the gap to the end."""
    remainder = explained.after_um if matters(explained.after_um, explained.simulated_um) else 0.0
    if nameless or remainder > EXPLAINED_SHARE * explained.before_um:
        return 'partly_explained'
    return 'explained'


def _shape_of_rest(rows: Rows, explained: Explanation) -> tuple[str, bool]:
    """Shape of what the causes leave, and whether what all that is known leaves has a place."""
    if not explained.causes:
        return NO_STRUCTURE, False

    def shape(rest: Residuals) -> str:
        views = run_views(rows, explained, rest)
        return describe_structure(views, 'residual_after', rows.project)

    same = explained.known_rest is explained.fitted
    looked = [explained.fitted] if same else [explained.fitted, explained.known_rest]
    shape_left, rest = (share_out(shape, looked) * 2)[:2]
    return shape_left, rest not in (NO_STRUCTURE, EVERYWHERE)


def _case(explained: Explanation, noise: NoiseFinding | None, *, has_place: bool) -> Case:
    """What the verdict depends on, with noise as found in the simulation."""
    simulated = explained.simulated_um * (1.0 if noise is None else noise.level)
    return Case(
        simulated_um=simulated,
        before_um=gap_um(explained.steps[0].rms_um, simulated),
        after_um=gap_um(explained.steps[-1].rms_um, simulated),
        beyond_um=gap_um(explained.known_um, simulated),
        named=bool(explained.causes),
        structured=explained.structured,
        left_structured=explained.left_structured,
        left_has_place=has_place,
        decoyed=explained.decoyed,
    )


def run_views(
    rows: Rows, explained: Explanation, rest: Residuals | None = None
) -> tuple[RunView, ...]:
    """Plain arrays of every run, with the residuals without causes and with them (``rest``)."""
    rest = rest or explained.fitted
    parts = rows.by_run(explained.steps[0].rows), rows.by_run(rest.rows)
    return tuple(
        RunView(
            name=run.recording.name or f'run {k}',
            axis_names=state.machine.axis_names,
            time=state.time,
            leg=run.pieces.leg,
            q=state.q,
            direction=state.direction,
            speed=state.speed,
            beam=state.beam,
            axes=solved.system.axes,
            residual_before=before,
            residual_after=after,
            expected=whitener.expected,
            noise=whitener,
            rotary=state.machine.rotary_names,
            point=state.point,
            part=None if state.turning is None else state.turning.part,
            part_names=part_names(state),
        )
        for k, (run, solved, whitener, state, before, after) in enumerate(
            zip(rows.observed, rows.done.runs, rows.whiteners, rows.states, *parts, strict=True),
            start=1,
        )
    )
