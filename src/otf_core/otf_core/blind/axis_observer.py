# SPDX-License-Identifier: Apache-2.0
"""What no tables, poses and places of a machine with rotary axes can follow.

As ``observer``, for the chain of ``axis_nature``: per piece of the track, across it,

    y = J x + e,    x ~ N(0, s^2),    e ~ N(0, V)

with J the differences of the exact chain by all motions (linear between the nodes of
machine.yaml), location and squareness errors, the pose of the tracker and the places of the
reflectors on the table; V the covariance of the means of the noise over the pieces, with
g(t) = share exp(-|t| / T) for its correlated part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from otf_core.arrays import Array, Index
from otf_core.blind.axis_nature import LOCATION, ROTARY, SIX, SQUARE, Errors, Fault, Motion
from otf_core.blind.axis_run import RATE, AxisCell
from otf_core.threads import limit_to_one_thread

PIECE = 0.25
"""s; duration of a piece."""
SLOW = 2e-3
"""m/s; where the reflector is slower, its track is not looked at."""
STEP, WIDE = 1e-6, 1e-3
"""m and rad; for differences, and the prior spread of all unknowns."""


@dataclass(frozen=True)
class _Pieces:
    """Pieces of the track of one part.

    Attributes
    ----------
    sample : ndarray of int64, shape (u,)
        Samples that are used, and in which piece each is, ascending.
    middle : ndarray of int64, shape (p,)
        Sample in the middle of every piece.
    stretch : ndarray of int64, shape (p,)
        Motion without a stop that it belongs to.
    across : ndarray, shape (p, 2, 3)
        Unit vectors across the track.
    """

    sample: Index
    piece: Index
    middle: Index
    stretch: Index
    across: Array

    def means(self, values: Array) -> Array:
        """Means over the pieces of vectors (n, 3), across the track, shape (p, 2)."""
        count = np.bincount(self.piece)
        own = np.stack([np.bincount(self.piece, v) for v in values[self.sample].T], axis=1)
        return np.asarray(np.einsum('pij,pj->pi', self.across, own / count[:, None]))


def _cut(track: Array) -> _Pieces:
    """Cut the track (n, 3) of a reflector into pieces of ``PIECE``."""
    velocity = np.gradient(track, axis=0) * RATE
    speed = np.linalg.norm(velocity, axis=1)
    moving = np.flatnonzero(speed > SLOW)
    stretch = np.cumsum(np.diff(moving, prepend=moving[0] - 1) > 1).astype(np.int64)
    first = np.flatnonzero(np.diff(stretch, prepend=-1))
    within = moving - moving[first][stretch]
    number = within // round(PIECE * RATE)
    fresh = (np.diff(stretch, prepend=-1) != 0) | (np.diff(number, prepend=-1) != 0)
    piece = np.cumsum(fresh) - 1
    count = np.bincount(piece)
    middle = moving[np.cumsum(count) - 1 - count // 2]
    along = velocity[middle] / speed[middle, None]
    aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    across = np.stack([aside, np.cross(along, aside)], axis=1)
    return _Pieces(moving, piece, middle, stretch[np.cumsum(count) - 1], across)


def _colour(pieces: _Pieces, cell: AxisCell) -> list[tuple[slice, Array]]:
    """Lower Cholesky factors of the correlation of the means of pieces, stretch by stretch."""
    time = pieces.middle / RATE
    count = np.bincount(pieces.piece)
    half = 0.5 * count / RATE / cell.time
    spread = np.sinh(half) / half
    same = 2.0 * (2.0 * half - 1.0 + np.exp(-2.0 * half)) / (2.0 * half) ** 2
    factors = []
    cuts = np.append(np.flatnonzero(np.diff(pieces.stretch, prepend=-1)), len(pieces.stretch))
    for start, stop in pairwise(cuts):
        rows = slice(int(start), int(stop))
        apart = np.abs(time[rows, None] - time[None, rows]) / cell.time
        whole = np.exp(-apart) * spread[rows, None] * spread[None, rows]
        np.fill_diagonal(whole, same[rows])
        whole *= cell.share
        whole[np.diag_indices_from(whole)] += (1.0 - cell.share) / count[rows]
        factors.append((rows, np.linalg.cholesky(whole)))
    return factors


def _spread(cell: AxisCell, position: Array, across: Array) -> Array:
    """Lower Cholesky factors (p, 2, 2) of the noise of a sample across the track, m."""
    spec, r = cell.machine.spec['tracker'], position - cell.tracker
    square = np.sum(r**2, axis=1)[:, None, None]
    outer = r[:, :, None] * r[:, None, :]
    cover = spec['u_range'] ** 2 * outer / square
    cover = cover + spec['u_angle'] ** 2 * (square * np.eye(3) - outer)
    return np.linalg.cholesky(across @ cover @ across.transpose(0, 2, 1))


@dataclass(frozen=True)
class AxisObserver:
    """All parts of a cell, seen by one who knows everything but the faults.

    Attributes
    ----------
    plain : tuple of ndarray, shape (n, 3), m
        Positions without faults, part by part.
    """

    cell: AxisCell
    plain: tuple[Array, ...]
    pieces: tuple[_Pieces, ...]
    spreads: tuple[Array, ...]
    colours: tuple[list[tuple[slice, Array]], ...]
    columns: Array
    orthogonal: Array
    triangular: Array

    @classmethod
    @limit_to_one_thread
    def of(cls, cell: AxisCell) -> AxisObserver:
        """Set up the least squares of a cell."""
        plain = tuple(_positions(cell, cell.errors))
        pieces = tuple(_cut(track) for track in plain)
        spreads = tuple(
            _spread(cell, track[own.middle], own.across)
            for track, own in zip(plain, pieces, strict=True)
        )
        colours = tuple(_colour(own, cell) for own in pieces)
        designs = [_design(cell, k, own, plain[k]) for k, own in enumerate(pieces)]
        white = [_whitened(*one) for one in zip(designs, spreads, colours, strict=True)]
        columns = np.concatenate([d.reshape(-1, d.shape[2]) for d in designs])
        rows = np.concatenate([w.reshape(-1, w.shape[2]) for w in white])
        prior = np.eye(columns.shape[1]) / WIDE
        orthogonal, triangular = np.linalg.qr(np.concatenate([rows, prior]))
        return cls(
            cell, plain, pieces, spreads, colours, columns, orthogonal[: len(rows)], triangular
        )

    def displaced(self, faults: Sequence[Fault]) -> list[Array]:
        """By what faults move the reflector, part by part, (n, 3), m."""
        wrong = _positions(self.cell, self.cell.errors, faults)
        return [a - b for a, b in zip(wrong, self.plain, strict=True)]

    @limit_to_one_thread
    def left(self, moves: Sequence[Array]) -> tuple[float, float]:
        """Root mean square per piece, m, of what is left, and its length freed of the noise."""
        means = [own.means(m) for own, m in zip(self.pieces, moves, strict=True)]
        white = np.concatenate([
            _whitened(m[:, :, None], s, c).ravel()
            for m, s, c in zip(means, self.spreads, self.colours, strict=True)
        ])  # fmt: skip
        part = self.orthogonal.T @ white
        followed = self.columns @ solve_triangular(self.triangular, part)
        rest = np.concatenate([m.ravel() for m in means]) - followed
        snr = np.sqrt(max(float(white @ white - part @ part), 0.0))
        return float(np.sqrt(2.0 * np.mean(rest**2))), float(snr)


def _positions(cell: AxisCell, errors: Errors, faults: Sequence[Fault] = ()) -> list[Array]:
    return [
        cell.machine.seen(part, errors, cell.places, cell.tracker, faults) for part in cell.driven
    ]


def _whitened(values: Array, spread: Array, colour: Sequence[tuple[slice, Array]]) -> Array:
    """Values (p, 2, k) freed of the noise."""
    plain = np.linalg.solve(spread, values)
    for rows, factor in colour:
        flat = plain[rows].reshape(len(factor), -1)
        plain[rows] = solve_triangular(factor, flat, lower=True).reshape(plain[rows].shape)
    return np.asarray(plain)


def _raised(motion: Motion) -> Motion:
    """A motion larger by ``STEP`` everywhere."""
    return lambda q: motion(q) + STEP


def _design(cell: AxisCell, number: int, own: _Pieces, plain: Array) -> Array:
    """Derivatives across the track by all unknowns, shape (p, 2, k)."""
    machine, part = cell.machine, cell.driven[number]
    q, known = part.q[own.middle], cell.errors
    link, place = machine.target(part.target)[0], cell.places[part.target]
    start = machine.place(q, known, link, place)

    def seen(position: Array) -> Array:
        return np.asarray(np.einsum('pij,pj->pi', own.across, (position - start) / STEP))

    blocks = []
    for axis in machine.letters:
        nodes, column = machine.nodes(axis), q[:, machine.column(axis)]
        hats = np.stack([np.interp(column, nodes, unit) for unit in np.eye(len(nodes))], axis=1)
        for letter in SIX:
            name = f'E{letter}{axis}'
            raised = Errors({**known.motions, name: _raised(known.motions[name])}, known.constants)
            moved = seen(machine.place(q, raised, link, place))
            blocks.append(moved[:, :, None] * hats[:, None, :])
    for name in (*SQUARE, *(n for a in machine.turning if a in ROTARY for n in LOCATION[a])):
        value = known.constants[name] + STEP
        raised = Errors(known.motions, {**known.constants, name: value})
        blocks.append(seen(machine.place(q, raised, link, place))[:, :, None])
    beam = plain[own.middle] - cell.tracker
    turns = np.stack([np.cross(unit, beam) for unit in np.eye(3)], axis=2)
    blocks += [own.across, own.across @ turns]
    for name in cell.places:
        if not machine.spec['targets'].get(name, {}).get('u'):
            continue
        if name == part.target:
            shifts = [seen(machine.place(q, known, link, place + STEP * e)) for e in np.eye(3)]
            blocks.append(np.stack(shifts, axis=2))
        else:
            blocks.append(np.zeros((len(q), 2, 3)))
    return np.concatenate(blocks, axis=2)
