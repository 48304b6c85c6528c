# SPDX-License-Identifier: Apache-2.0
"""Drifts of what is switched on and off: moments and lag that make the data most likely.

A spindle that is on and off lets the structure grow and shrink: a course with a kink at every
switch, which a polynomial follows only far enough to look like a wave. Switches are added one by
one, the best sets of them kept, each of them and the lag moved until nothing improves: with the
same size each time, on and off in turn, and with any size at every switch. The best of both are
made exactly; they pay for the choice, the logarithm of the number of moments that each switch
could have. The same with no lag, jumps, is a decoy: what jumps several times is no drift. So is a
wave of any period.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.aside import shared_out
from otf_core.diagnosis.engine.candidates import Beside
from otf_core.diagnosis.engine.decoys import DECOY_NAMES, SlowWave
from otf_core.diagnosis.engine.effect_products import Tried, tried_shapes
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.time_courses import CourseInTime, Courses
from otf_core.effects.action import Acting
from otf_core.effects.base import Effect, Shape
from otf_core.effects.free import switched
from otf_core.effects.free_form import FreeForm
from otf_core.effects.switching import Switching, responses

Moments = tuple[float, ...]

MOST_TURNS, TURN = 16.0, 0.2
"""Turns of a slow wave in a run, and the distance of those that are tried first."""
MOMENTS = 40
"""Moments at which a switch is looked for first."""
LAGS = (0.06, 0.1, 0.18, 0.35, 0.7)
"""Shares of the recording."""
SHORTEST, LONGEST = 0.05, 1.5
"""Shares of the recording between which the lag of a drift lies; what is faster is a jump."""
APART, JUMPS_APART = 1.0 / 9.0, 0.005
"""Share of the recording between two switches, and jumps: what switches faster is a swing."""
AT_ONCE = 0.005
"""Share of the recording up to which a first moment is its start."""
SWITCHES, UNLIKE = 6, 4
"""At most, the start among them: alike each time it is on, or by any amount each time."""
BEAM = 6
"""Sets of moments that are kept while switches are added."""
MADE = 2
"""Numbers of switches, the likeliest first, that are made exactly."""
COARSE, FINE = range(2), range(2, 7)
"""Halvings of the steps by which moments and lag are improved: while switches are added, and of
the best sets."""
STEPS = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
"""By which a moment is moved."""
WORTH = 9.0
"""Evidence of some function of time from which switches are looked for."""
BEHIND, HOPELESS = 0.9, 30.0
"""Share of the evidence of the best candidate, less so much, that a course in time needs to be
looked at: what has less is neither named nor not told from what is."""

_Kind = tuple[bool, bool] | None
"""Whether it jumps and is alike each time it is on; None for what no moment is looked for."""
KINDS: tuple[_Kind, ...] = (
    (False, False), (False, True), (True, False), (True, True), None,
)  # fmt: skip


def add_switching(beside: Beside, variance: float) -> Beside:
    """The same with drifts and jumps of what switches, and waves, at their likeliest moments."""
    groups = {n: list(g) for n, g in beside.candidates.items()}
    courses = [t for g in groups.values() for t in g if isinstance(t.effect, CourseInTime)]
    if not courses or not _something_in_time(groups, variance):
        return beside
    rows = beside.rows
    best = max(t.odds(k, variance) for g in groups.values() for t in g for k in t.takes)
    least = BEHIND * best - HOPELESS
    ways = [_Way.of(t, groups, rows, variance) for t in courses]
    jobs = [(way, kind) for way in ways if way.courses.most >= least for kind in KINDS]

    def switching(job: tuple[_Way, _Kind]) -> list[Tried]:
        found = []
        for effect, shape, price in job[0].likely(job[1], rows, least):
            (made,) = tried_shapes(rows, effect, [shape])
            found.append(replace(beside.less(made), price=price))
        return found

    rows.prepare()
    beside.taken  # noqa: B018
    known = (rows, *(e for way in ways for e in way.drivers))
    for made in chain.from_iterable(shared_out(switching, jobs, known)):
        groups[made.effect.name].append(made)
    return replace(beside, candidates=groups)


@dataclass(frozen=True, eq=False)
class _Way:
    """One way to act, in which effects may switch.

    Attributes
    ----------
    drivers : tuple of Effect
        Those that are candidates.
    """

    acts: Acting
    drivers: tuple[Effect, ...]
    courses: Courses

    @classmethod
    def of(
        cls, tried: Tried, groups: Mapping[str, Sequence[Tried]], rows: Rows, variance: float
    ) -> _Way:
        """Take the way of a ``CourseInTime``."""
        assert isinstance(tried.effect, CourseInTime)
        drivers = tuple(e for e in tried.effect.drivers if e.name in groups)
        return cls(tried.effect.acts, drivers, Courses.of(tried, rows.states[0].end, variance))

    def likely(
        self, kind: _Kind, rows: Rows, least: float
    ) -> Iterator[tuple[Effect, Shape, float]]:
        """Effects that act in this way, at their likeliest moments, and their price.

        Those that have more evidence than ``least``.
        """
        if kind is None:
            yield from self._formulas(rows, least)
            return
        jumps, alike = kind
        named = [
            e
            for e in self.drivers
            if (e.name in DECOY_NAMES) == jumps and not isinstance(e, SlowWave)
        ]
        found = likeliest(self.courses, jumps=jumps, alike=alike) if named else []
        for switching, price in (one[1:] for one in found if one[0] > least):
            free = switched(self.acts, switching, 1 if alike else len(switching.moments))
            for effect in named:
                yield FreeForm.bound(effect, free, rows.states), {}, price

    def _formulas(self, rows: Rows, least: float) -> Iterator[tuple[Effect, Shape, float]]:
        """Waves at their likeliest period, drifts from the start with their likeliest lag."""
        waves = [e for e in self.drivers if isinstance(e, SlowWave)]
        drifts = [e for e in self.drivers if e.name not in DECOY_NAMES]
        score, period = swing(self.courses) if waves else (-np.inf, 0.0)
        for wave in waves if score > least else ():
            yield wave, {'period': period}, float(np.log(MOST_TURNS / TURN))
        score, lag = lag_from_start(self.courses) if drifts else (-np.inf, 0.0)
        for effect in drifts if score > least else ():
            shape = {'tau': lag, 'until': rows.states[0].end, 'order': 1.0}
            yield effect, effect.complete_shape(shape), float(np.log(len(LAGS)))


def _something_in_time(groups: Mapping[str, Sequence[Tried]], variance: float) -> bool:
    """Tell whether any effect that may switch, or a decoy, has the odds to be named."""
    drivers = {
        e.name
        for g in groups.values()
        for t in g
        if isinstance(t.effect, CourseInTime)
        for e in t.effect.drivers
    }
    own = (t for n in (drivers | DECOY_NAMES) & set(groups) for t in groups[n])
    return any(t.odds(take, variance) > WORTH for t in own for take in t.takes)


def likeliest(
    courses: Courses, *, jumps: bool, alike: bool
) -> list[tuple[float, Switching, float]]:
    """Find the likeliest moments and lags of what switches.

    Their evidence, they themselves, and the price of having looked, which is taken off.
    """
    end = float(courses.time[-1])
    lags = np.zeros(1) if jumps else end * np.array(LAGS)
    grid = np.linspace(0.0, end, MOMENTS + 1)[int(jumps) : -1].tolist()
    found: list[tuple[float, Array]] = []
    kept: list[Moments] = [()]
    for _ in range(SWITCHES if alike else UNLIKE):
        moments = np.array(sorted({tuple(sorted((*known, m))) for known in kept for m in grid}))
        moments = moments[_apart(moments, end, jumps=jumps)]
        if not len(moments):
            break
        by_lag = [_with_lag(moments, lag) for lag in lags]
        scores = np.concatenate([judged(courses, sets, alike=alike) for sets in by_lag])
        order, sets = np.argsort(scores)[::-1], np.concatenate(by_lag)
        best = [tuple(sets[k, :-1].tolist()) for k in order[: BEAM * len(lags)]]
        score, likely = _improved(courses, sets[order[0]], COARSE, alike=alike)
        kept = [tuple(likely[:-1].tolist()), *list(dict.fromkeys(best))[:BEAM]]
        found.append((score - _price(likely[:-1], jumps), likely))
    found.sort(key=lambda one: -one[0])
    made = (_improved(courses, own, FINE, alike=alike) for _, own in found[:MADE])
    return [
        (score - price, switching, price)
        for score, own in made
        for switching, price in _as_switching(own, end, alike=alike)
    ]


def _as_switching(own: Array, end: float, *, alike: bool) -> Iterator[tuple[Switching, float]]:
    """What switches at moments with a lag (c + 1,), and its price; not what is something else."""
    *moments, lag = own.tolist()
    if moments[0] < AT_ONCE * end and lag:
        moments[0] = 0.0
    # one switch at the start is the formula of a drift; one alone is alike each time
    if moments != [0.0] and (alike or len(moments) > 1):
        yield Switching(lag, tuple(moments)), _price(np.array(moments), not lag)


def judged(courses: Courses, sets: Array, *, alike: bool) -> Array:
    """Evidence of what switches on and off by the same amount each time, or by any other.

    Parameters
    ----------
    sets : ndarray, shape (m, c + 1), s
        Moments, and the lag with which they are followed.

    Returns
    -------
    ndarray, shape (m,)
    """
    moments = sets[:, :-1]
    each, place = np.unique(moments + 1j * sets[:, -1:], return_inverse=True)
    places = place.reshape(moments.shape)
    values = courses.fitted @ responses(courses.time, each.real, each.imag)
    if not alike:
        return courses.evidence(values, places)
    signs = np.zeros((len(each), len(sets)))
    signs[places, np.arange(len(sets))[:, None]] = (-1.0) ** np.arange(moments.shape[1])
    return courses.evidence_of_each(values @ signs)


def lag_from_start(courses: Courses) -> tuple[float, float]:
    """Evidence of what is on from the start, the formula of a drift, and its likeliest lag, s."""
    lags = float(courses.time[-1]) * np.geomspace(SHORTEST, LONGEST, 60)
    scores = judged(courses, np.stack([np.zeros(len(lags)), lags], axis=1), alike=True)
    best = int(np.argmax(scores))
    return float(scores[best]), float(lags[best])


def swing(courses: Courses) -> tuple[float, float]:
    """Evidence of the likeliest slow wave, and its period, s."""
    end = float(courses.time[-1])

    def worth(turns: Array) -> Array:
        phase = 2.0 * np.pi * courses.time[:, None] / end * turns
        waves = np.concatenate([np.sin(phase), np.cos(phase)], axis=1)
        pairs = np.arange(waves.shape[1]).reshape(2, -1).T
        return courses.evidence(courses.fitted @ waves, pairs)

    turns = np.arange(2.0, MOST_TURNS, TURN)
    best = float(turns[int(np.argmax(worth(turns)))])
    near = best + np.linspace(-TURN, TURN, 41)
    scores = worth(near)
    return float(scores.max()), end / float(near[int(np.argmax(scores))])


def _price(moments: Array, jumps: bool) -> float:
    """Logarithm of the number of choices; a drift that begins with the run has no moment."""
    chosen = int(np.sum(moments > 0.0))
    return chosen * float(np.log(MOMENTS)) + (0.0 if jumps else float(np.log(len(LAGS))))


def _apart(moments: Array, end: float, *, jumps: bool) -> NDArray[np.bool_]:
    """Tell which moments (m, c) are far enough from each other and from the end, shape (m,)."""
    least = end * (JUMPS_APART if jumps else APART)
    apart = np.all(np.diff(moments, axis=1) >= least, axis=1)
    return np.asarray(apart & (moments[:, -1] < end * (1.0 - JUMPS_APART)))


def _with_lag(moments: Array, lag: float) -> Array:
    """Moments (m, c), followed with one lag, as sets for ``judged``."""
    return np.column_stack([moments, np.full(len(moments), lag)])


def _improved(
    courses: Courses, start: Array, halvings: range, *, alike: bool
) -> tuple[float, Array]:
    """Move moments and lag (c + 1,), by steps that are halved, while the evidence rises."""
    end, own = float(courses.time[-1]), start
    best = float(judged(courses, own[None], alike=alike)[0])
    for halving in halvings:
        step, factor = 0.5**halving * end / MOMENTS, 1.3 ** (0.5**halving)
        while len(sets := _near(own, step, factor, end)):
            scores = judged(courses, sets, alike=alike)
            place = int(np.argmax(scores))
            if scores[place] <= best + 1e-3:
                break
            best, own = float(scores[place]), sets[place]
    return best, own


def _near(own: Array, step: float, factor: float, end: float) -> Array:
    """Sets (m, c + 1) that differ from one (c + 1,) in one moment or in the lag."""
    moments, lag = own[:-1], float(own[-1])
    moved = np.maximum(moments + np.kron(np.eye(len(moments)), step * STEPS[:, None]), 0.0)
    moved = moved[(moved != moments).any(axis=1) & _apart(moved, end, jumps=not lag)]
    lags = [by for by in (lag * factor, lag / factor) if SHORTEST * end <= by <= LONGEST * end]
    return np.concatenate([_with_lag(moved, lag), *(_with_lag(moments[None], by) for by in lags)])
