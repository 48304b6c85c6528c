# SPDX-License-Identifier: Apache-2.0
"""Rows of a quick least-squares model of runs, for questions about the input.

The rigid-body model of ``kinematics`` with tables at half the pitch, so that their kinks cost
little, pieces taken as independent. Good for telling what fits from what does not in a fraction
of a second; error tables come from ``joint``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.model.kinematics import squareness_influence
from otf_core.model.machine import Chain, Machine
from otf_core.model.motions import SQUARENESS
from otf_core.noise.noise_model import beam_shares, path_frame
from otf_core.pieces.runs import Run

FLOOR = 1e-7
"""m; independent uncertainty of every piece at least."""
UNIT = np.eye(3)


@dataclass(frozen=True)
class Rows:
    """Deviations of all pieces of all runs and what they depend on.

    Attributes
    ----------
    machine : Machine
        Of the first run; its chain and axes are those of all.
    run : ndarray of int64, shape (p,)
    piece : ndarray of int64, shape (p,)
        Place among the pieces of the run.
    time : ndarray, shape (p,), s
        Since the start of the run.
    q, points : ndarray, shape (p, 3), m
        Place on the path and measured point, machine frame.
    beam : ndarray, shape (p, 3)
        Unit vectors from the tracker, machine frame.
    direction, side : ndarray, shape (p, 3)
        See ``pieces.Pieces``.
    speed : ndarray, shape (p,), m/s
    offset : ndarray, shape (p, 3), m
        Target offset.
    axes : ndarray, shape (c, p, 3)
        Directions of the rows: two perpendicular to the path, at a stop three.
    deviation, sigma : ndarray, shape (c, p), m
        Measured minus nominal, and the standard deviation expected from the noise.
    """

    machine: Machine
    run: Index
    piece: Index
    time: Array
    q: Array
    points: Array
    beam: Array
    direction: Array
    side: Array
    speed: Array
    offset: Array
    axes: Array
    deviation: Array
    sigma: Array

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.run)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.run[-1]) + 1

    def take(self, pieces: Index) -> Rows:
        """Return the rows of some pieces only, given by their places."""
        across = {'axes', 'deviation', 'sigma'}
        found = {
            f.name: getattr(self, f.name)[:, pieces]
            if f.name in across
            else getattr(self, f.name)[pieces]
            for f in fields(self)
            if f.name != 'machine'
        }
        return Rows(self.machine, **found)

    def component(self, vectors: Array) -> Array:
        """Rows of vectors (p, 3) along ``axes``, shape (c p,)."""
        return np.asarray(np.einsum('cpi,pi->cp', self.axes, vectors).ravel())


def _mean_variance(white: float, time: float, duration: Array, count: Array) -> Array:
    """Variance of means of noise of unit variance, shape (p,)."""
    x = np.maximum(duration / max(time, 1e-6), 1e-3)
    slow = 2.0 * (x - 1.0 + np.exp(-x)) / x**2
    return np.asarray(white / count + (1.0 - white) * slow)


def _sigma(run: Run, shares: Array) -> Array:
    pieces, noise = run.pieces, run.noise
    variance = np.full(shares.shape[1:], FLOOR**2)
    for part, share in zip(noise, shares, strict=True):
        mean = _mean_variance(
            part.white_share, part.correlation_time, pieces.duration, pieces.count.astype(float)
        )
        variance += (part.level * share) ** 2 * mean
    return np.asarray(np.sqrt(variance))


def _of_run(run: Run, number: int) -> dict[str, Array]:
    pieces = run.pieces
    points = run.pose.apply(pieces.xyz)
    distance = np.linalg.norm(pieces.xyz, axis=1)
    beam = run.pose.rotate(pieces.xyz / distance[:, None])
    if pieces.standstill:
        q, axes = pieces.origin, np.broadcast_to(UNIT[:, None], (3, len(points), 3))
    else:
        along = np.einsum('ij,ij->i', points - pieces.origin, pieces.direction)
        q = pieces.origin + along[:, None] * pieces.direction
        axes = np.stack(path_frame(pieces.direction, beam))
    return {
        'run': np.full(len(pieces), number),
        'piece': np.arange(len(pieces)),
        'time': pieces.time,
        'q': q,
        'points': points,
        'beam': beam,
        'direction': pieces.direction,
        'side': pieces.side,
        'speed': pieces.speed,
        'offset': np.tile(run.machine.target_offset, (len(pieces), 1)),
        'axes': axes,
        'deviation': np.einsum('cpi,pi->cp', axes, points - q),
        'sigma': _sigma(run, beam_shares(pieces.xyz, run.pose, axes)),
    }


def build_rows(runs: Sequence[Run]) -> Rows:
    """Collect the rows of runs that are aligned and reduced to pieces."""
    parts = [_of_run(run, k) for k, run in enumerate(runs)]
    across = {'axes', 'deviation', 'sigma'}
    joined = {
        name: np.concatenate([part[name] for part in parts], axis=int(name in across))
        for name in parts[0]
    }
    return Rows(runs[0].machine, **joined)


def turning(rows: Rows, arm: Array) -> Array:
    """Rows per unit of rotations about X, Y and Z at arms (p, 3), shape (c, p, 3), m/rad."""
    return np.cross(arm, rows.axes)  # a . (e x arm) = e . (arm x a)


def pose_columns(rows: Rows) -> Array:
    """Rows per unit of a rigid motion of the measured points, shape (c p, 6), 1 and m/rad."""
    return np.concatenate([rows.axes, turning(rows, rows.points)], axis=2).reshape(-1, 6)


def levers(rows: Rows, chain: Chain, offset: Array, axis: int) -> Array:
    """Lever arm of one axis at every piece, shape (p, 3), m."""
    names = rows.machine.axis_names
    carried = np.array([a in chain.lever_axes(names[axis]) for a in names])
    return np.asarray(offset + np.where(carried, rows.q, 0.0))


def squareness_columns(rows: Rows) -> Array:
    """Rows per unit of squareness, shape (c p, 3), m/rad."""
    parts = [rows.component(squareness_influence(n, rows.q)) for n in SQUARENESS]
    return np.stack(parts, axis=1)


def reversal_columns(rows: Rows) -> Array:
    """Rows per unit of a constant reversal of each axis in each direction, shape (c p, 9)."""
    columns = 0.5 * rows.side[:, :, None] * rows.axes[:, :, None]
    return np.asarray(columns.reshape(-1, 9))


def lag_columns(rows: Rows) -> Array:
    """Rows of every axis lagging behind by a time of its own, shape (c p, 3), 1.

    Per m of lag at the mean speed of all. It flips with the sense of travel like a reversal, but
    grows with the speed of the axis: where that changes, between laps of two feeds or from long to
    short lines, it looks like a step.
    """
    velocity = rows.speed[:, None] * rows.direction / max(float(rows.speed.mean()), 1e-9)
    return np.asarray((-velocity * rows.axes).reshape(-1, 3))


def drift_columns(rows: Rows, order: int = 3) -> Array:
    """Rows of a rigid motion that grows as Legendre polynomials of time, run by run.

    Returns
    -------
    ndarray, shape (c p, 6 order runs)
    """
    pose, components = pose_columns(rows), len(rows.axes)
    found = []
    for run in range(rows.runs):
        mine = rows.run == run
        time = rows.time[mine]
        x = np.zeros(len(rows))
        x[mine] = 2.0 * (time - time.min()) / max(float(np.ptp(time)), 1e-9) - 1.0
        for n in range(1, order + 1):
            value = np.where(mine, np.polynomial.Legendre.basis(n)(x), 0.0)
            found.append(pose * np.tile(value, components)[:, None])
    return np.concatenate(found, axis=1)


def poses_by_run(rows: Rows) -> Array:
    """Pose columns of every run beside each other, shape (c p, 6 runs)."""
    pose = pose_columns(rows)
    mine = [np.tile(rows.run == run, len(rows.axes))[:, None] for run in range(rows.runs)]
    return np.concatenate([pose * m for m in mine], axis=1)
