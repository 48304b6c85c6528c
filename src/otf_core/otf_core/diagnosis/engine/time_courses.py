# SPDX-License-Identifier: Apache-2.0
"""Courses in time: decoys, any course and moments of switching.

Shapes outside the catalogue, so that an unknown effect need not be forced into it.

A jump at a moment and a slow wave in time are followed half-way by the smooth drifts of the
catalogue. Where one of them explains the run better than any effect, the gap has no known cause.

Any course in time, by the products of piecewise linear functions of time.

They are tried as effects are, and never named: their products with each other and with the
residual hold those of every course in time, to the width of their nodes. So thousands of courses
are judged without a column of their own.

Drifts of what is switched on and off: moments and lag that make the data most likely.

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
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.aside import share_out
from otf_core.diagnosis.engine.effect_products import ProductsBeside, ShapeProducts, tried_shapes
from otf_core.diagnosis.engine.evidence import SPREADS
from otf_core.diagnosis.engine.residual_rows import Rows, TimeFunctions
from otf_core.effects.action import Acting, rigid_tracker, vector
from otf_core.effects.base import Effect, ShapeParameter
from otf_core.effects.free import declare_switching
from otf_core.effects.free_form import FreeForm
from otf_core.effects.inputs import Switching, responses
from otf_core.effects.terms import Shape, State

MOMENTS = 40
"""Moments of a jump that are tried."""
PERIODS = 24
"""Periods of a slow wave that are tried."""
SHORTEST_PERIOD = 8.0
"""s; shortest period of a slow wave."""


def _moments(state: State) -> Sequence[Shape]:
    """Moments spread over the run."""
    return tuple({'moment': float(t)} for t in np.linspace(0, state.end, MOMENTS + 2)[1:-1])


def _step(state: State, shape: Shape) -> Array:
    """Zero before the moment and one after it."""
    return (state.time > shape['moment']).astype(float)[:, None]


JUMP = TimeFunctions(
    name='jump',
    course=_step,
    heads=('J',),
    shape=(ShapeParameter('moment', 's', width=0.02),),
    shapes=_moments,
    refine='moment',
    switches=(vector,),
)
"""Shift of the target or the tracker at a moment: something slipped or was knocked."""
KNOCK = replace(JUMP, name='knock', switches=(rigid_tracker,))
"""Turn and shift of the tracker, or of what carries it, at a moment."""


def _periods(state: State) -> Sequence[Shape]:
    """Periods evenly spaced in frequency, half a turn of the run apart."""
    slowest = 2.0 / max(state.end, SHORTEST_PERIOD)
    number = np.arange(slowest, 1.0 / SHORTEST_PERIOD, 0.5 / max(state.end, SHORTEST_PERIOD))
    step = max(1, len(number) // (4 * PERIODS))
    return tuple({'period': float(1.0 / f)} for f in number[::step])


def _wave(state: State, shape: Shape) -> Array:
    """Sine and cosine."""
    phase = 2.0 * np.pi * state.time / shape['period']
    return np.stack([np.sin(phase), np.cos(phase)], axis=1)


SLOW_WAVE = TimeFunctions(
    name='slow_wave',
    course=_wave,
    heads=('S', 'C'),
    shape=(ShapeParameter('period', 's', width=0.05),),
    shapes=_periods,
    refine='period',
    switches=(vector,),
)
"""Shift that swings slowly in time: something switches or swings with a period."""

DECOYS: tuple[Effect, ...] = (JUMP, KNOCK, SLOW_WAVE)
DECOY_NAMES = frozenset(d.name for d in DECOYS)


NEXT_TO_NOTHING = 1e-9
"""Share of a square that keeps a matrix positive definite."""
NODES = 64
"""Of the piecewise linear functions."""
FINE_TIMES = 8 * NODES
"""Times at which a course is fitted by them."""


def drivers_of(effect: Effect) -> tuple[Effect, ...]:
    """Effects that may act as a course in time does; none of what is no such course."""
    return effect.drivers if isinstance(effect, TimeFunctions) else ()


def _hats_of_run(state: State, shape: Shape) -> Array:
    """One function for every node."""
    return _hats(state.time, state.end)


def _hats(time: Array, end: float) -> Array:
    """Piecewise linear functions, each one at its node and zero at all others, (n, NODES)."""
    nodes = np.linspace(0.0, end, NODES)
    return np.asarray(np.maximum(1.0 - np.abs(time[:, None] - nodes) / nodes[1], 0.0))


def courses_tried(rows: Rows, effects: Sequence[Effect]) -> dict[str, list[ShapeProducts]]:
    """Piecewise linear functions of time for every way to act in which effects may switch.

    Of one run alone: every run has moments of its own.
    """
    if len(rows.states) > 1 or not rows.states[0].end > 0.0:
        return {}
    ways = dict.fromkeys(acts for e in effects for acts in e.switches)
    courses = {}
    for acts in ways:
        course = TimeFunctions(
            name='course_in_time',
            course=_hats_of_run,
            heads=tuple(f'H{k}' for k in range(NODES)),
            switches=(acts,),
            drivers=tuple(e for e in effects if acts in e.switches),
        )
        (tried,) = tried_shapes(rows, course, [{}])
        courses[f'{course.name} {acts.__name__}'] = [tried.only(())]
    return courses


@dataclass(frozen=True, eq=False)
class Courses:
    """Products of piecewise linear functions of time, by which every course is judged.

    Attributes
    ----------
    time : ndarray, shape (f,), s
        Evenly spaced from the start to the end.
    fitted : ndarray, shape (n, f)
        Values at the nodes that fit a course at these times best.
    normal : ndarray, shape (k, n, k, n)
    right : ndarray, shape (k, n)
    size : ndarray, shape (k,), m
        Displacement by a unit of each term of the way to act.
    """

    time: Array
    fitted: Array
    normal: Array
    right: Array
    size: Array
    variance: float

    @classmethod
    def of(cls, tried: ShapeProducts, end: float, variance: float) -> Courses:
        """Take the products of a course in time."""
        count, time = len(tried.size) // NODES, np.linspace(0.0, end, FINE_TIMES)
        return cls(
            time,
            np.asarray(np.linalg.pinv(_hats(time, end)), np.float64),
            tried.normal.reshape(count, NODES, count, NODES),
            tried.right.reshape(count, NODES),
            tried.size.reshape(count, NODES).max(axis=1),
            variance,
        )

    @property
    def most(self) -> float:
        """Evidence that no course exceeds: half the fall of the sum of squares by all of them."""
        whole = self.normal.reshape(self.right.size, -1)
        whole = whole + np.diag(NEXT_TO_NOTHING * whole.diagonal() + np.finfo(np.float64).tiny)
        right = self.right.reshape(-1)
        return 0.5 * float(right @ np.linalg.solve(whole, right)) / self.variance

    def evidence_of_each(self, values: Array) -> Array:
        """Evidence of courses (n, m) at the nodes, each alone, shape (m,)."""
        first, second = np.triu_indices(len(self.right))
        normal = np.empty((values.shape[1], len(self.right), len(self.right)))
        own = np.sum((self._once @ values) * values, axis=1).T
        normal[:, first, second] = normal[:, second, first] = own
        square = np.sum(values**2, axis=0) / NODES
        return self._evidence(normal, (self.right @ values).T, square[:, None])

    @cached_property
    def _once(self) -> Array:
        """Products of every two terms of the way to act, each once, shape (l, n, n)."""
        first, second = np.triu_indices(len(self.right))
        return np.ascontiguousarray(self.normal[first, :, second])

    def evidence(self, values: Array, sets: Index) -> Array:
        """Evidence of sets of courses, each together.

        Parameters
        ----------
        values : ndarray, shape (n, u)
            Courses at the nodes.
        sets : ndarray of int, shape (m, c)
            Which of them belong together.

        Returns
        -------
        ndarray, shape (m,)
        """
        turned = np.tensordot(values, np.tensordot(self.normal, values, axes=(3, 0)), axes=(0, 1))
        normal = turned.transpose(0, 3, 1, 2)[sets[:, :, None], sets[:, None, :]]
        count = sets.shape[1] * len(self.right)
        whole = np.moveaxis(normal, 3, 2).reshape(-1, count, count)
        right = (self.right @ values).T[sets].reshape(-1, count)
        return self._evidence(whole, right, (np.sum(values**2, axis=0) / NODES)[sets])

    def _evidence(self, normal: Array, right: Array, square: Array) -> Array:
        """Evidence by products (m, c k, c k) and (m, c k); ``square`` (m, c): means over time."""
        scale = 1.0 / np.maximum(np.sqrt(square)[:, :, None] * self.size, 1e-300)
        scale = scale.reshape(right.shape)
        unit = normal * scale[:, :, None] * scale[:, None, :] / self.variance
        spread = np.array(SPREADS)[:, None, None]
        pull = spread * (right * scale / self.variance)
        # with the pull as its last row, a factor holds the half-solved system in its own
        whole = np.zeros((*pull.shape[:2], unit.shape[1] + 1, unit.shape[1] + 1))
        whole[..., :-1, :-1] = spread[..., None] ** 2 * unit + np.eye(unit.shape[1])
        whole[..., -1, :-1], whole[..., -1, -1] = pull, 1.0 + np.sum(pull**2, axis=2)
        factor = np.linalg.cholesky(whole)
        volume = np.log(np.diagonal(factor, axis1=2, axis2=3)[..., :-1]).sum(axis=2)
        evidence = 0.5 * np.sum(factor[..., -1, :-1] ** 2, axis=2) - volume
        return np.asarray(np.logaddexp.reduce(evidence, axis=0) - np.log(len(SPREADS)))


Moments = tuple[float, ...]

MOST_TURNS, TURN = 16.0, 0.2
"""Turns of a slow wave in a run, and the distance of those that are tried first."""
SWITCH_MOMENTS = 40
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
looked at: what has less is neither named nor listed as indistinguishable."""

