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

import numpy as np
from scipy.linalg import solve_triangular

from otf_core.arrays import Array
from otf_core.blind.sight import Sight, stretches
from otf_core.model.kinematics import exact_position
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion
from otf_core.model.nodes import axis_nodes
from otf_core.model.tables import ErrorTables
from otf_core.threads import in_one_thread

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

    @in_one_thread
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
    found = np.empty((len(time), 2))
    lines = stretches(sight.line), stretches(sight.line[sight.first])
    for samples, rows in zip(*lines, strict=True):
        for k in range(2):
            found[samples, k] = np.interp(time[samples], centre[rows], values[rows, k])
    return found


@in_one_thread
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
