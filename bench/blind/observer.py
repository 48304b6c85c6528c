# SPDX-License-Identifier: Apache-2.0
"""How large a hidden effect is, and how well it can be seen: dense least squares by an observer.

Who knows where every sample was taken, and what the noise is, sees per piece of the track, across

    y = J x + e,    x ~ N(0, s^2),    e ~ N(0, V)

it, with J the differences of the exact chain by all motions (linear between the nodes of
machine.yaml), squareness and location errors, the poses of the tracker and the places of
reflectors on the table, s = ``WIDE``, V the covariance of the means of the noise over the pieces.
What x leaves of a displacement is its size (root mean square per piece); its whitened length is
the number of standard deviations at which it is seen. Nothing that a calibration or a diagnosis
computes enters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from blind.nature import SIX, Array, Errors, Motion, Moves, Run
from scipy.linalg import solve_triangular

PIECE, MOST_PIECES = 8e-3, 8000
"""m; length of a piece of the track; longer ones where there were more of them."""
CORNER, SLOW = 8e-3, 2e-3
"""m and m/s; what is nearer to a stop, or slower, is not looked at."""
STEP, WIDE = 1e-6, 1e-3
"""m and rad; for differences, and the prior spread of all unknowns."""


@dataclass(frozen=True)
class Pieces:
    """Pieces of the track of one part; its samples (u,) in order, with the piece of each (u,)."""

    run: Run
    part: int
    sample: Array
    piece: Array
    stretch: Array

    @classmethod
    def of(cls, run: Run, part: int, length: float) -> Pieces:
        """Cut the track between two stops into pieces of about a length, m."""
        track, program = run.plain[part], run.programs[part]
        stretch = program.way(run.clocks[part])[2]
        step = np.linalg.norm(np.diff(track, axis=0, prepend=track[:1]), axis=1)
        way, numbers, used = np.cumsum(step), np.zeros(len(step)), np.zeros(len(step), bool)
        cuts = np.append(np.flatnonzero(np.diff(stretch, prepend=-1)), len(way))
        for first, last in pairwise(cuts):
            own = way[first:last] - way[first]
            count = max(1, round(own[-1] / length))
            numbers[first:last] = np.floor(own / max(own[-1], 1e-9) * count).clip(0, count - 1)
            used[first:last] = (own > CORNER) & (own < own[-1] - CORNER)
        sample = np.flatnonzero(used & (step * run.rate > SLOW))
        fresh = np.diff(stretch[sample], prepend=-1) != 0
        fresh |= np.diff(numbers[sample], prepend=-1.0) != 0
        piece = np.cumsum(fresh) - 1
        first = np.unique(piece, return_index=True)[1]
        return cls(run, part, sample, piece, stretch[sample][first])

    @property
    def count(self) -> Array:
        """Samples of the pieces."""
        return np.bincount(self.piece)

    @property
    def middle(self) -> Array:
        """Sample in the middle of every piece."""
        return self.sample[np.cumsum(self.count) - 1 - self.count // 2]

    def across(self) -> Array:
        """Unit vectors across the track, shape (p, 2, 3)."""
        along = np.gradient(self.run.plain[self.part], axis=0)[self.middle]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        return np.stack([aside, np.cross(along, aside)], axis=1)

    def spread(self, across: Array) -> Array:
        """Lower Cholesky factors (p, 2, 2) of the noise of a sample across the track, m."""
        spec = self.run.machine.spec['tracker']
        r = self.run.plain[self.part][self.middle] - self.run.tracker
        square = np.sum(r**2, axis=1)[:, None, None]
        outer = r[:, :, None] * r[:, None, :]
        cover = spec['u_range'] ** 2 * outer / square
        cover = cover + spec['u_angle'] ** 2 * (square * np.eye(3) - outer)
        return np.linalg.cholesky(across @ cover @ across.transpose(0, 2, 1))

    def colour(self) -> list[tuple[slice, Array]]:
        """Lower Cholesky factors of the correlation of the means, stretch by stretch."""
        noise, rate, count = self.run.noise, self.run.rate, self.count
        time, half = self.middle / rate, 0.5 * count / rate / noise.time
        spread = np.sinh(half) / half
        same = 2.0 * (2.0 * half - 1.0 + np.exp(-2.0 * half)) / (2.0 * half) ** 2
        factors = []
        cuts = np.append(np.flatnonzero(np.diff(self.stretch, prepend=-1)), len(count))
        for rows in (slice(*pair) for pair in pairwise(cuts.tolist())):
            whole = np.exp(-np.abs(time[rows, None] - time[None, rows]) / noise.time)
            whole *= spread[rows, None] * spread[None, rows]
            np.fill_diagonal(whole, same[rows])
            whole *= noise.share
            whole[np.diag_indices_from(whole)] += (1.0 - noise.share) / count[rows]
            factors.append((rows, np.linalg.cholesky(whole)))
        return factors


class Observer:
    """All runs of a cell, seen by one who knows everything but what is hidden."""

    def __init__(self, runs: Sequence[Run]) -> None:
        self.runs = runs
        way = sum(float(np.linalg.norm(np.diff(t, axis=0), axis=1).sum()) for r in runs
                  for t in r.plain)  # fmt: skip
        length = max(PIECE, way / MOST_PIECES)
        self.pieces = [Pieces.of(r, k, length) for r in runs for k in range(len(r.parts))]
        self.across = [p.across() for p in self.pieces]
        self.spreads = [p.spread(a) for p, a in zip(self.pieces, self.across, strict=True)]
        self.colours = [p.colour() for p in self.pieces]
        designs = [self._design(k) for k in range(len(self.pieces))]
        white = np.concatenate([self._whitened(k, d) for k, d in enumerate(designs)])
        prior = np.eye(white.shape[1]) / WIDE
        orthogonal, self.triangular = np.linalg.qr(np.concatenate([white, prior]))
        self.orthogonal = orthogonal[: len(white)]
        self.columns = np.concatenate([d.reshape(-1, d.shape[2]) for d in designs])

    def _whitened(self, k: int, values: Array) -> Array:
        """Values (p, 2, m) freed of the noise, as rows (2p, m)."""
        plain = np.linalg.solve(self.spreads[k], values)
        for rows, factor in self.colours[k]:
            flat = plain[rows].reshape(len(factor), -1)
            plain[rows] = solve_triangular(factor, flat, lower=True).reshape(plain[rows].shape)
        return plain.reshape(-1, values.shape[2])

    def _design(self, k: int) -> Array:
        """Derivatives across the track by all unknowns, shape (p, 2, m)."""
        own, across = self.pieces[k], self.across[k]
        run, part = own.run, own.run.parts[own.part]
        machine, known, middle = run.machine, run.errors, own.middle
        place, blocks = run.places[part.target], []
        short = _at(run, own.part, middle)

        def seen(errors: Errors, place: Array = place) -> Array:
            return np.einsum('pij,pj->pi', across, (short(errors, place) - start) / STEP)

        start = short(known, place)
        q = run.programs[own.part](run.clocks[own.part][middle])
        for axis in machine.letters:
            nodes, column = machine.nodes(axis), q[:, machine.column(axis)]
            hats = np.stack(
                [np.interp(column, nodes, unit) for unit in np.eye(len(nodes))], axis=1
            )
            for name in (f'E{letter}{axis}' for letter in SIX):
                raised = {**known.motions, name: _raised(known.motions[name])}
                blocks.append(seen(Errors(raised, known.constants))[:, :, None] * hats[:, None, :])
        for name in machine.constants:
            raised = {**known.constants, name: known.constants[name] + STEP}
            blocks.append(seen(Errors(known.motions, raised))[:, :, None])
        beam = run.plain[own.part][middle] - run.tracker
        turns = np.stack([np.cross(unit, beam) for unit in np.eye(3)], axis=2)
        pose = np.concatenate([across, across @ turns], axis=2)
        blocks += [pose if run is r else np.zeros_like(pose) for r in self.runs]
        for name in run.places:
            if machine.spec.get('targets', {}).get(name, {}).get('u'):
                shifts = [seen(known, place + STEP * e) for e in np.eye(3)]
                blocks.append(np.stack(shifts, axis=2) * (name == part.target))
        return np.concatenate(blocks, axis=2)

    def left(self, moved: Sequence[Array]) -> tuple[float, float]:
        """What tables and poses leave of displacements (n, 3) of all parts of all runs.

        Returns
        -------
        size : float, m
            Root mean square per piece, across the track.
        snr : float
            Its length, freed of the noise.
        """
        means = [self._means(k, m) for k, m in enumerate(moved)]
        white = np.concatenate([self._whitened(k, m[:, :, None])[:, 0]
                                for k, m in enumerate(means)])  # fmt: skip
        part = self.orthogonal.T @ white
        followed = self.columns @ solve_triangular(self.triangular, part)
        rest = np.concatenate([m.ravel() for m in means]) - followed
        snr = np.sqrt(max(float(white @ white - part @ part), 0.0))
        return float(np.sqrt(2.0 * np.mean(rest**2))), float(snr)

    def _means(self, k: int, moved: Array) -> Array:
        """Means over the pieces of a displacement, across the track, shape (p, 2), m."""
        own = self.pieces[k]
        sums = np.stack([np.bincount(own.piece, v) for v in moved[own.sample].T], axis=1)
        return np.einsum('pij,pj->pi', self.across[k], sums / own.count[:, None])

    def displaced(self, moves: Sequence[Moves]) -> list[Array]:
        """By what hidden moves displace the reflector, (n, 3), m, of all parts of all runs."""
        return [
            m['shift'] if set(m) == {'shift'} else p.run.seen(p.part, m) - p.run.plain[p.part]
            for p, m in zip(self.pieces, moves, strict=True)
        ]


def _raised(motion: Motion) -> Motion:
    """A motion larger by ``STEP`` everywhere."""
    return lambda q: motion(q) + STEP


def _at(run: Run, part: int, samples: Array):
    """Function of errors and place of the reflector: where it is seen at some samples."""
    machine, name = run.machine, run.parts[part].target
    q, link = run.programs[part](run.clocks[part][samples]), machine.target(name)[0]

    def seen(errors: Errors, place: Array) -> Array:
        r, p = machine.link(q, errors, machine.tracker_link, link)
        return r @ place + p

    return seen
