# SPDX-License-Identifier: Apache-2.0
"""Score test: what functions of every piece would gain of a residual, without fitting them.

With the scores h of the whitened residual (what a shift of every piece would gain), a function Phi
would gain about g' N^-1 g, g = Phi' h, N the information without tables and poses. So many
functions can be looked at, the best of which are fitted exactly.
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
        found = []
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
            kept = np.flatnonzero(np.arange(3 * count) % count)
            found.append(float(_gains(matrix[np.ix_(kept, kept)][None], right[kept][None])[0]))
        return found

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
        turned, found, every = None, [], self.information.sum(axis=0)
        for part in np.array_split(frequency, max(1, len(frequency) // TOGETHER)):
            if turned is None:
                turned = np.exp(2j * np.pi * time[:, None] * (part - part[0]))
            turn = turned[:, : len(part)] * np.exp(2j * np.pi * part[0] * time)[:, None]
            slow, right = self.slow @ turn, turn.T @ self.pull
            whole = every + (np.abs(slow) ** 2).T @ self.beyond
            twice = np.square(turn, out=turn).T @ self.information + (slow**2).T @ self.beyond
            matrix = _of_pairs(whole + twice.real, twice.imag, whole - twice.real)
            found.append(_gains(0.5 * matrix, np.concatenate([right.real, right.imag], axis=1)))
        return np.concatenate(found)


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
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-300))
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
