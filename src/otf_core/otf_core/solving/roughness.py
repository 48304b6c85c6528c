# SPDX-License-Identifier: Apache-2.0
"""How rough the error motions are, estimated from the data themselves.

Each motion is a draw of a Gaussian process in x, the axis position scaled to [0, 1]:

    f = a + b x + g(x) + w(x),    cov g = s^2 exp(-(x - x')^2 / (2 l^2)),    w: integrated Wiener

g is smooth with waves of the length l, w of intensity k leaves room for kinks; a and b are free.
The logarithms h of (s^2, l, k) of every motion maximise the restricted likelihood of the data (the
tables, poses and squareness errors integrated out), with the motions of one unit weakly drawn to
their mean, and that to a usual value. With the covariance K of the coefficients c of a motion, its
derivatives K_i and K_ij, E_i = K^-1 K_i K^-1, the posterior covariance V, D = K - V and a = K^-1 c

    g_i  = (c' E_i c - tr E_i D) / 2
    H_ij = c' E_i V E_j c + tr(E_i V E_j V) / 2,    of one motion also
           (a' K_ij a - tr(K^-1 K_ij K^-1 D)) / 2 - a' K_i K^-1 K_j a
           + tr(K^-1 K_i E_j D) - tr(K^-1 K_i K^-1 K_j) / 2
    information = tr(E_i V E_j V) / 2,  of one motion  tr(E_i D E_j D) / 2

are gradient and Hessian, and the expectation of -H. Newton steps along the eigenvectors of H,
each divided by the size of its eigenvalue, lead upwards from anywhere and converge quadratically.
Smooth waves or kinks may explain a motion about equally well, with an ascent to each: so every
motion is tried elsewhere as well, with all others as they are.

What the estimated roughness leaves uncertain is passed on: a step of one of the logarithms moves
the estimates by V E c.

References
----------
Rasmussen and Williams, Gaussian Processes for Machine Learning, MIT Press 2006, sections 2.7, 4.2,
5.4. Wahba, Spline Models for Observational Data, SIAM 1990, chapter 1 (integrated Wiener process).
Harville, J. Am. Stat. Assoc. 72 (1977) 320 (restricted likelihood). Wood, Pya and Saefken, J. Am.
Stat. Assoc. 111 (2016) 1548, sections 3 and 4 (Newton steps; uncertainty of smoothing parameters).
Dauphin et al., Advances in Neural Information Processing Systems 27 (2014) 2933 (saddles).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from otf_core.arrays import Array
from otf_core.model.motions import ErrorMotion, is_motion, unit_of
from otf_core.solving.normal import NormalEquations
from otf_core.solving.solution import RIDGES, Positive
from otf_core.solving.unknowns import Basis, Unknowns, reference_position

START = np.array([np.log(0.1), np.log(0.15), np.log(0.01)])
"""Usual logarithms: of s^2 and k in units of the squared limit, and of l."""
SIGMA = np.array([3.0, 1.0, 3.0])
"""Standard deviation of these about the mean of the motions of one unit, and of that mean."""
LOWER_BOUNDS = np.array([-16.0, np.log(0.03), -18.0])
UPPER_BOUNDS = np.array([8.0, np.log(3.0), 8.0])
ELSEWHERE = np.array([[2.0, 0.0, -6.0], [-6.0, 0.0, 2.0], [2.0, -1.0, -6.0]])
"""Waves, kinks and short waves, to start from beside what the other motions let expect."""
SLOPE = 10.0
"""Standard deviation of the free slope over the range, in units of the limit: hardly any prior."""
IN_A_VECTOR = 12
"""Motions that an error vector is the sum of: a translation and levered rotations a component."""
JITTER = 1e-10
"""Independent variance of the coefficients, in units of the squared limit: numerical rank."""
SHARE_OF_JITTER = 1e-9
"""The same as a share of s^2."""
TRACE = 1e-4
"""Weight of the size of values without a prior, in units of 1 / limit^2."""
MAX_STEPS = 60
MIN_GAIN = 1e-5
"""Gain of a step below which an ascent ends: a step of it moves estimates by u / 200 at most."""
MIN_GAIN_ELSEWHERE = 0.01
"""Gain for which a motion goes elsewhere."""
MAX_STEP = 2.0
MIN_CURVATURE = 0.05
"""Of the criterion, for steps along what hardly matters."""
SHORTEST_SHARE = 1e-3
STEPS_ELSEWHERE = 12


@dataclass(frozen=True)
class Roughness:
    """Roughness of the motions and the prior it makes.

    Attributes
    ----------
    logs : mapping of motion to ndarray, shape (3,)
        Logarithms of s^2 and k, in units of the squared limit, and of l.
    precision : ndarray, shape (free, free), 1 / (m, rad)^2
        Inverse covariance of the free unknowns before any data; next to nothing where nothing
        is known of them.
    drawn : ndarray, shape (free, k), m and rad
        What the uncertainty of the roughness does to the estimates: their covariance gains
        drawn @ drawn.T.
    log_likelihood : float
        Restricted, up to a constant of the rows and of the number of free unknowns.
    square : float
        Weighted sum of squares of what is left, what the prior costs included.
    """

    logs: Mapping[str, Array]
    precision: Array
    drawn: Array
    log_likelihood: float
    square: float


def kernel_parts(basis: Basis) -> tuple[Array, Array]:
    """Squared distances of the centres of a basis in x, and covariance of w for k = 1, (n, n).

    On a circle the distances are chords, and the kernel of periodic splines is -B4(d) / 24 with
    the fourth Bernoulli polynomial of the distance in turns (Wahba, 2.1).
    """
    low, high = basis.knots[0], basis.knots[-1]
    x = (basis.centres - low) / max(high - low, 1e-12)
    if basis.periodic:
        apart = np.abs(x[:, None] - x)
        fourth = apart**4 - 2.0 * apart**3 + apart**2 - 1.0 / 30.0
        return np.square(np.sin(np.pi * apart) / np.pi), -fourth / 24.0
    first, last = np.minimum(x[:, None], x), np.maximum(x[:, None], x)
    return np.square(x[:, None] - x), first**2 * last / 2.0 - first**3 / 6.0


def _coefficient_map(motion: ErrorMotion, basis: Basis) -> tuple[Array, Array]:
    """Free coefficients of the values at the centres, (free, n), and those of a slope of 1."""
    low, high = basis.knots[0], basis.knots[-1]
    x = (basis.centres - low) / max(high - low, 1e-12)
    gauge = np.eye(basis.size)
    if motion.is_straightness:  # less the line through both ends
        gauge[:, 0] -= 1.0 - x
        gauge[:, -1] -= x
        free = np.arange(1, basis.size - 1)
        return (gauge @ basis.from_values)[free], np.zeros(len(free))
    at = basis.matrix(np.array([reference_position(low, high)]))[0]
    gauge -= at  # less the value at the reference
    free = np.delete(np.arange(basis.size), np.argmax(at))
    slope = np.zeros(len(free)) if basis.periodic else gauge[free] @ x
    return (gauge @ basis.from_values)[free], slope


class CoefficientPriors:
    """Covariances of the free coefficients of motions, in units of the squared limit.

    All have the size of the largest; what fills up a smaller one has the variance 1.
    """

    def __init__(
        self, motions: Sequence[tuple[ErrorMotion, Basis]], slope_size: float = SLOPE
    ) -> None:
        maps = [_coefficient_map(*of) for of in motions]
        parts = [kernel_parts(basis) for _, basis in motions]
        self.sizes = [len(own) for own, _ in maps]
        count, n = len(maps), max(self.sizes, default=0)
        centres = max((len(squared) for squared, _ in parts), default=0)
        self._map = np.zeros((count, 1, n, centres))
        self._squared = np.zeros((count, centres, centres))
        self._kinks, self._fixed = np.zeros((count, n, n)), np.zeros((count, n, n))
        self._nugget = np.zeros((count, n, n))
        for k, ((own, slope), (squared, kinks)) in enumerate(zip(maps, parts, strict=True)):
            free, size = own.shape
            self._map[k, 0, :free, :size], self._squared[k, :size, :size] = own, squared
            self._kinks[k, :free, :free] = own @ kinks @ own.T
            diagonal = np.where(np.arange(n) < free, JITTER, 1.0)
            self._fixed[k] = np.diag(diagonal)
            self._fixed[k, :free, :free] += slope_size**2 * np.outer(slope, slope)
            self._nugget[k, range(free), range(free)] = SHARE_OF_JITTER

    def at(self, logs: Array) -> tuple[Array, Array]:
        """Covariances (..., m, n, n) at logarithms (..., m, 3), and their derivatives.

        The latter, (..., m, 4, n, n), are by log s^2, by log l, by log l twice and by log k.
        Mixed ones by log s^2 and by log l are those by log l, others by log k are zero.
        """
        size, length, kinks = np.moveaxis(np.exp(logs), -1, 0)[..., None, None]
        apart = self._squared / length**2
        waves = size * np.exp(-0.5 * apart)
        waves = np.stack([waves, waves * apart, waves * apart * (apart - 2.0)], axis=-3)
        smooth = self._map @ waves @ np.swapaxes(self._map, -1, -2)
        smooth[..., 0, :, :] += size * self._nugget
        kinked = kinks * self._kinks
        total = smooth[..., 0, :, :] + kinked + self._fixed
        return total, np.concatenate([smooth, kinked[..., None, :, :]], axis=-3)


def _invert(matrix: Array) -> tuple[Array, Array]:
    """Inverses of positive definite matrices (..., n, n), logarithms of their determinants."""
    scale = 1.0 / np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    unit = matrix * (scale[..., :, None] * scale[..., None, :])
    root = _root(unit)
    half = np.linalg.inv(root) * scale[..., None, :]
    sizes = np.log(np.diagonal(root, axis1=-2, axis2=-1)) - np.log(scale)
    return np.swapaxes(half, -1, -2) @ half, 2.0 * np.sum(sizes, axis=-1)


def _root(unit: Array) -> Array:
    """Cholesky factors of matrices with diagonals of ones, as of ``solution.Positive``."""
    for ridge in RIDGES[:-1]:
        with suppress(np.linalg.LinAlgError):
            return np.asarray(np.linalg.cholesky(unit + ridge * np.eye(unit.shape[-1])), float)
    return np.asarray(np.linalg.cholesky(unit + RIDGES[-1] * np.eye(unit.shape[-1])), float)


class _Derivatives:
    """Of the likelihood by the logarithms of motions one by one: see the head of the module.

    Parameters
    ----------
    K, inverse : ndarray, shape (..., m, n, n)
    parts : ndarray, shape (..., m, 4, n, n)
        As of ``CoefficientPriors.at``.
    V, c : ndarray, shapes (..., m, n, n) and (..., m, n)
    """

    def __init__(self, K: Array, inverse: Array, parts: Array, V: Array, c: Array) -> None:
        first, one = parts[..., [0, 1, 3], :, :], inverse[..., None, :, :]
        a, D, self._V = (inverse @ c[..., None])[..., 0], K - V, V
        Ka = (first @ a[..., None, :, None])[..., 0]
        self.pulls = Ka @ inverse
        """E c as rows, shape (..., m, 3, n)."""
        share = one @ first
        self.E = share @ one
        ED = self.E @ D[..., None, :, :]
        square = (Ka @ a[..., None])[..., 0]
        self.score = 0.5 * (square - np.trace(ED, axis1=-2, axis2=-1))
        self.information = 0.5 * _traces(ED, ED)
        bent = a[..., :, None] * a[..., None, :] - inverse @ D @ inverse
        second = 0.5 * np.sum(parts * bent[..., None, :, :], axis=(-2, -1))
        self.own = _traces(share, ED - 0.5 * share) - self.pulls @ np.swapaxes(Ka, -1, -2)
        """What only the Hessian of one motion has, shape (..., m, 3, 3)."""
        for i, j, k in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2), (2, 2, 3)):
            self.own[..., i, j] += second[..., k]

    @property
    def hessian(self) -> Array:
        """Of every motion with all others as they are, shape (..., m, 3, 3)."""
        EV = self.E @ self._V[..., None, :, :]
        moves = self.pulls @ self._V @ np.swapaxes(self.pulls, -1, -2)
        return np.asarray(self.own + moves + 0.5 * _traces(EV, EV))


def _traces(first: Array, second: Array) -> Array:
    """Traces (..., i, j) of the products of matrices (..., i, n, n) and (..., j, n, n)."""
    return np.asarray(np.einsum('...imn,...jnm->...ij', first, second))


def _uphill(logs: Array, gradient: Array, hessian: Array) -> Array:
    """Newton steps (..., j) that lead upwards whatever the curvature, within the bounds."""
    outwards = gradient.reshape(logs.shape)
    held = np.where(outwards < 0.0, logs <= LOWER_BOUNDS, logs >= UPPER_BOUNDS)
    free = 1.0 - held.reshape(gradient.shape)
    value, vectors = np.linalg.eigh(hessian * free[..., None] * free[..., None, :])
    along = np.swapaxes(vectors, -1, -2) @ (gradient * free)[..., None]
    along /= np.maximum(np.abs(value), MIN_CURVATURE)[..., None]
    return np.asarray((vectors @ along)[..., 0])


def _moved(logs: Array, step: Array) -> Array:
    return np.clip(logs + step, LOWER_BOUNDS, UPPER_BOUNDS)


class _Point:
    """Everything at one choice of the logarithms, shape (m, 3)."""

    def __init__(self, search: Search, logs: Array) -> None:
        self.logs, self._search = logs, search
        self._covariance, self._parts = search.priors.at(logs)
        self.inverse, sizes = _invert(self._covariance)
        self.prior = search.ridge.copy()
        for place, inverse in zip(search.places, self.inverse, strict=True):
            self.prior[place, place] = inverse
        self._factor = Positive(search.matrix + self.prior)
        self.value = self._factor.solve(search.right)
        self.square = search.square - float(search.right @ self.value)
        size = self._factor.log_determinant + float(sizes.sum())
        self.likelihood = -0.5 * (self.square + size)
        self.pull = np.einsum('iajb,jb->ia', search.alike, logs - START)
        self.criterion = self.likelihood - 0.5 * float(np.sum((logs - START) * self.pull))

    @cached_property
    def posterior(self) -> Array:
        """V of everything solved for."""
        return self._factor.inverse

    @cached_property
    def of_motions(self) -> tuple[Array, Array]:
        """V of every motion, shape (m, n, n), and c, shape (m, n)."""
        V = np.stack([self.posterior[place, place] for place in self._search.places])
        return V, np.stack([self.value[place] for place in self._search.places])

    @cached_property
    def slopes(self) -> tuple[Array, Array, Array, Array]:
        """Gradient (j,), Hessian (j, j), information (j, j) and moves V E c (use, j)."""
        count, n = self._covariance.shape[:2]
        own = _Derivatives(self._covariance, self.inverse, self._parts, *self.of_motions)
        V, each, size = self.posterior, np.arange(count), 3 * count
        motions = slice(len(V) - count * n, None)
        spread = np.zeros((count, n, count, 3))
        spread[each, :, each] = np.swapaxes(own.pulls, 1, 2)
        pulls = spread.reshape(-1, size)
        moves = V[:, motions] @ pulls
        EV = own.E.reshape(count, -1, n) @ V[motions, motions].reshape(count, n, -1)
        EV = EV.reshape(count, 3, n, count, n)
        information = 0.5 * np.einsum('iambn,bjnim->iabj', EV, EV).reshape(count, 3, count, 3)
        hessian = information + (pulls.T @ moves[motions]).reshape(information.shape)
        hessian[each, :, each] += own.own
        information[each, :, each] = own.information
        alike = self._search.alike
        gradient = (own.score - self.pull).ravel()
        both = ((hessian - alike), (information + alike))
        return (gradient, *(m.reshape(size, size) for m in both), moves)


class Search:
    """Search for the roughness that makes the data most likely.

    Attributes
    ----------
    use : ndarray of int64, shape (k,)
        Places of what is solved for among the free unknowns: all others, then motion by motion.
    rows : ndarray of int64, shape (k,)
        Their places in here, where all motions have the size of the largest.
    places : list of slice
        Those of the motions.

    Parameters
    ----------
    accepted : sequence of str
        Blocks that are solved for.
    limit : float
        m and rad; the unit of all unknowns in here.
    """

    def __init__(
        self, normal: NormalEquations, unknowns: Unknowns, accepted: Sequence[str], limit: float
    ) -> None:
        blocks = unknowns.free_blocks
        seen = [n for n in accepted if blocks[n].stop > blocks[n].start]
        self.motions = [n for n in seen if is_motion(n)]  # two nodes leave no straightness
        others = [n for n in seen if n not in self.motions]
        self.use = np.concatenate(
            [np.arange(blocks[n].start, blocks[n].stop) for n in (*others, *self.motions)]
        )
        of = [ErrorMotion.of(n) for n in self.motions]
        self.priors = CoefficientPriors([(m, unknowns.bases[m.axis]) for m in of])
        sizes, first = self.priors.sizes, len(self.use) - sum(self.priors.sizes)
        n = max(sizes, default=0)
        self.places = [slice(first + k * n, first + (k + 1) * n) for k in range(len(of))]
        own = [np.arange(p.start, p.start + m) for p, m in zip(self.places, sizes, strict=True)]
        self.rows = np.concatenate([np.arange(first), *own])
        size = first + n * len(of)
        self.matrix, self.right = np.zeros((size, size)), np.zeros(size)
        place = np.ix_(self.rows, self.rows)
        self.matrix[place] = normal.matrix[np.ix_(self.use, self.use)] * limit**2
        self.right[self.rows] = normal.right[self.use] * limit
        self.square, self.limit, self.free = normal.square, limit, unknowns.free
        self.ridge = TRACE * np.eye(size)
        units = np.array([unit_of(m) for m in self.motions])
        spread = np.eye(len(of)) + (units[:, None] == units)
        self.alike = np.einsum('ij,ab->iajb', np.linalg.inv(spread), np.diag(1.0 / SIGMA**2))
        """Inverse covariance of all logarithms before the data, shape (m, 3, m, 3)."""

    def run(
        self, start: Mapping[str, Array] | None = None, *, everywhere: bool = True
    ) -> Roughness:
        """Climb, and look elsewhere.

        Parameters
        ----------
        start : mapping of motion to ndarray, optional
            Logarithms to start from.
        everywhere : bool
            Try every motion elsewhere; if not, the top next to the start is taken.
        """
        logs = [(start or {}).get(m, START) for m in self.motions]
        point = _Point(self, np.array(logs).reshape(-1, 3))
        if not self.places:
            return self._answer(point, np.zeros((len(self.right), 0)))
        point = self._climb(point)
        while everywhere and (other := self._elsewhere(point)) is not None:
            point = self._climb(other)
        _, _, information, moves = point.slopes
        root = np.linalg.cholesky(np.linalg.inv(information))
        return self._answer(point, moves @ root)

    def _climb(self, point: _Point) -> _Point:
        """Climb to a top."""
        for _ in range(MAX_STEPS):
            gradient, hessian, *_ = point.slopes
            step = _uphill(point.logs, gradient, hessian)
            if 0.5 * float(gradient @ step) < MIN_GAIN:
                break
            step = step.reshape(-1, 3) * min(1.0, MAX_STEP / float(np.abs(step).max()))
            share, after = 1.0, _Point(self, _moved(point.logs, step))
            while after.criterion < point.criterion and share > SHORTEST_SHARE:
                share *= 0.3
                after = _Point(self, _moved(point.logs, share * step))
            if after.criterion <= point.criterion:
                break
            point = after
        return point

    def _elsewhere(self, point: _Point) -> _Point | None:
        """A better point where some motions are elsewhere, all others as they are.

        For one motion alone all others act like data of the inverse covariance V^-1 - K^-1.
        """
        (V, c), each = point.of_motions, np.arange(len(self.motions))
        weight = _invert(V)[0]
        value, vectors = np.linalg.eigh(weight - point.inverse)
        data = vectors * np.maximum(value, 0.0)[:, None] @ np.swapaxes(vectors, 1, 2)
        right, alike = weight @ c[..., None], self.alike[each, :, each]
        # expected of the motion if all others are as they are
        mean = point.logs - np.linalg.solve(alike, point.pull[..., None])[..., 0]

        def at(logs: Array) -> tuple[Array, Array]:
            """Criterion (..., m) and Newton steps (..., m, 3)."""
            K, parts = self.priors.at(logs)
            inverse, size = _invert(K)
            V, whole = _invert(data + inverse)
            c = V @ right
            pull = (alike @ (logs - mean)[..., None])[..., 0]
            own = _Derivatives(K, inverse, parts, V, c[..., 0])
            step = _uphill(logs, own.score - pull, own.hessian - alike)
            longest = np.abs(step).max(axis=-1, keepdims=True)
            square = np.sum(right * c, axis=(-2, -1)) - np.sum(pull * (logs - mean), axis=-1)
            return 0.5 * (square - whole - size), step * np.minimum(1.0, MAX_STEP / longest)

        logs = _moved(mean, ELSEWHERE[:, None])
        best, step = at(logs)
        share = np.ones((*best.shape, 1))
        for _ in range(STEPS_ELSEWHERE):
            moved = _moved(logs, share * step)
            after, next_step = at(moved)
            better = (after > best)[..., None]
            logs, step = np.where(better, moved, logs), np.where(better, next_step, step)
            best, share = np.maximum(best, after), np.where(better, 1.0, 0.3 * share)
        top = np.argmax(best, axis=0)
        gain = best[top, each] - at(point.logs)[0]
        if gain.max() > MIN_GAIN_ELSEWHERE:
            for motions in (gain > MIN_GAIN_ELSEWHERE, gain == gain.max()):
                other = _Point(self, np.where(motions[:, None], logs[top, each], point.logs))
                if other.criterion > point.criterion:
                    return other
        return None

    def _answer(self, point: _Point, drawn: Array) -> Roughness:
        precision = np.zeros((self.free, self.free))
        prior = point.prior[np.ix_(self.rows, self.rows)]
        precision[np.ix_(self.use, self.use)] = prior / self.limit**2
        moved = np.zeros((self.free, drawn.shape[1]))
        moved[self.use] = drawn[self.rows] * self.limit
        logs = dict(zip(self.motions, point.logs, strict=True))
        return Roughness(logs, precision, moved, point.likelihood, point.square)


def _of_unit(unit: str, logs: Mapping[str, Array]) -> list[Array]:
    """Logarithms of the motions that have a unit."""
    return [own for motion, own in logs.items() if unit_of(motion) == unit]


def precision_like_others(
    motion: ErrorMotion, basis: Basis, logs: Mapping[str, Array]
) -> Array | None:
    """Precision of a motion that the data hardly determine: as rough as its like.

    Parameters
    ----------
    basis : Basis
        Of its axis.
    logs : mapping of motion to ndarray, shape (3,)
        Of the motions that the data determine, see ``Roughness``.

    Returns
    -------
    ndarray, shape (n, n), 1 / limit^2, or None
        Of its n free coefficients; None if no other motion of its unit is determined.
    """
    like = _of_unit(unit_of(motion), logs)
    if not like:
        return None
    covariance = CoefficientPriors([(motion, basis)]).at(np.median(like, axis=0)[None])[0][0]
    return Positive(covariance).inverse


def expected_precision(unknowns: Unknowns, limit: float, size: float) -> Array:
    """Precision of the free unknowns for motions of a usual smoothness, before any data.

    Parameters
    ----------
    limit : float
        m and rad.
    size : float
        m; mean volumetric error. It is the length of a vector of three sums of some four motions
        of one size, which is the standard deviation of a motion (m and rad) and half of that of
        its slope over the range.

    Returns
    -------
    ndarray, shape (free, free), 1 / (m, rad)^2
    """
    precision = TRACE * np.eye(unknowns.free)
    size = size / np.sqrt(IN_A_VECTOR)
    own = 2.0 * np.log(size / limit)
    logs = np.array([own, START[1], own + START[2] - START[0]])
    for motion, part in unknowns.free_blocks.items():
        if not isinstance(motion, ErrorMotion):
            continue
        if part.stop > part.start:
            own = [(motion, unknowns.bases[motion.axis])]
            covariance = CoefficientPriors(own, 2.0 * size / limit).at(logs[None])[0][0]
            precision[part, part] = Positive(covariance).inverse
    return np.asarray(precision / limit**2)


@dataclass(frozen=True)
class Waves:
    """Smoothness of one motion in units of its axis.

    Attributes
    ----------
    sd : float
        Size of the smooth part g, m or rad.
    length : float
        Length of its waves, m.
    intensity : float
        Of the second derivative of w, m^2/m^3 or rad^2/m^3.
    """

    sd: float
    length: float
    intensity: float


def waves_of(logs: Array, knots: Array, limit: float) -> Waves:
    """Smoothness of a motion over the range of its knots (k,), m, from its logarithms."""
    span = float(knots[-1] - knots[0])
    sizes = np.exp(logs)
    return Waves(
        float(limit * np.sqrt(sizes[0])),
        float(sizes[1] * span),
        float(limit**2 * sizes[2] / max(span, 1e-12) ** 3),
    )
