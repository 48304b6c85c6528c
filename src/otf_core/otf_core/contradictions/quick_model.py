# SPDX-License-Identifier: Apache-2.0
"""Linear model of runs with tables, reversal, lag and slow drift, fitted in less than a second.

Rows, lever arms, squareness and hat functions are those of ``solving``, with tables at half the
pitch, so that their kinks cost little. Pieces are taken as independent and fitted robustly.
Examinations compare with it what fits and what does not; tables come from ``solving.joint``.

A row of the tables holds, for every axis, the influences of its six motions times the two hat
functions that are not zero there. So the products of two axes are 6 x 6 numbers of a piece, the
same for all pairs of nodes but for a factor, and need no multiplication of sparse matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import permutations

import numpy as np
from scipy import linalg, sparse

from otf_core.arrays import Array, Index
from otf_core.model.chain import Sight
from otf_core.model.machine import TOOL, Chain, Machine
from otf_core.noise.noise_model import beam_shares, noise_covariance
from otf_core.pieces.pieces import RAYLEIGH_MEDIAN
from otf_core.pieces.runs import Run
from otf_core.solving.system import components, positions_on_path, row_directions
from otf_core.solving.unknowns import Unknowns, layout, linear

MIN_SIGMA = 1e-7
"""m; independent uncertainty of every piece at least."""


@dataclass(frozen=True)
class Rows:
    """Deviations of all pieces of all runs and what they depend on.

    Attributes
    ----------
    machines : tuple of Machine
        Of every run; chain and axes are the same in all.
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
    axes : ndarray, shape (c, p, 3)
        Directions of the rows: two perpendicular to the path, at a stop three.
    deviation, sigma : ndarray, shape (c, p), m
        Measured minus nominal, and the standard deviation expected from the noise.
    """

    machines: tuple[Machine, ...]
    run: Index
    piece: Index
    time: Array
    q: Array
    points: Array
    beam: Array
    direction: Array
    side: Array
    speed: Array
    axes: Array
    deviation: Array
    sigma: Array

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.run)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.machines)

    @property
    def machine(self) -> Machine:
        """Machine of the first run."""
        return self.machines[0]

    def take(self, pieces: Index) -> Rows:
        """Return the rows of some pieces only, given by their places."""
        across = {'axes', 'deviation', 'sigma'}
        selection = {
            f.name: getattr(self, f.name)[:, pieces]
            if f.name in across
            else getattr(self, f.name)[pieces]
            for f in fields(self)
            if f.name != 'machines'
        }
        return Rows(self.machines, **selection)

    def component(self, vectors: Array) -> Array:
        """Rows of vectors (p, 3) along ``axes``, shape (c p,)."""
        return np.asarray(np.einsum('cpi,pi->cp', self.axes, vectors).ravel())


def _sigma(run: Run, shares: Array) -> Array:
    """Standard deviation of every piece by itself, shape (c, p), m."""
    pieces, alone = run.pieces, shares[..., None]
    windows = (pieces.time[:, None], pieces.duration[:, None], pieces.count[:, None])
    white, slow = noise_covariance(run.noise, alone, alone, windows)
    return np.asarray(np.sqrt(MIN_SIGMA**2 + white[..., 0] + slow[..., 0, 0]))


def _of_run(run: Run, number: int) -> dict[str, Array]:
    pieces = run.pieces
    points = run.pose.apply(pieces.xyz)
    q = positions_on_path(run.sight(TOOL), pieces, points, None)
    axes = row_directions(pieces, run.pose)
    return {
        'run': np.full(len(pieces), number),
        'piece': np.arange(len(pieces)),
        'time': pieces.time,
        'q': q,
        'points': points,
        'beam': run.pose.rotate(pieces.xyz / np.linalg.norm(pieces.xyz, axis=1)[:, None]),
        'direction': pieces.direction,
        'side': pieces.side,
        'speed': pieces.speed,
        'axes': axes,
        'deviation': components(axes, points - q),
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
    return Rows(tuple(run.machine for run in runs), **joined)


def pose_columns(rows: Rows) -> Array:
    """Rows per unit of a rigid motion of the measured points, shape (c p, 6), 1 and m/rad."""
    turned = np.cross(rows.points, rows.axes)  # a . (e x point) = e . (point x a)
    return np.concatenate([rows.axes, turned], axis=2).reshape(-1, 6)


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
    columns = []
    for run in range(rows.runs):
        mine = rows.run == run
        time = rows.time[mine]
        x = np.zeros(len(rows))
        x[mine] = 2.0 * (time - time.min()) / max(float(np.ptp(time)), 1e-9) - 1.0
        for n in range(1, order + 1):
            value = np.where(mine, np.polynomial.Legendre.basis(n)(x), 0.0)
            columns.append(pose * np.tile(value, components)[:, None])
    return np.concatenate(columns, axis=1)


def poses_by_run(rows: Rows) -> Array:
    """Pose columns of every run beside each other, shape (c p, 6 runs)."""
    pose = pose_columns(rows)
    mine = [np.tile(rows.run == run, len(rows.axes))[:, None] for run in range(rows.runs)]
    return np.concatenate([pose * m for m in mine], axis=1)


MAX_NODES = 80
"""Nodes per axis at most."""
AT_REST = 1e-6
"""m; an axis that travels no farther has one node."""


def table_unknowns(rows: Rows) -> Unknowns:
    """Tables of all axes at half the pitch over the driven range."""
    bases = {}
    for axis, q in zip(rows.machine.axis_names, rows.q.T, strict=True):
        low, size = float(q.min()), float(np.ptp(q))
        count = np.ceil(size / (0.5 * rows.machine.axes[axis].table_pitch))
        nodes = np.linspace(low, low + size, int(np.clip(count, 1, MAX_NODES)) + 1)
        bases[axis] = linear(nodes if size > AT_REST else nodes[:1])
    return layout(bases)


@dataclass(frozen=True)
class AxisTables:
    """Tables of the six motions of one axis.

    Attributes
    ----------
    first : ndarray of int64, shape (p,)
        First node at every piece whose hat function is not zero.
    hat : ndarray, shape (w, p)
        Values of that and of the next one; of the only one where the axis stands.
    influence : ndarray, shape (c, 6, p), 1 and m/rad
        Rows per unit of the motions.
    """

    nodes: int
    first: Index
    hat: Array
    influence: Array

    @property
    def columns(self) -> Index:
        """Columns that are not zero at every piece, shape (6, w, p)."""
        motion, hat = np.arange(6)[:, None, None], np.arange(len(self.hat))[:, None]
        return np.asarray(motion * self.nodes + self.first + hat)

    def products(self, other: AxisTables, weight: Array) -> Array:
        """Weighted products of its columns with those of another axis, shape (6 n, 6 n').

        Parameters
        ----------
        weight : ndarray, shape (c, p)
        """
        weighted, right = self.influence * weight[:, None], other.influence
        pairs = sum(a[:, None] * b for a, b in zip(weighted, right, strict=True))
        hats = (self.hat[:, None] * other.hat).reshape(-1, len(self.first))
        steps = np.arange(len(self.hat))[:, None] * other.nodes + np.arange(len(other.hat))
        places = steps.reshape(-1, 1) + self.first * other.nodes + other.first
        of_nodes = _of_rows(places, hats, self.nodes * other.nodes)
        sums = (of_nodes.T @ np.ascontiguousarray(pairs.reshape(36, -1).T)).reshape(
            self.nodes, other.nodes, 6, 6
        )
        return np.asarray(sums.transpose(2, 0, 3, 1).reshape(6 * self.nodes, 6 * other.nodes))


def _of_rows(columns: Index, values: Array, count: int) -> sparse.csr_array:
    """Sparse matrix (n, count) of as many values (k, n) in every row, columns ascending."""
    size, rows = columns.shape
    entries = (values.T.ravel(), columns.T.ravel(), np.arange(0, size * rows + 1, size))
    return sparse.csr_array(entries, shape=(rows, count))


@dataclass(frozen=True)
class Design:
    """Columns of a model: some for all rows, then those of the tables.

    Attributes
    ----------
    usual : ndarray, shape (r, k)
    """

    usual: Array
    axes: tuple[AxisTables, ...]

    @classmethod
    def of(cls, rows: Rows, usual: Array, machines: Sequence[Machine]) -> Design:
        """Set up squareness and tables for machines of the runs, as in ``rows`` or others."""
        bases, machine = table_unknowns(rows).bases, machines[0]
        six = {axis: np.empty((len(rows), 3, 6)) for axis in bases}
        scalars = np.empty((len(rows), 3, len(machine.squareness)))
        for run, own_machine in enumerate(machines):
            own = rows.run == run
            seen = Sight.of_tool(own_machine).at(rows.q[own])
            for axis, motions in seen.motions.items():
                six[axis][own] = motions
            scalars[own] = np.stack([seen.scalars[n] for n in machine.squareness], axis=2)
        squareness = np.einsum('cpi,pik->cpk', rows.axes, scalars)
        usual = np.concatenate([usual, squareness.reshape(len(usual), -1)], axis=1)
        tables = []
        for (axis, basis), q in zip(bases.items(), rows.q.T, strict=True):
            first, weight = basis.places(q)
            influence = np.einsum('cpi,pik->ckp', rows.axes, six[axis])
            tables.append(AxisTables(basis.size, first, weight.T.copy(), influence))
        return cls(usual, tuple(tables))

    @cached_property
    def tables(self) -> sparse.csr_array:
        """Columns of the tables, shape (r, n)."""
        across, _, pieces = self.axes[0].influence.shape
        size = sum(6 * len(a.hat) for a in self.axes)
        values, places = np.empty((across, pieces, size)), np.empty((pieces, size), dtype=np.int32)
        start = at = 0
        for axis in self.axes:
            own = slice(at, at := at + 6 * len(axis.hat))
            hats = (axis.influence[:, :, None] * axis.hat).reshape(across, -1, pieces)
            values[:, :, own] = np.swapaxes(hats, 1, 2)
            places[:, own] = (start + axis.columns).reshape(-1, pieces).T
            start += 6 * axis.nodes
        rows = np.arange(0, values.size + 1, size)
        entries = values.ravel(), np.tile(places, (across, 1)).ravel(), rows
        return sparse.csr_array(entries, shape=(across * pieces, start))

    def times(self, value: Array) -> Array:
        """Rows of what the columns give, shape (r,), for values (k + n,)."""
        width = self.usual.shape[1]
        return np.asarray(self.usual @ value[:width] + self.tables @ value[width:])

    def products(self, columns: Array) -> Array:
        """Products with further columns (r, j), shape (k + n, j)."""
        return np.concatenate([self.usual.T @ columns, self.tables.T @ columns])

    def sums(self, of_rows: sparse.csr_array) -> Array:
        """Sums of rows with the weights of sparse rows (j, r), shape (j, k + n)."""
        return np.hstack([of_rows @ self.usual, (of_rows @ self.tables).toarray()])

    def normal(self, weight: Array) -> Array:
        """Weighted products of all columns, shape (k + n, k + n); the lower triangle of them."""
        width = self.usual.shape[1]
        starts = width + np.cumsum([0, *(6 * a.nodes for a in self.axes)])
        matrix = np.zeros((starts[-1], starts[-1]))
        matrix[:, :width] = self.products(self.usual * weight[:, None])
        of_pieces = weight.reshape(self.axes[0].influence.shape[0], -1)
        for i, a in enumerate(self.axes):
            for j, b in enumerate(self.axes[: i + 1]):
                own, other = (slice(starts[k], starts[k + 1]) for k in (i, j))
                matrix[own, other] = a.products(b, of_pieces)
        return matrix


PRIOR_SIGMA = 1e-3
"""m and rad; standard deviation of every unknown before the data: fixes what nothing shows."""
MAX_DEVIATION = 8.0
"""Robust standard deviations beyond which a piece is left out."""
MAX_ITERATIONS = 3


@dataclass(frozen=True)
class Fit:
    """A solved model.

    Attributes
    ----------
    weight : ndarray, shape (r,), 1/m^2
        Zero for pieces left out.
    factor : tuple
        Cholesky factor of the normal matrix.
    value : ndarray, shape (k,), m and rad
    residual : ndarray, shape (r,), m
    freedom : float
        Rows less the unknowns that the data determine; not a number where the weights were given.
    """

    design: Design
    weight: Array
    factor: tuple[Array, bool]
    value: Array
    residual: Array
    freedom: float

    @property
    def square(self) -> float:
        """Weighted sum of squares of the residuals."""
        return float(self.weight @ self.residual**2)

    @property
    def ratio(self) -> float:
        """Residual over the noise expected, root mean square per degree of freedom."""
        return float(np.sqrt(self.square / max(self.freedom, 1.0)))

    @property
    def rms(self) -> float:
        """Residual of a row per degree of freedom, m, weighted as in the fit."""
        return self.ratio * float(np.sqrt(np.sum(self.weight > 0) / self.weight.sum()))

    def left(self, columns: Array) -> Array:
        """Normal matrix of further columns (r, k) once those of the model are free."""
        weighted = columns * self.weight[:, None]
        cross = self.design.products(weighted)
        solved = linalg.cho_solve(self.factor, cross, check_finite=False)
        return np.asarray(columns.T @ weighted - cross.T @ solved)

    def score(self, columns: Array) -> Array:
        """Weighted products of further columns (r, k) with the residual."""
        return np.asarray(columns.T @ (self.weight * self.residual))


def gain(information: Array, score: Array, prior: float = PRIOR_SIGMA) -> tuple[Array, Array]:
    """Drop of the sum of squares that further columns bring, and their values.

    Parameters
    ----------
    information : ndarray, shape (..., k, k)
        From ``Fit.left``; one or many.
    score : ndarray, shape (..., k)
    prior : float
        Standard deviation of the values before the data.

    Returns
    -------
    drop : ndarray, shape (...)
    value : ndarray, shape (..., k)
    """
    root, vectors = np.linalg.eigh(information)
    least = np.maximum(1e-9 * root[..., -1:], 1.0 / prior**2)
    projection = np.einsum('...ij,...i->...j', vectors, score) / np.maximum(root, least)
    value = np.einsum('...ij,...j->...i', vectors, projection)
    return np.asarray(np.sum(score * value, axis=-1)), np.asarray(value)


def _solve(design: Design, target: Array, weight: Array) -> tuple[tuple[Array, bool], Array]:
    data = design.normal(weight)
    data[np.diag_indices_from(data)] += 1.0 / PRIOR_SIGMA**2
    factor = linalg.cho_factor(data, lower=True, overwrite_a=True, check_finite=False)
    score = design.products((weight * target)[:, None])[:, 0]
    return factor, linalg.cho_solve(factor, score, check_finite=False)


def _freedom(factor: tuple[Array, bool], weight: Array) -> float:
    inverse, _ = linalg.lapack.dtrtri(factor[0], lower=1)  # squares add up to the trace wanted
    unknowns = len(inverse) - float(np.sum(np.tril(inverse) ** 2)) / PRIOR_SIGMA**2
    return float(np.sum(weight > 0)) - unknowns


def solve(rows: Rows, design: Design, weight: Array | None = None) -> Fit:
    """Solve for columns, leaving out pieces far from the solution.

    Parameters
    ----------
    weight : ndarray, shape (r,), 1/m^2, optional
        As of another fit, so that both are judged alike; then nothing more is left out.
    """
    target = rows.deviation.ravel()
    given = weight is not None
    used = 1.0 / rows.sigma.ravel() ** 2 if weight is None else weight
    full = used
    for _ in range(1 if given else MAX_ITERATIONS):
        factor, value = _solve(design, target, used)
        residual = target - design.times(value)
        size = np.sqrt(full * residual**2).reshape(rows.deviation.shape)
        distance = np.linalg.norm(size, axis=0)
        far = distance > MAX_DEVIATION * float(np.median(distance)) / RAYLEIGH_MEDIAN
        now = full if given else np.where(np.tile(far, len(size)), 0.0, full)
        if np.array_equal(now > 0, used > 0):
            break
        used = now
    else:
        if not given:
            factor, value = _solve(design, target, used)
            residual = target - design.times(value)
    freedom = np.nan if given else _freedom(factor, used)
    return Fit(design, used, factor, value, np.asarray(residual), freedom)


MAX_PIECES = 10_000
"""Pieces that are used: of more, spread evenly, every second, third, ..."""
MAX_PIECES_OF_COMPARISON = 4000
"""The same where many models are compared."""


@dataclass(frozen=True)
class Model:
    """Runs, their rows and the fit of everything usual.

    Attributes
    ----------
    fit : Fit
        Pose of every run, tables, a constant reversal of every axis, a lag of every axis behind
        its speed and a slow drift of every pose: what these explain is no contradiction.
    """

    runs: tuple[Run, ...]
    rows: Rows
    fit: Fit

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Model:
        """Set up and solve."""
        rows = _thinned(build_rows(runs), MAX_PIECES)
        return cls(
            tuple(runs), rows, solve(rows, Design.of(rows, usual_columns(rows), rows.machines))
        )

    @cached_property
    def left_by_order(self) -> dict[tuple[str, ...], float]:
        """What every order of axes from workpiece to tool leaves, m, on the same pieces, thinned.

        Weighted root mean square of the residuals.
        """
        chosen = _spread(len(self.rows), MAX_PIECES_OF_COMPARISON)
        rows = self.rows.take(chosen)
        weight = self.fit.weight.reshape(len(rows.axes), -1)[:, chosen].ravel()
        usual, left = usual_columns(rows), {}
        for order in permutations(rows.machine.axis_names):
            machines = [replace(machine, chain=Chain((), order)) for machine in rows.machines]
            square = solve(rows, Design.of(rows, usual, machines), weight).square
            left[order] = float(np.sqrt(square / weight.sum()))
        return left


def _spread(count: int, enough: int) -> Index:
    """Places of some of many, spread evenly."""
    return np.arange(0, count, max(1, count // enough))


def _thinned(rows: Rows, enough: int) -> Rows:
    """Some of the rows; all, unless there are twice as many as are enough."""
    chosen = _spread(len(rows), enough)
    return rows if len(chosen) == len(rows) else rows.take(chosen)


def usual_columns(rows: Rows) -> Array:
    """Columns of what is usual and contradicts nothing, shape (c p, k)."""
    usual = (poses_by_run(rows), reversal_columns(rows), lag_columns(rows), drift_columns(rows))
    return np.concatenate(usual, axis=1)
