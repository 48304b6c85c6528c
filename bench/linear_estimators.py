# SPDX-License-Identifier: Apache-2.0
"""Linear estimators to set beside ``calibrate`` on the same path pieces; used by the benches.

Rows as in Eq. 7 of the paper: two directions perpendicular to the path at every piece, unknowns
are the tracker's pose, three squareness errors and coefficients of 18 error motions, written anew
from docs/conventions.md. Dense algebra throughout.

- 'ols': pseudo-inverse, all rows alike; uncertainty by Eq. 12 (independent samples).
- 'white': weights by range and angle variance of the samples of a piece.
- 'gls': the true covariance of the noise of every leg, colour and tracker axes included.
- 'rough': Gaussian process (Matern 5/2) of every motion with the length and the size that are most
  likely for its true curve, and the true noise of every leg: the limit of an estimator that knows
  roughness and noise.
- 'oracle': the same with the covariance over the ensemble of the form. It knows more than the
  roughness (of 'legendre', that the curves are polynomials of degree 7): nothing linear is better.

The first three have hat functions at ``table_pitch``, fixed in a gauge; rotations that act like
a translation of their own axis whatever is driven have no column.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'src/otf_core/test'))

from nature import LETTERS, NAMES, SQUARE, Judgement, hat, influences, judge_field, levers
from nature_forms import draw_curve, matern, nodes_of
from nature_tracker import beam_frame

KINDS = ('ols', 'white', 'gls', 'rough', 'oracle')
LIMITS = ('rough', 'oracle')
FINE = 120
"""Intervals of the range on which the oracle's curves stand."""
DRAWS = 2000
"""Curves from which the covariance of a form is estimated."""
SMALL = 1e-8
"""Share of the largest variance below which a principal component of a form is left out."""
QUADRATURE = 6
"""Points of time in a piece over which the coloured noise is averaged."""
ITERATIONS = 2
LENGTHS = np.geomspace(0.04, 2.0, 24)
"""Shares of the range among which the length of a true curve is sought."""
JITTER = 1e-6
"""Share of the variance that is not smooth, for the likelihood of a length."""


@dataclass(frozen=True)
class Basis:
    """One error motion as value(q_axis) = hat(nodes, q_axis) @ root @ coefficients."""

    nodes: np.ndarray
    root: np.ndarray


def visible(cell, name):
    """Tell whether one target offset can show a motion: its lever changes with another axis."""
    if name[1] in LETTERS:
        return True
    points = np.array([[0.0, 0.0, 0.0], [0.3, 0.2, -0.1]])
    moving = np.diff(levers(cell.chain, cell.offset, points)[name[2]], axis=0)[0] != 0
    moving[[LETTERS.index(name[2]), 'ABC'.index(name[1])]] = False
    return bool(moving.any())


def table_bases(cell, pitch=None):
    """Hat functions at the table nodes in the gauge of docs/conventions.md."""
    bases = {}
    for name in NAMES:
        axis = cell.machine.axes[name[2]]
        nodes = nodes_of(axis.min, axis.max, pitch or axis.table_pitch)
        keep = np.ones(len(nodes), bool)
        if name[1] in LETTERS and name[1] != name[2]:
            keep[[0, -1]] = False
        else:
            keep[int(np.argmin(np.abs(nodes)))] = False
        keep &= visible(cell, name)
        bases[name] = Basis(nodes, np.eye(len(nodes))[:, keep])
    return bases


@lru_cache(maxsize=64)
def ensemble_root(form, low, high, pitch):
    """Nodes and root of the covariance of unit curves of a form, from ``DRAWS`` of them."""
    nodes = nodes_of(low, high, pitch if form == 'polygon' else (high - low) / FINE)
    rng = np.random.default_rng(4)
    curves = np.array([draw_curve(rng, form, low, high, 1.0, pitch)(nodes) for _ in range(DRAWS)])
    return nodes, principal(curves.T @ curves / DRAWS)


def principal(covariance):
    """Root R (k, r) with R R^T the covariance, components of no size left out."""
    size, vectors = np.linalg.eigh(covariance)
    keep = size > SMALL * size[-1]
    return vectors[:, keep] * np.sqrt(size[keep])


def prior_bases(cell):
    """Error motions as the ensemble of the form has them: coefficients of unit variance."""
    bases = {}
    for name in NAMES:
        axis, curve = cell.machine.axes[name[2]], cell.curves[name]
        if np.isfinite(curve.length):
            nodes = nodes_of(axis.min, axis.max, (axis.max - axis.min) / FINE)
            root = principal(matern(nodes[:, None] - nodes, curve.length))
            bases[name] = Basis(nodes, curve.deviation * root)
        else:
            nodes, root = ensemble_root(cell.form, axis.min, axis.max, axis.table_pitch)
            size = cell.translation if name[1] in LETTERS else cell.rotational
            bases[name] = Basis(nodes, size * root)
    return bases


