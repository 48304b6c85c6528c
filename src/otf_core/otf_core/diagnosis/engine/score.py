# SPDX-License-Identifier: Apache-2.0
"""Score test: what functions of every piece would gain of a residual, without fitting them.

With the scores h of the whitened residual (what a shift of every piece would gain), a function Phi
would gain about g' N^-1 g, g = Phi' h, N the information without tables and poses. So many
functions can be looked at, the best of which are fitted exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.engine.rows import Rows
from otf_core.effects.inputs import CYCLE, functions_of
from otf_core.solving.whitener import Whitener

Array = NDArray[np.float64]
Index = NDArray[np.int64]

RIDGE = 1e-4
"""Of the scaled information, against functions that the data hardly tell apart."""
SLOWEST, FASTEST = 1.5, 1.0
"""Cycles in a run, and Hz, between which a cycle in time is looked for; see ``spectral``."""
FINENESS = 4
"""Trial frequencies for every cycle in a run."""
HARMONICS = 6
"""Cosines and sines by which the period is refined."""
TOGETHER = 64
"""Frequencies looked at together."""
CLEAR = 16.0
"""Gain, less the logarithm of the number of frequencies, from which a cycle is an input."""


@dataclass(frozen=True)
class Scores:
    """Scores of shifts of all pieces.

    Attributes
    ----------
    pull : ndarray, shape (p, 3), 1/m
    information : ndarray, shape (3, 3, p), 1/m^2
    """

    pull: Array
    information: Array

    @classmethod
    def of(cls, rows: Rows) -> Scores:
        """Of the residual of rows."""
        pull = np.concatenate(rows.pulled_residual.turned)[:, :, 0]
        axes = [s.system.axes for s in rows.done.runs]
        weights = np.concatenate([_weights(w) for w in rows.whiteners], axis=1)
        whole = np.concatenate(axes, axis=1)
        return cls(pull, np.einsum('cpi,cpj,cp->ijp', whole, whole, weights))

    def gain(self, functions: Array) -> float:
        """Half the fall of the sum of squares by functions (p, k), each along X, Y and Z."""
        right = (functions.T @ self.pull).T.ravel()
        weights = self.information
        parts = {
            (i, j): functions.T @ (weights[i, j][:, None] * functions)
            for i in range(3)
            for j in range(i, 3)
        }
        matrix = np.block([[parts[min(i, j), max(i, j)] for j in range(3)] for i in range(3)])
        return float(_gains(matrix[None], right[None])[0])

    def gains_of_products(self, first: Array, others: Sequence[Array]) -> list[float]:
        """The same of products of functions (p, a) of one input with those (p, b) of others.

        The first of each is the constant; the constant of the product is left out. Sums over the
        pieces of products of four functions are those of two products of two.
        """
        pairs, directions = _pairs(first.shape[1]), _pairs(3)
        weights = np.stack([self.information[i, j] for i, j in directions.once], axis=1)
        weighted = (pairs.products(first)[:, :, None] * weights[:, None, :]).reshape(
            len(first), -1
        )
        pulled = (first[:, :, None] * self.pull[:, None, :]).reshape(len(first), -1)
        found = []
        for other in others:
            own, count = _pairs(other.shape[1]), first.shape[1] * other.shape[1]
            sums = (weighted.T @ own.products(other)).reshape(
                -1, len(directions.once), len(own.once)
            )
            whole = sums[
                pairs.place[:, :, None, None, None, None],
                directions.place[:, :, None, None],
                own.place,
            ]
            matrix = whole.transpose(2, 0, 4, 3, 1, 5).reshape(3 * count, -1)
            right = (pulled.T @ other).reshape(first.shape[1], 3, -1).transpose(1, 0, 2).ravel()
            kept = np.flatnonzero(np.arange(3 * count) % count)
            found.append(float(_gains(matrix[np.ix_(kept, kept)][None], right[kept][None])[0]))
        return found

    def gains_of_waves(self, time: Array, frequency: Array) -> Array:
        """The same of cosine and sine of time (p,) at evenly spaced frequencies (f,), Hz."""
        flat, turned = self.information.reshape(9, -1).T, None
        found = []
        for part in np.array_split(frequency, max(1, len(frequency) // TOGETHER)):
            if turned is None:
                turned = np.exp(2j * np.pi * (part - part[0])[:, None] * time)
            turn = turned[: len(part)] * np.exp(2j * np.pi * part[0] * time)
            waves = np.stack([turn.real, turn.imag])
            right = (waves @ self.pull).transpose(1, 2, 0).reshape(len(part), 6)
            both = waves[0] * waves[1] @ flat
            squares = waves[0] ** 2 @ flat
            products = [[squares, both], [both, flat.sum(axis=0) - squares]]
            matrix = np.array(products).reshape(2, 2, -1, 3, 3).transpose(2, 3, 0, 4, 1)
            matrix = matrix.reshape(-1, 6, 6)
            found.append(_gains(matrix, right))
        return np.concatenate(found)


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


def _gains(matrix: Array, right: Array) -> Array:
    """Gains for information (f, k, k) and scores (f, k)."""
    diagonal = np.diagonal(matrix, axis1=1, axis2=2)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-300))
    whole = scale[:, :, None] * matrix * scale[:, None, :] + RIDGE * np.eye(right.shape[1])
    scaled = scale * right
    solved = np.linalg.solve(whole, scaled[:, :, None])[:, :, 0]
    return np.asarray(0.5 * np.sum(scaled * solved, axis=1))


def _weights(whitener: Whitener) -> Array:
    """Weight of a slow displacement of every piece, shape (c, p), 1/m^2."""
    bounds, inverses = whitener.bounds, whitener.inverses
    found = np.empty((len(inverses[0]), bounds[-1][1]))
    for (low, high), leg in zip(bounds, inverses, strict=True):
        for component, inverse in enumerate(leg):
            found[component, low:high] = np.sum(inverse.sum(axis=1) ** 2) / (high - low)
    return found


def strongest_cycle(rows: Rows, scores: Scores) -> float | None:
    """Period in s of the strongest cycle in time; None if there is no clear one."""
    time = np.concatenate([s.time for s in rows.states])
    length = max(s.end for s in rows.states)
    step = 1.0 / (FINENESS * length)
    frequency = np.arange(SLOWEST / length, FASTEST, step)
    if not len(frequency):
        return None
    gains = scores.gains_of_waves(time, frequency)
    if gains.max() - np.log(len(frequency)) < CLEAR:
        return None
    best = float(frequency[int(np.argmax(gains))])
    near = 1.0 / (best + step * np.linspace(-1.0, 1.0, 8 * FINENESS + 1))
    harmonics = [scores.gain(_harmonics(time, float(period))) for period in near]
    return float(near[int(np.argmax(harmonics))])


def _harmonics(time: Array, period: float) -> Array:
    name = f'{CYCLE}{period!r}'
    return functions_of(name, 2.0 * np.mod(time, period) / period - 1.0, HARMONICS)[:, 1:]