_Kind = tuple[bool, bool] | None
"""Whether it jumps and is alike each time it is on; None for what no moment is looked for."""
KINDS: tuple[_Kind, ...] = (
    (False, False), (False, True), (True, False), (True, True), None,
)  # fmt: skip


def add_switching(beside: ProductsBeside, variance: float) -> ProductsBeside:
    """The same with drifts and jumps of what switches, and waves, at their likeliest moments."""
    groups = {n: list(g) for n, g in beside.candidates.items()}
    courses = [t for g in groups.values() for t in g if drivers_of(t.effect)]
    if not courses or not _something_in_time(groups, variance):
        return beside
    rows = beside.rows
    best = max(t.odds(k, variance) for g in groups.values() for t in g for k in t.takes)
    least = BEHIND * best - HOPELESS
    ways = [_Way.of(t, groups, rows, variance) for t in courses]
    jobs = [(way, kind) for way in ways if way.courses.most >= least for kind in KINDS]

    def switching(job: tuple[_Way, _Kind]) -> list[ShapeProducts]:
        options = []
        for effect, shape, price in job[0].likely(job[1], rows, least):
            (option,) = tried_shapes(rows, effect, [shape])
            options.append(replace(beside.less(option), price=price))
        return options

    rows.prepare()
    beside.taken  # noqa: B018
    known = (rows, *(e for way in ways for e in way.drivers))
    for option in chain.from_iterable(share_out(switching, jobs, known)):
        groups[option.effect.name].append(option)
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
        cls,
        tried: ShapeProducts,
        groups: Mapping[str, Sequence[ShapeProducts]],
        rows: Rows,
        variance: float,
    ) -> _Way:
        """Take the way of a course in time."""
        assert isinstance(tried.effect, TimeFunctions)
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
            if (e.name in DECOY_NAMES) == jumps and e.name != SLOW_WAVE.name
        ]
        scored = likeliest(self.courses, jumps=jumps, alike=alike) if named else []
        for switching, price in (one[1:] for one in scored if one[0] > least):
            free = declare_switching(self.acts, switching, 1 if alike else len(switching.moments))
            for effect in named:
                yield FreeForm.bound(effect, free, rows.states), {}, price

    def _formulas(self, rows: Rows, least: float) -> Iterator[tuple[Effect, Shape, float]]:
        """Waves at their likeliest period, drifts from the start with their likeliest lag."""
        waves = [e for e in self.drivers if e.name == SLOW_WAVE.name]
        drifts = [e for e in self.drivers if e.name not in DECOY_NAMES]
        score, period = swing(self.courses) if waves else (-np.inf, 0.0)
        for wave in waves if score > least else ():
            yield wave, {'period': period}, float(np.log(MOST_TURNS / TURN))
        score, lag = lag_from_start(self.courses) if drifts else (-np.inf, 0.0)
        for effect in drifts if score > least else ():
            shape = {'tau': lag, 'until': rows.states[0].end, 'order': 1.0}
            yield effect, effect.complete_shape(shape), float(np.log(len(LAGS)))


