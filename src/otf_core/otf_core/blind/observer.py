# SPDX-License-Identifier: Apache-2.0
"""What no table and no pose can follow: dense least squares by an observer who knows the truth.

The truth says where every sample was taken and what the noise is, so nothing that a calibration or
a diagnosis computes enters here. Per path piece, across the path,

    y = J x + e,    x ~ N(0, s^2),    e ~ N(0, V)

with J the differences of the exact kinematics by all table values (linear between the nodes of
machine.yaml), the squareness errors and the poses of the tracker, s = ``WIDE``, V the covariance
of the means of the noise; x by Householder reduction of the whitened rows and of x / s = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular, toeplitz

from otf_core.arrays import Array, Index
from otf_core.blind.draw import Trial
from otf_core.config import CalibrationConfig, SimulationConfig
from otf_core.effects import AppliedEffect, State
from otf_core.model.frames import RigidTransform
from otf_core.model.kinematics import exact_position
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion
from otf_core.model.nodes import axis_nodes
from otf_core.model.tables import ErrorTables
from otf_core.sim.cell import EPOCH_NS, SimulatedRun
from otf_core.sim.drive import Drive
from otf_core.sim.effects import run_state, total_displacement
from otf_core.sim.simulated_signals import signal_courses
from otf_core.threads import limit_to_one_thread

OBSERVED_RATE = 100.0
"""Hz; samples that come faster are averaged, so that the covariance of a line stays small."""


@dataclass(frozen=True)
class Sight:
    """The moving samples of one run, straight line by straight line, piece by piece.

    Attributes
    ----------
    state : State
        Of the samples of the run, or of one in ``block`` where these come faster than
        ``OBSERVED_RATE``: the mean of a block then stands for a sample.
    config : SimulationConfig
        Rate and colour of the noise.
    use : ndarray of int64, shape (u,)
        Samples that lie in pieces.
    line, piece : ndarray of int64, shape (u,)
        Which straight line and which piece each of them belongs to, both ascending.
    """

    state: State
    config: SimulationConfig
    block: int
    use: Index
    line: Index
    piece: Index

    def mean(self, values: Array) -> Array:
        """Means over the pieces of values (u, k), shape (p, k)."""
        sums = np.stack([np.bincount(self.piece, v) for v in values.T], axis=1)
        return np.asarray(sums / np.bincount(self.piece)[:, None])

    def seen(self, moved: Array) -> Array:
        """Part of a displacement of all samples (n, 3) that lies across the path, (u, 2), m."""
        whole = moved[: len(self.state) * self.block]
        means = whole.reshape(-1, self.block, 3).mean(axis=1)
        return np.asarray(np.einsum('uij,uj->ui', self.across, means[self.use]))

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
        lag = np.arange(np.bincount(self.line).max()) * self.block / self.config.rate
        slow = self.config.correlated_share * np.exp(-lag / self.config.correlation_time)
        slow[0] += (1.0 - self.config.correlated_share) / self.block
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
        factors = []
        lines = stretches(self.line), stretches(self.line[self.first])
        for samples, rows in zip(*lines, strict=True):
            number = self.piece[samples] - rows.start
            share = (number == np.arange(rows.stop - rows.start)[:, None]).astype(float)
            share /= share.sum(axis=1, keepdims=True)
            half = share @ self.colour[: len(number), : len(number)]
            factors.append((rows, np.linalg.cholesky(half @ half.T)))
        return factors

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
    wanted, block = CalibrationConfig(), max(1, round(config.rate / OBSERVED_RATE))
    state = state.part(slice(block // 2, len(state) // block * block, block))
    end = np.minimum(state.from_corner, state.to_corner)
    use = np.flatnonzero((end > wanted.corner_exclusion) & (state.speed > wanted.standstill_speed))
    turned = np.any(np.diff(state.direction, axis=0, prepend=state.direction[:1]) != 0, axis=1)
    line = np.cumsum(turned)[use]
    length = (state.from_corner + state.to_corner)[use]
    parts = np.ceil(length / wanted.piece_length - 1e-9)
    number = np.floor(state.from_corner[use] / length * parts)
    fresh = (np.diff(line, prepend=-1) != 0) | (np.diff(number, prepend=-1.0) != 0)
    line = np.unique(line, return_inverse=True)[1]
    return Sight(state, config, block, use, line, np.cumsum(fresh) - 1)


WIDE = 1e-3
"""m and rad; ten times the largest errors that are drawn."""
STEP = 1e-6
"""m and rad; for differences of the kinematics, which are nearly linear."""


def _shifted(tables: ErrorTables, name: str) -> ErrorTables:
    """Tables with one motion or squareness larger by ``STEP`` everywhere."""
    if name in SQUARENESS:
        value = replace(tables.squareness[name], value=tables.squareness[name].value + STEP)
        return replace(tables, squareness={**tables.squareness, name: value})
    motion = replace(tables.motions[name], value=tables.motions[name].value + STEP)
    return replace(tables, motions={**tables.motions, name: motion})


def _design(sight: Sight, tables: ErrorTables) -> tuple[Array, Array]:
    """Derivatives of the place across the path by tables (p, 2, k) and by the pose (p, 2, 6)."""
    samples = sight.state.q[sight.use]
    q, beam, across = sight.mean(samples), sight.mean(sight.state.beam[sight.use]), sight.across
    plain, across = exact_position(tables, q), across[sight.first]
    hats = {}
    for k, axis in enumerate(tables.machine.axis_names):
        nodes = axis_nodes(tables.machine.axes[axis])
        parts = [np.interp(samples[:, k], nodes, unit) for unit in np.eye(len(nodes))]
        hats[axis] = sight.mean(np.stack(parts, axis=1))
    blocks = []
    for name in (*MOTIONS, *SQUARENESS):
        moved = (exact_position(_shifted(tables, name), q) - plain) / STEP
        seen = np.einsum('pij,pj->pi', across, moved)[:, :, None]
        blocks.append(
            seen * hats[ErrorMotion.of(name).axis][:, None, :] if name in MOTIONS else seen
        )
    turns = np.stack([np.cross(unit, beam) for unit in np.eye(3)], axis=2)
    return np.concatenate(blocks, axis=2), np.concatenate([across, across @ turns], axis=2)


@dataclass(frozen=True)
class Observer:
    """All runs of a trial, seen by one who knows everything but the effect.

    Attributes
    ----------
    sights : tuple of Sight
        One per run.
    columns : ndarray, shape (r, k)
        J: piece after piece, run after run.
    orthogonal : ndarray, shape (r, k)
        First rows of the orthogonal factor of the whitened columns and the prior.
    triangular : ndarray, shape (k, k)
        Their triangular factor.
    """

    sights: tuple[Sight, ...]
    columns: Array
    orthogonal: Array
    triangular: Array

    @limit_to_one_thread
    def left(self, moved: Sequence[Array]) -> tuple[list[Array], float]:
        """What tables and poses leave of displacements of all samples of each run.

        Parameters
        ----------
        moved : sequence of ndarray, shape (n, 3), m
            One per run.

        Returns
        -------
        pieces : list of ndarray, shape (p, 2), m
            Means across the path, one array per run.
        snr : float
            Length of what is left in the single samples, freed of the noise.
        """
        samples = [s.seen(m) for s, m in zip(self.sights, moved, strict=True)]
        means = [s.mean(v) for s, v in zip(self.sights, samples, strict=True)]
        white = [
            s.white_pieces(m[:, :, None]).ravel() for s, m in zip(self.sights, means, strict=True)
        ]
        x = solve_triangular(self.triangular, self.orthogonal.T @ np.concatenate(white))
        followed = (self.columns @ x).reshape(-1, 2)
        cuts = np.cumsum([len(m) for m in means])[:-1]
        parts = np.split(followed, cuts)
        pieces = [m - f for m, f in zip(means, parts, strict=True)]
        square = sum(
            float(np.sum(s.white_samples(v - _between(s, f)) ** 2))
            for s, v, f in zip(self.sights, samples, parts, strict=True)
        )
        return pieces, float(np.sqrt(square))


def _between(sight: Sight, values: Array) -> Array:
    """Values (p, 2) of the pieces at their samples (u, 2): straight from centre to centre."""
    time = sight.state.time[sight.use]
    centre = sight.mean(time[:, None])[:, 0]
    angles = np.empty((len(time), 2))
    lines = stretches(sight.line), stretches(sight.line[sight.first])
    for samples, rows in zip(*lines, strict=True):
        for k in range(2):
            angles[samples, k] = np.interp(time[samples], centre[rows], values[rows, k])
    return angles


@limit_to_one_thread
def observe(sights: Sequence[Sight], tables: ErrorTables) -> Observer:
    """Set up the least squares for runs of one machine.

    Parameters
    ----------
    tables : ErrorTables
        Of the truth machine.
    """
    plain, white = [], []
    designs = [_design(s, tables) for s in sights]
    poses = np.eye(len(sights))
    for own, sight, (motions, pose) in zip(poses, sights, designs, strict=True):
        both = np.concatenate([motions, *(one * pose for one in own)], axis=2)
        plain.append(both.reshape(-1, both.shape[2]))
        white.append(sight.white_pieces(both).reshape(-1, both.shape[2]))
    columns = np.concatenate(plain)
    prior = np.eye(columns.shape[1]) / WIDE
    orthogonal, triangular = np.linalg.qr(np.concatenate([*white, prior]))
    return Observer(tuple(sights), columns, orthogonal[: len(columns)], triangular)


@dataclass(frozen=True)
class Ruler:
    """The runs of a trial without effects: measures what displacements leave.

    Attributes
    ----------
    states : tuple of State
        Of all samples of each run.
    """

    trial: Trial
    runs: tuple[SimulatedRun, ...]
    states: tuple[State, ...]
    observer: Observer

    def displacement(self, effects: Sequence[AppliedEffect]) -> list[Array]:
        """Displacement of all samples of each run, (n, 3), m."""
        return [total_displacement(s, effects) for s in self.states]

    def raw(self, moved: Sequence[Array]) -> float:
        """Root mean square of a displacement itself, m."""
        return float(np.sqrt(np.mean(np.concatenate([(m**2).sum(axis=1) for m in moved]))))

    def size(self, moved: Sequence[Array]) -> float:
        """Root mean square per piece of what tables and poses leave across the path, m."""
        return _per_piece(self.observer.left(moved)[0])

    def snr(self, moved: Sequence[Array]) -> float:
        """Length of what is left, freed of the noise: standard deviations of a perfect test."""
        return self.observer.left(moved)[1]

    def residual(self, moved: Sequence[Array] | None = None) -> float:
        """Root mean square residual per piece, m, with a displacement added to the runs.

        Beside the true tables: what these do between nodes is no part of it.
        """
        noisy = [
            run.samples.xyz @ run.rotation + run.place - exact_position(self.trial.tables, state.q)
            for run, state in zip(self.runs, self.states, strict=True)
        ]
        if moved is not None:
            noisy = [a + b for a, b in zip(noisy, moved, strict=True)]
        return _per_piece(self.observer.left(noisy)[0])


def _per_piece(residuals: Sequence[Array]) -> float:
    both = np.concatenate(residuals)
    return float(np.sqrt(np.sum(both**2) / len(both)))


def sample_state(trial: Trial, k: int, run: SimulatedRun) -> State:
    """State of all samples of a simulated run, as the simulation itself uses it."""
    config = trial.configs[k]
    drive = Drive(trial.plan, config.acceleration)
    time = np.arange(len(run.samples)) / config.rate
    pose = RigidTransform(run.rotation.T, run.place)
    clock = time * (1 + config.clock_drift)
    beside = signal_courses(run.signals, EPOCH_NS, clock)
    return run_state(trial.machine, trial.plan, drive, time, clock, pose, run.truth, beside)


def make_ruler(trial: Trial) -> Ruler:
    """Simulate a trial without effects."""
    runs = tuple(trial.runs())
    states = tuple(sample_state(trial, k, r) for k, r in enumerate(runs))
    sights = [see(s, c) for s, c in zip(states, trial.configs, strict=True)]
    return Ruler(trial, runs, states, observe(sights, trial.tables))
