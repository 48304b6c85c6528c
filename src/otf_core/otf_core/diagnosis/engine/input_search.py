# SPDX-License-Identifier: Apache-2.0
"""Inputs of a structure: which functions would gain much, and at which period, moment or place.

Score test: what functions of every piece would gain of a residual, without fitting them.

With the scores h of the whitened residual (what a shift of every piece would gain), a function Phi
would gain about g' N^-1 g, g = Phi' h, N the information without tables and poses. So many
functions can be looked at, the best of which are fitted exactly.

Inputs that are sought in a residual: a period, a moment, a place, a direction of the beam.

Trial functions of each are compared by the score test; the best becomes an input if it
is clear. Cycles along axes are lines in the spectra of single samples. What depends on an input is
fitted exactly afterwards, and priced as all structures are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations_with_replacement

import numpy as np
from numpy.polynomial import legendre
from scipy import sparse

from otf_core.arrays import Array, Index
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.spectral import LINE_SCORE, line_across_axis, line_along_axis
from otf_core.effects.inputs import (
    CYCLE,
    DIRECTION,
    MOMENT,
    PLACE,
    TURNS,
    found_name,
    functions_of,
)
from otf_core.solving.whitener import Whitener

RIDGE = 1e-4
"""Of the scaled information, against functions that the data hardly tell apart."""
SLOW = 5
"""Polynomials along a leg whose own weights are known."""
TOGETHER = 64
"""Functions looked at together."""


@dataclass(frozen=True)
class Scores:
    """Scores of shifts of all pieces.

    The noise of a leg is correlated, so what changes from piece to piece along it weighs more
    than what stays: information is that about single pieces, and for what is slow along a leg what
    is beyond.

    Attributes
    ----------
    pull : ndarray, shape (p, 3), 1/m
    information : ndarray, shape (p, 6), 1/m^2
        For every pair of ``DIRECTIONS``.
    slow : sparse array, shape (s, p)
        Polynomials over every leg, sum of squares 1.
    beyond : ndarray, shape (s, 6), 1/m^2
        Information about these, less what it would be by that about single pieces.
    """

    pull: Array
    information: Array
    slow: sparse.csr_array
    beyond: Array

    @classmethod
    def of(cls, rows: Rows) -> Scores:
        """Of the residual of rows."""
        pull = np.concatenate(rows.pulled_residual.turned)[:, :, 0]
        axes = np.concatenate([s.system.axes for s in rows.done.runs], axis=1)
        weights = _weights(rows.whiteners)
        information = _by_directions(axes, weights.pieces)
        beyond = _by_directions(axes[:, weights.middle], weights.beyond)
        return cls(pull, information, weights.slow, beyond)

    def gain(self, functions: Array) -> float:
        """Half the fall of the sum of squares by functions (p, k), each along X, Y and Z."""
        right = (functions.T @ self.pull).T.ravel()
        matrix = _information(functions, self.information) + self._beyond(functions)
        return float(_gains(matrix[None], right[None])[0])

    def _beyond(self, functions: Array) -> Array:
        """Information about functions (p, k) beyond that by single pieces, shape (3 k, 3 k)."""
        return _information(self.slow @ functions, self.beyond)

    def gains_of_products(self, first: Array, others: Sequence[Array]) -> list[float]:
        """The same of products of functions (p, a) of one input with those (p, b) of others.

        The first of each is the constant; the constant of the product is left out. Sums over the
        pieces of products of four functions are those of two products of two.
        """
        pairs = _pairs(first.shape[1])
        weighted = pairs.products(first)[:, :, None] * self.information[:, None, :]
        weighted = weighted.reshape(len(first), -1)
        pulled = (first[:, :, None] * self.pull[:, None, :]).reshape(len(first), -1)
        gains = []
        for other in others:
            own, count = _pairs(other.shape[1]), first.shape[1] * other.shape[1]
            sums = (weighted.T @ own.products(other)).reshape(
                -1, len(DIRECTIONS.once), len(own.once)
            )
            whole = sums[
                pairs.place[:, :, None, None, None, None],
                DIRECTIONS.place[:, :, None, None],
                own.place,
            ]
            matrix = whole.transpose(2, 0, 4, 3, 1, 5).reshape(3 * count, -1)
            both = (first[:, :, None] * other[:, None, :]).reshape(len(first), -1)
            matrix = matrix + self._beyond(both)
            right = (pulled.T @ other).reshape(first.shape[1], 3, -1).transpose(1, 0, 2).ravel()
            inner = np.flatnonzero(np.arange(3 * count) % count)
            gains.append(float(_gains(matrix[np.ix_(inner, inner)][None], right[inner][None])[0]))
        return gains

    def gains_of_each(self, functions: Array) -> Array:
        """The same of each function (p, f) alone, beside a constant that gains nothing."""
        count = functions.shape[1]
        return np.concatenate(
            [
                self._gains_of_each(functions[:, k : k + TOGETHER])
                for k in range(0, count, TOGETHER)
            ]
        )

    def _gains_of_each(self, functions: Array) -> Array:
        (one, first), own = self._constant, self.slow @ functions
        both = functions.T @ self.information + (one[:, None] * own).T @ self.beyond
        matrix = _of_pairs(np.broadcast_to(first, both.shape), both, self._squares(functions, own))
        right = np.zeros((functions.shape[1], 2, 3))
        right[:, 1] = functions.T @ self.pull
        return _gains(matrix, right.reshape(-1, 6))

    @cached_property
    def _constant(self) -> tuple[Array, Array]:
        """The constant in terms of what is slow along a leg, and information about it."""
        one = np.ones((len(self.pull), 1))
        own = self.slow @ one
        return own[:, 0], self._squares(one, own)

    def _squares(self, functions: Array, own: Array) -> Array:
        """Information about functions (p, f), ``own`` what is slow of them, shape (f, 6)."""
        return np.asarray((functions**2).T @ self.information + (own**2).T @ self.beyond)

    def gains_of_waves(self, time: Array, frequency: Array) -> Array:
        """The same of cosine and sine of time (p,) at evenly spaced frequencies (f,), Hz.

        Squares and products of these two are those of z = cosine + i sine: z^2 and |z|^2.
        """
        turned, gains, every = None, [], self.information.sum(axis=0)
        for part in np.array_split(frequency, max(1, len(frequency) // TOGETHER)):
            if turned is None:
                turned = np.exp(2j * np.pi * time[:, None] * (part - part[0]))
            turn = turned[:, : len(part)] * np.exp(2j * np.pi * part[0] * time)[:, None]
            slow, right = self.slow @ turn, turn.T @ self.pull
            whole = every + (np.abs(slow) ** 2).T @ self.beyond
            twice = np.square(turn, out=turn).T @ self.information + (slow**2).T @ self.beyond
            matrix = _of_pairs(whole + twice.real, twice.imag, whole - twice.real)
            gains.append(_gains(0.5 * matrix, np.concatenate([right.real, right.imag], axis=1)))
        return np.concatenate(gains)


def _of_pairs(first: Array, both: Array, second: Array) -> Array:
    """Information about two functions along X, Y and Z, shape (f, 6, 6).

    By the sums (f, 6) of their squares and products for every pair of ``DIRECTIONS``.
    """
    whole = np.array([first, both, both, second])[:, :, DIRECTIONS.place]
    whole = whole.reshape(2, 2, -1, 3, 3)
    return np.asarray(whole.transpose(2, 0, 3, 1, 4).reshape(-1, 6, 6))


def _by_directions(axes: Array, weights: Array) -> Array:
    """Information by weights (c, p) of rows along axes (c, p, 3), shape (p, 6)."""
    pairs = (axes[:, :, i] * axes[:, :, j] * weights for i, j in DIRECTIONS.once)
    return np.stack([own.sum(axis=0) for own in pairs], axis=1)


def _information(functions: Array, known: Array) -> Array:
    """Information about functions (p, k) by that about single pieces (p, 6), (3 k, 3 k)."""
    count = functions.shape[1]
    whole = np.empty((3, count, 3, count))
    for (i, j), weight in zip(DIRECTIONS.once, known.T, strict=True):
        whole[i, :, j] = whole[j, :, i] = functions.T @ (weight[:, None] * functions)
    return whole.reshape(3 * count, -1)


@dataclass(frozen=True)
class _Pairs:
    """Pairs of n functions, each once, and the place (n, n) of every pair among them."""

    once: list[tuple[int, int]]
    place: Index

    def products(self, functions: Array) -> Array:
        """Products of the functions (p, n) of every pair, shape (p, n (n + 1) / 2)."""
        return np.stack([functions[:, i] * functions[:, j] for i, j in self.once], axis=1)


def _pairs(count: int) -> _Pairs:
    once = list(combinations_with_replacement(range(count), 2))
    place = np.zeros((count, count), dtype=np.int64)
    for number, (i, j) in enumerate(once):
        place[i, j] = place[j, i] = number
    return _Pairs(once, place)


DIRECTIONS = _pairs(3)
"""Pairs of X, Y and Z."""


def _gains(matrix: Array, right: Array) -> Array:
    """Gains for information (f, k, k) and scores (f, k)."""
    diagonal = np.diagonal(matrix, axis1=1, axis2=2)
    scale = np.where(diagonal > 1e-300, 1.0 / np.sqrt(np.maximum(diagonal, 1e-300)), 0.0)
    whole = scale[:, :, None] * matrix * scale[:, None, :] + RIDGE * np.eye(right.shape[1])
    scaled = scale * right
    solved = np.linalg.solve(whole, scaled[:, :, None])[:, :, 0]
    return np.asarray(0.5 * np.sum(scaled * solved, axis=1))


@dataclass(frozen=True)
class _Weights:
    """Weights of displacements of the pieces of all runs.

    Attributes
    ----------
    pieces : ndarray, shape (c, p), 1/m^2
        Of what changes from piece to piece.
    slow : sparse array, shape (s, p)
        Polynomials over every leg, sum of squares 1.
    beyond : ndarray, shape (c, s), 1/m^2
        What these weigh beyond that.
    middle : ndarray of int64, shape (s,)
        Piece in the middle of the leg of each.
    """

    pieces: Array
    slow: sparse.csr_array
    beyond: Array
    middle: Index


def _weights(whiteners: Sequence[Whitener]) -> _Weights:
    """Weights of the pieces, and of what is slow along each leg."""
    pieces, slow, beyond, middle = [], [], [], []
    known: dict[int, Array] = {}
    start = 0
    for inverse in chain(*(w.inverses for w in whiteners)):
        size = inverse.shape[-1]
        if size not in known:
            place = np.linspace(-1.0, 1.0, size) if size > 1 else np.zeros(1)
            known[size] = np.linalg.qr(legendre.legvander(place, min(SLOW, size) - 1))[0]
        shapes = known[size]
        own = np.sum((inverse @ shapes) ** 2, axis=1)
        whole = np.sum(inverse**2, axis=(1, 2))
        rest = (whole - own.sum(axis=1)) / (size - SLOW) if size > SLOW else own[:, 0]
        pieces.append(np.repeat(rest[:, None], size, axis=1))
        slow.append(shapes.T)
        beyond.append(own - rest[:, None])
        middle += [start + size // 2] * shapes.shape[1]
        start += size
    return _Weights(
        np.concatenate(pieces, axis=1),
        sparse.csr_array(sparse.block_diag(slow)),
        np.concatenate(beyond, axis=1),
        np.array(middle),
    )


SLOWEST, FASTEST = 1.5, 1.0
"""Cycles in a run, and Hz, between which a cycle in time is looked for; see ``spectral``."""
FINENESS = 4
"""Trial frequencies for every cycle in a run."""
HARMONICS = 6
"""Cosines and sines by which the period is refined."""
CLEAR = 16.0
"""Gain, less the logarithm of the number of trials, from which something is an input."""
NEAR = 100
"""Pieces before and after the best change of legs among which a moment is refined."""
PLACES = 300
"""Places and directions that are tried: those of so many pieces, spread over the path."""
WIDTHS = (0.06, 0.12, 0.25)
"""Widths of bells about them, as shares of the mean range."""
CENTRES = 4
"""Bells that are fitted exactly, none of them within another."""
REFINED = 120
"""Gains by which centre and width are refined."""


def find_inputs(rows: Rows, scores: Scores) -> list[str]:
    """Names of the inputs with numbers that are clear in a residual."""
    names = [strongest_cycle(rows, scores), strongest_moment(rows, scores)]
    names += strongest_places(rows, scores) + strongest_directions(rows, scores)
    return [name for name in names if name] + cycles_along_axes(rows)


def cycles_along_axes(rows: Rows) -> list[str]:
    """Phases of what repeats along an axis, of each axis at most one."""
    peaks: dict[str, tuple[float, float]] = {}
    for residuals in rows.sample_residuals():
        for head, k in TURNS.items():
            axis = residuals.state.machine.axis_names[k]
            for peak in (line_along_axis(residuals, axis), line_across_axis(residuals, axis)):
                if peak is not None and peak[1] > peaks.get(head, (0.0, LINE_SCORE))[1]:
                    peaks[head] = peak
    return [found_name(head, period) for head, (period, _) in peaks.items()]


def strongest_cycle(rows: Rows, scores: Scores) -> str:
    """Phase of the strongest cycle in time; empty if there is no clear one."""
    time = np.concatenate([s.time for s in rows.states])
    length = max(s.end for s in rows.states)
    step = 1.0 / (FINENESS * length)
    frequency = np.arange(SLOWEST / length, FASTEST, step)
    if not len(frequency):
        return ''
    gains = scores.gains_of_waves(time, frequency)
    if not _is_clear(gains):
        return ''
    best = float(frequency[int(np.argmax(gains))])
    near = 1.0 / (best + step * np.linspace(-1.0, 1.0, 8 * FINENESS + 1))
    harmonics = [scores.gain(_harmonics(time, float(period))) for period in near]
    return found_name(CYCLE, float(near[int(np.argmax(harmonics))]))


def _harmonics(time: Array, period: float) -> Array:
    name = found_name(CYCLE, period)
    return functions_of(name, 2.0 * np.mod(time, period) / period - 1.0, HARMONICS)[:, 1:]


def strongest_moment(rows: Rows, scores: Scores) -> str:
    """Moment of the strongest step in time of one run; empty if there is no clear one."""
    time = np.concatenate([s.time for s in rows.states])
    run = np.repeat(np.arange(len(rows.states)), [len(s) for s in rows.states])
    leg = np.concatenate([r.pieces.leg for r in rows.observed])
    change = np.flatnonzero(np.diff(leg) * (np.diff(run) == 0)) + 1

    def gains(pieces: Index) -> Array:
        """Of steps before some pieces."""
        later = (time[:, None] >= time[pieces]) & (run[:, None] == run[pieces])
        return scores.gains_of_each(later.astype(float))

    if not len(change):
        return ''
    gain = gains(change)
    if not _is_clear(gain):
        return ''
    best = change[int(np.argmax(gain))]
    near = np.flatnonzero((np.abs(leg - leg[best]) <= 1) & (run == run[best]))
    near = near[time[near] > time[run == run[best]].min()]
    near = near[np.abs(near - best) < NEAR]
    piece = int(near[np.argmax(gains(near))])
    return found_name(MOMENT, 0.5 * (time[piece] + time[piece - 1]))


def strongest_places(rows: Rows, scores: Scores) -> list[str]:
    """Places in the volume about which something happens; none if no one is clear."""
    places = _strongest_bells(scores, np.concatenate([s.point for s in rows.states]))
    return [found_name(PLACE, *place) for place in places]


def strongest_directions(rows: Rows, scores: Scores) -> list[str]:
    """Directions of the beam about which something happens; none if no one is clear."""
    beam = np.concatenate([s.beam for s in rows.states])
    places = _strongest_bells(scores, beam / np.linalg.norm(beam, axis=1)[:, None])
    return [
        found_name(DIRECTION, np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))
        for x, y, z in places
    ]


def _strongest_bells(scores: Scores, points: Array) -> list[Array]:
    """Centres of bells exp(-d^2 / 2 w^2) over points (p, 3) that gain most, where one is clear.

    Tables follow a part of a bell, the more the less of it the path meets: the gain of the right
    one need not be the largest.
    """
    from scipy.spatial.distance import cdist  # 0.1 s

    extent = float(np.mean(np.ptp(points, axis=0)))
    stride = max(1, len(points) // PLACES)
    trials = [(p, w * extent) for p in points[stride // 2 :: stride] for w in WIDTHS]

    def bells(some: list[tuple[Array, float]]) -> Array:
        places, widths = (np.array(part) for part in zip(*some, strict=True))
        return np.asarray(np.exp(-0.5 * cdist(points, places, 'sqeuclidean') / widths**2))

    parts = (trials[k : k + TOGETHER] for k in range(0, len(trials), TOGETHER))
    gains = np.concatenate([scores.gains_of_each(bells(part)) for part in parts])
    if not _is_clear(gains):
        return []
    from scipy.optimize import minimize  # 0.1 s

    def refined(place: Array, width: float) -> Array:
        def loss(moved: Array) -> float:
            own = place + width * moved[:3], width * float(np.exp(moved[3]))
            return -float(scores.gains_of_each(bells([own]))[0])

        best = minimize(loss, np.zeros(4), method='Nelder-Mead', options={'maxfev': REFINED})
        return np.asarray(place + width * best.x[:3])

    strongest: list[tuple[Array, float]] = []
    for place, width in (trials[k] for k in np.argsort(gains)[::-1]):
        if all(np.linalg.norm(place - p) > max(width, w) for p, w in strongest):
            strongest.append((place, width))
        if len(strongest) == CENTRES:
            break
    return [refined(*one) for one in strongest]


def _is_clear(gains: Array) -> bool:
    return bool(gains.max() - np.log(len(gains)) >= CLEAR)
