# SPDX-License-Identifier: Apache-2.0
"""What a run shows an observer who knows the truth: its lines, its path pieces, its noise.

Across the path, the noise of a sample has the covariance G = P (u_range^2 b b' + u_angle^2 r^2
(1 - b b')) P', with b the beam, r its length and P two unit vectors across; from sample to sample
of one straight line it is correlated as the simulated tracker makes it, white and Gauss-Markov.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular, toeplitz

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig, SimulationConfig
from otf_core.effects import State


@dataclass(frozen=True)
class Sight:
    """The moving samples of one run, straight line by straight line, piece by piece.

    Attributes
    ----------
    state : State
        Of all samples of the run.
    config : SimulationConfig
        Rate and colour of the noise.
    use : ndarray of int64, shape (u,)
        Samples that lie in pieces.
    line, piece : ndarray of int64, shape (u,)
        Which straight line and which piece each of them belongs to, both ascending.
    """

    state: State
    config: SimulationConfig
    use: Index
    line: Index
    piece: Index

    def mean(self, values: Array) -> Array:
        """Means over the pieces of values (u, k), shape (p, k)."""
        sums = np.stack([np.bincount(self.piece, v) for v in values.T], axis=1)
        return np.asarray(sums / np.bincount(self.piece)[:, None])

    def seen(self, moved: Array) -> Array:
        """Part of a displacement of all samples (n, 3) that lies across the path, (u, 2), m."""
        return np.asarray(np.einsum('uij,uj->ui', self.across, moved[self.use]))

    @cached_property
    def first(self) -> Index:
        """First sample of every piece, as a place in ``use``, shape (p,)."""
        return np.asarray(np.unique(self.piece, return_index=True)[1])

    @cached_property
    def across(self) -> Array:
        """Two unit vectors across the path for every sample, shape (u, 2, 3)."""
        d = self.state.direction[self.use]
        aside = np.cross(d, np.eye(3)[np.argmin(np.abs(d), axis=1)])
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        return np.stack([aside, np.cross(d, aside)], axis=1)

    @cached_property
    def spread(self) -> Array:
        """Lower Cholesky factor of G, shape (u, 2, 2), m."""
        r, spec = self.state.beam[self.use], self.state.machine.tracker
        square = np.einsum('ui,ui->u', r, r)[:, None, None]
        outer = np.einsum('ui,uj->uij', r, r)
        noise = spec.u_range**2 * outer / square + spec.u_angle**2 * (square * np.eye(3) - outer)
        return np.linalg.cholesky(self.across @ noise @ self.across.transpose(0, 2, 1))

    @cached_property
    def colour(self) -> Array:
        """Lower Cholesky factor of the correlation of samples in a row on the longest line."""
        lag = np.arange(np.bincount(self.line).max()) / self.config.rate
        slow = self.config.correlated_share * np.exp(-lag / self.config.correlation_time)
        slow[0] = 1.0
        return np.linalg.cholesky(toeplitz(slow))

    def white_samples(self, values: Array) -> Array:
        """Values across the path (u, 2) of single samples, freed of their noise."""
        plain = np.linalg.solve(self.spread, values[:, :, None])[:, :, 0]
        for rows in stretches(self.line):
            n = rows.stop - rows.start
            plain[rows] = solve_triangular(self.colour[:n, :n], plain[rows], lower=True)
        return np.asarray(plain)

    @cached_property
    def piece_colour(self) -> list[tuple[slice, Array]]:
        """Pieces of every line, lower Cholesky factor of the correlation of their means."""
        found = []
        lines = stretches(self.line), stretches(self.line[self.first])
        for samples, rows in zip(*lines, strict=True):
            number = self.piece[samples] - rows.start
            share = (number == np.arange(rows.stop - rows.start)[:, None]).astype(float)
            share /= share.sum(axis=1, keepdims=True)
            half = share @ self.colour[: len(number), : len(number)]
            found.append((rows, np.linalg.cholesky(half @ half.T)))
        return found

    def white_pieces(self, values: Array) -> Array:
        """Values across the path (p, 2, k) of piece means, freed of their noise."""
        plain = np.linalg.solve(self.spread[self.first], values)
        for rows, factor in self.piece_colour:
            flat = plain[rows].reshape(len(factor), -1)
            plain[rows] = solve_triangular(factor, flat, lower=True).reshape(plain[rows].shape)
        return np.asarray(plain)


def stretches(line: Index) -> list[slice]:
    """Slices of equal numbers in a row."""
    cuts = [0, *(np.flatnonzero(np.diff(line)) + 1), len(line)]
    return [slice(int(a), int(b)) for a, b in pairwise(cuts)]


def see(state: State, config: SimulationConfig) -> Sight:
    """Cut a run into pieces as long as those of a calibration, without corners and standstill."""
    wanted = CalibrationConfig()
    end = np.minimum(state.from_corner, state.to_corner)
    use = np.flatnonzero((end > wanted.corner_exclusion) & (state.speed > wanted.standstill_speed))
    turned = np.any(np.diff(state.direction, axis=0, prepend=state.direction[:1]) != 0, axis=1)
    line = np.cumsum(turned)[use]
    length = (state.from_corner + state.to_corner)[use]
    parts = np.ceil(length / wanted.piece_length - 1e-9)
    number = np.floor(state.from_corner[use] / length * parts)
    fresh = (np.diff(line, prepend=-1) != 0) | (np.diff(number, prepend=-1.0) != 0)
    line = np.unique(line, return_inverse=True)[1]
    return Sight(state, config, use, line, np.cumsum(fresh) - 1)