def most_likely(curve, low, high):
    """Length (m) and standard deviation of the Matern process most likely for a true curve."""
    q = np.linspace(low, high, 41)
    value, best = curve(q) - np.mean(curve(q)), (-np.inf, 0.0, 0.0)
    for length in LENGTHS * (high - low):
        # any constant is allowed: it is no roughness
        shape = matern(q[:, None] - q, length) + JITTER * np.eye(len(q))
        root = cholesky(shape + 1.0, lower=True)
        white = solve_triangular(root, value, lower=True)
        variance = float(np.mean(white**2))
        likelihood = -0.5 * len(q) * np.log(variance) - np.sum(np.log(np.diag(root)))
        best = max(best, (likelihood, length, np.sqrt(variance)))
    return best[1:]


def rough_bases(cell):
    """Error motions as Matern processes with the most likely length and size of each."""
    bases = {}
    for name in NAMES:
        axis = cell.machine.axes[name[2]]
        length, deviation = most_likely(cell.curves[name], axis.min, axis.max)
        nodes = nodes_of(axis.min, axis.max, (axis.max - axis.min) / FINE)
        covariance = matern(nodes[:, None] - nodes, length) + 1.0
        bases[name] = Basis(nodes, deviation * principal(covariance))
    return bases


@dataclass(frozen=True)
class Geometry:
    """Pieces in a pose of the tracker.

    Attributes
    ----------
    q, points : array (p, 3), m
        On the path, and as measured, in the machine frame.
    axes : array (2, p, 3)
        Directions of the rows.
    observed : array (2 p,), m
    noise : array (3, 2 p)
        What a unit of noise of range, and of each angle, makes of the rows; m per m or rad.
    """

    q: np.ndarray
    points: np.ndarray
    axes: np.ndarray
    observed: np.ndarray
    noise: np.ndarray


def geometry(pieces, rotation, place, error):
    """Rows of the pieces; ``error`` (p, 3), m, is the displacement as known so far."""
    points = pieces.xyz @ rotation.T + place
    along = np.einsum('ij,ij->i', points - error - pieces.origin, pieces.direction)
    q = pieces.origin + along[:, None] * pieces.direction
    beams = beam_frame(pieces.xyz) @ rotation.T
    across = (
        beams[0] - pieces.direction * np.einsum('ij,ij->i', beams[0], pieces.direction)[:, None]
    )
    flat = np.linalg.norm(across, axis=1) < 1e-6
    across[flat] = np.cross(pieces.direction[flat], [0.36, 0.48, 0.8])
    across /= np.linalg.norm(across, axis=1)[:, None]
    axes = np.stack([across, np.cross(pieces.direction, across)])
    distance = np.linalg.norm(pieces.xyz, axis=1)
    shares = np.einsum('kij,dij->dki', axes, beams)
    shares[1:] *= distance
    observed = np.einsum('kij,ij->ki', axes, points - q).ravel()
    return Geometry(q, points, axes, observed, shares.reshape(3, -1))


def columns(cell, bases, q):
    """Displacement at q per squareness error and coefficient, (n, 3, m)."""
    influence = influences(cell.chain, cell.offset, q)
    weights = {}
    for name in NAMES:
        nodes = bases[name].nodes
        key = (name[2], len(nodes))
        if key not in weights:
            weights[key] = hat(nodes, q[:, LETTERS.index(name[2])])
    parts = [influence[n][:, :, None] for n in SQUARE]
    for name in NAMES:
        own = weights[name[2], len(bases[name].nodes)] @ bases[name].root
        parts.append(influence[name][:, :, None] * own[:, None, :])
    return np.concatenate(parts, axis=2)


def design(cell, bases, place):
    """Rows (2 p, 6 + m): pose of the tracker, squareness, coefficients."""
    model = columns(cell, bases, place.q)
    pose = np.zeros((len(place.q), 3, 6))
    for k, unit in enumerate(np.eye(3)):
        pose[:, :, k], pose[:, :, 3 + k] = -unit, -np.cross(unit, place.points)
    whole = np.concatenate([pose, model], axis=2)
    return np.concatenate([np.matmul(a[:, None, :], whole)[:, 0] for a in place.axes])