def _something_in_time(groups: Mapping[str, Sequence[ShapeProducts]], variance: float) -> bool:
    """Return whether any effect that may switch, or a decoy, has the odds to be named."""
    drivers = {e.name for g in groups.values() for t in g for e in drivers_of(t.effect)}
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
    grid = np.linspace(0.0, end, SWITCH_MOMENTS + 1)[int(jumps) : -1].tolist()
    scored: list[tuple[float, Array]] = []
    beam: list[Moments] = [()]
    for _ in range(SWITCHES if alike else UNLIKE):
        moments = np.array(sorted({tuple(sorted((*known, m))) for known in beam for m in grid}))
        moments = moments[_apart(moments, end, jumps=jumps)]
        if not len(moments):
            break
        by_lag = [_with_lag(moments, lag) for lag in lags]
        scores = np.concatenate([judge_switching(courses, sets, alike=alike) for sets in by_lag])
        order, sets = np.argsort(scores)[::-1], np.concatenate(by_lag)
        best = [tuple(sets[k, :-1].tolist()) for k in order[: BEAM * len(lags)]]
        score, likely = _improved(courses, sets[order[0]], COARSE, alike=alike)
        beam = [tuple(likely[:-1].tolist()), *list(dict.fromkeys(best))[:BEAM]]
        scored.append((score - _price(likely[:-1], jumps), likely))
    scored.sort(key=lambda one: -one[0])
    improved = (_improved(courses, own, FINE, alike=alike) for _, own in scored[:MADE])
    return [
        (score - price, switching, price)
        for score, own in improved
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


def judge_switching(courses: Courses, sets: Array, *, alike: bool) -> Array:
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
    scores = judge_switching(courses, np.stack([np.zeros(len(lags)), lags], axis=1), alike=True)
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
    return chosen * float(np.log(SWITCH_MOMENTS)) + (0.0 if jumps else float(np.log(len(LAGS))))


def _apart(moments: Array, end: float, *, jumps: bool) -> NDArray[np.bool_]:
    """Which moments (m, c) are far enough from each other and from the end, shape (m,)."""
    least = end * (JUMPS_APART if jumps else APART)
    apart = np.all(np.diff(moments, axis=1) >= least, axis=1)
    return np.asarray(apart & (moments[:, -1] < end * (1.0 - JUMPS_APART)))


def _with_lag(moments: Array, lag: float) -> Array:
    """Moments (m, c), followed with one lag, as sets for ``judge_switching``."""
    return np.column_stack([moments, np.full(len(moments), lag)])


def _improved(
    courses: Courses, start: Array, halvings: range, *, alike: bool
) -> tuple[float, Array]:
    """Move moments and lag (c + 1,), by steps that are halved, while the evidence rises."""
    end, own = float(courses.time[-1]), start
    best = float(judge_switching(courses, own[None], alike=alike)[0])
    for halving in halvings:
        step, factor = 0.5**halving * end / SWITCH_MOMENTS, 1.3 ** (0.5**halving)
        while len(sets := _near(own, step, factor, end)):
            scores = judge_switching(courses, sets, alike=alike)
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