def time_covariance(pieces, use, noise):
    """Covariance of the means over pieces of noise of unit variance, (m, m)."""
    share = (np.arange(QUADRATURE) + 0.5) / QUADRATURE - 0.5
    alone = pieces.count[use] == 1
    spread = np.where(alone, 0.0, pieces.duration[use])
    t = (pieces.time[use][:, None] + spread[:, None] * share).ravel()
    slow = np.exp(-np.abs(t[:, None] - t) / noise.tau)
    m = len(use)
    mean = slow.reshape(m, QUADRATURE, m, QUADRATURE).mean(axis=(1, 3))
    return noise.colour * mean + np.diag((1 - noise.colour) / pieces.count[use])


def leg_roots(pieces, place, noise):
    """Indices of the rows of every leg and the lower root of their covariance."""
    count = len(pieces.leg)
    size = noise.factor * np.array([noise.u_range, noise.u_angle, noise.u_angle])
    for leg in np.unique(pieces.leg):
        use = np.flatnonzero(pieces.leg == leg)
        rows = np.concatenate([use, use + count])
        mean = np.tile(time_covariance(pieces, use, noise), (2, 2))
        shares = place.noise[:, rows] * size[:, None]
        yield rows, cholesky(mean * (shares.T @ shares), lower=True)


@dataclass(frozen=True)
class Estimate:
    """Squareness and coefficients (m,), their covariance, and the bases they belong to.

    ``chi_square`` is the weighted square sum of the residuals per row.
    """

    bases: dict
    value: np.ndarray
    covariance: np.ndarray
    chi_square: float


def _least_squares(rows, observed, precision):
    """Solution and covariance of whitened rows, with a prior precision of each unknown."""
    scale = 1.0 / np.sqrt(np.einsum('ij,ij->j', rows, rows) + precision)
    scaled = rows * scale
    normal = scaled.T @ scaled + np.diag(precision * scale**2)
    factor = cho_factor(normal)
    covariance = cho_solve(factor, np.eye(len(scale))) * np.outer(scale, scale)
    return scale * cho_solve(factor, scaled.T @ observed), covariance


def _solve(kind, rows, place, pieces, noise, precision):
    variance = np.sum(
        (noise.factor * place.noise * np.array([[noise.u_range], *[[noise.u_angle]] * 2])) ** 2,
        axis=0,
    ) / np.tile(pieces.count, 2)
    if kind == 'ols':
        scale = 1.0 / np.linalg.norm(rows, axis=0)
        inverse = np.linalg.pinv(rows * scale) * scale[:, None]
        value = inverse @ place.observed
        covariance = (inverse * variance) @ inverse.T
        left = (place.observed - rows @ value) / np.sqrt(variance)
        return value, covariance, float(np.mean(left**2))
    if kind == 'white':
        whole = np.column_stack([rows, place.observed]) / np.sqrt(variance)[:, None]
    else:
        whole = np.column_stack([rows, place.observed])
        for index, root in leg_roots(pieces, place, noise):
            whole[index] = solve_triangular(root, whole[index], lower=True)
    value, covariance = _least_squares(whole[:, :-1], whole[:, -1], precision)
    return value, covariance, float(np.mean((whole[:, -1] - whole[:, :-1] @ value) ** 2))


def estimate(cell, run, noise, kind):
    """Estimate the error motions from the pieces of a run of a ``CalibrationResult``."""
    pieces = run.pieces
    make = {'rough': rough_bases, 'oracle': prior_bases}.get(kind, table_bases)
    bases = make(cell)
    count = sum(b.root.shape[1] for b in bases.values())
    precision = np.zeros(6 + 3 + count)
    if kind in LIMITS:
        precision[6:9] = 1.0 / (0.5 * cell.rotational) ** 2
        precision[9:] = 1.0
    rotation, origin = run.T_machine_tracker.rotation, run.T_machine_tracker.translation
    error = np.zeros((len(pieces.leg), 3))
    for _ in range(ITERATIONS):
        place = geometry(pieces, rotation, origin, error)
        rows = design(cell, bases, place)
        value, covariance, square = _solve(kind, rows, place, pieces, noise, precision)
        # the pose moves with the errors, so that both stay small where the path is linearised
        turn = np.cross(np.eye(3), value[3:6])
        rotation = orthogonal((np.eye(3) - turn) @ rotation)
        origin = origin - turn @ origin + value[:3]
        error = columns(cell, bases, place.q) @ value[6:]
    return Estimate(bases, value[6:], covariance[6:, 6:], square)


def orthogonal(matrix):
    """Nearest rotation."""
    left, _, right = np.linalg.svd(matrix)
    return left @ right


def judge_estimate(cell, found) -> Judgement:
    """Judge an estimate like error tables; see ``nature.judge``."""
    q = cell.lattice()
    flat = columns(cell, found.bases, q).reshape(3 * len(q), -1)
    return judge_field(q, cell.error(q).ravel(), flat, found.value, found.covariance)
