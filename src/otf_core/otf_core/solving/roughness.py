# SPDX-License-Identifier: Apache-2.0
"""How rough the error motions are, estimated from the data themselves.

Each motion is a draw of a Gaussian process in x, the axis position scaled to [0, 1]:

    f = a + b x + g(x) + w(x),    cov g = s^2 exp(-(x - x')^2 / (2 l^2)),    w: integrated Wiener

g is smooth with waves of the length l, w of intensity k leaves room for kinks; a and b are free.
The logarithms of (s^2, l, k) of every motion maximise the restricted likelihood of the data (the
tables, poses and squareness errors integrated out), with the motions of one unit weakly drawn to
their median. For the covariance K of the coefficients c of a motion, E = K^-1 dK K^-1, the
posterior covariance V and D = K - V (block by block, -V between motions)

    score = (c^T E c - tr E D) / 2,    information = tr(E_i D E_j D) / 2

What the estimated roughness leaves uncertain is passed on: a step of one of the logarithms moves
the estimates by V E c.

References
----------
Rasmussen and Williams, Gaussian Processes for Machine Learning, MIT Press 2006, sections 2.7, 4.2,
5.4. Wahba, Spline Models for Observational Data, SIAM 1990, chapter 1 (integrated Wiener process).
Harville, J. Am. Stat. Assoc. 72 (1977) 320 (restricted likelihood). Wood, Pya and Saefken, J. Am.
Stat. Assoc. 111 (2016) 1548, section 4 (uncertainty of smoothing parameters).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from otf_core.arrays import Array
from otf_core.model.motions import ErrorMotion, is_motion, unit_of
from otf_core.solving.normal import NormalEquations
from otf_core.solving.solution import Positive
from otf_core.solving.unknowns import Basis, Unknowns, reference_position

USUAL_WAVES = 0.15
"""Length l of the waves of a usual motion, as a share of the range."""
START = (np.log(0.1), np.log(USUAL_WAVES), np.log(0.01))
"""Logarithms of s^2 and k in units of the squared limit, and of l, to start from."""
SIGMA_ABOUT_MEDIAN = (3.0, 1.0, 3.0)
"""Standard deviation of these logarithms about the median of the motions of one unit."""
LOWER_BOUNDS = (-16.0, np.log(0.03), -18.0)
UPPER_BOUNDS = (8.0, np.log(3.0), 8.0)
SLOPE = 10.0
"""Standard deviation of the free slope over the range, in units of the limit: hardly any prior."""
IN_A_VECTOR = 12
"""Motions that an error vector is the sum of: a translation and levered rotations a component."""
JITTER = 1e-10
"""Independent variance of the coefficients, in units of the squared limit: numerical rank."""
TRACE = 1e-4
"""Weight of the size of values without a prior, in units of 1 / limit^2."""
MAX_STEPS = 30
MIN_GAIN = 0.1
"""Gain in log likelihood below which the search ends."""
MAX_STEP = 2.0
SHORTEST_SHARE = 0.01


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


def kernel(basis: Basis, logs: Array) -> tuple[Array, list[Array]]:
    """Covariance of g + w at the centres of a basis, and its derivatives by the logarithms."""
    low, high = basis.knots[0], basis.knots[-1]
    x = (basis.centres - low) / max(high - low, 1e-12)
    if basis.periodic:
        return _periodic_kernel(np.abs(x[:, None] - x), logs)
    apart = np.square((x[:, None] - x) / np.exp(logs[1]))
    smooth = np.exp(logs[0] - 0.5 * apart)
    first, last = np.minimum(x[:, None], x), np.maximum(x[:, None], x)
    kinks = np.exp(logs[2]) * (first**2 * last / 2.0 - first**3 / 6.0)
    return smooth + kinks, [smooth, smooth * apart, kinks]


def _periodic_kernel(apart: Array, logs: Array) -> tuple[Array, list[Array]]:
    """The same on a circle, by distances (n, n) in turns: chords, and periodic splines.

    The kernel of the latter is -B4(d) / 24 with the fourth Bernoulli polynomial (Wahba, 2.1).
    """
    chord = np.square(np.sin(np.pi * apart) / np.pi / np.exp(logs[1]))
    smooth = np.exp(logs[0] - 0.5 * chord)
    fourth = apart**4 - 2.0 * apart**3 + apart**2 - 1.0 / 30.0
    kinks = np.exp(logs[2]) * (-fourth / 24.0)
    return smooth + kinks, [smooth, smooth * chord, kinks]


class CoefficientPrior:
    """Covariance of the free coefficients of one motion, in units of the squared limit."""

    def __init__(self, motion: ErrorMotion, basis: Basis, slope_size: float = SLOPE) -> None:
        self.basis, size = basis, basis.size
        low, high = basis.knots[0], basis.knots[-1]
        x = (basis.centres - low) / max(high - low, 1e-12)
        gauge = np.eye(size)
        if motion.is_straightness:  # less the line through both ends
            gauge[:, 0] -= 1.0 - x
            gauge[:, -1] -= x
            free = np.arange(1, size - 1)
        else:  # less the value at the reference
            at = basis.matrix(np.array([reference_position(low, high)]))[0]
            gauge -= at
            free = np.delete(np.arange(size), np.argmax(at))
        self._map = (gauge @ basis.from_values)[free]
        slope = gauge[free] @ x
        self._fixed = JITTER * np.eye(len(free))
        if not motion.is_straightness and not basis.periodic:
            self._fixed += slope_size**2 * np.outer(slope, slope)

    def at(self, logs: Array) -> tuple[Array, list[Array]]:
        """Covariance, shape (free, free), and its derivatives by the logarithms."""
        total, parts = kernel(self.basis, logs)
        own = self._map @ total @ self._map.T + self._fixed
        own += 1e-9 * np.exp(logs[0]) * np.eye(len(own))
        return own, [self._map @ part @ self._map.T for part in parts]


class _Point:
    """Everything at one choice of the logarithms."""

    def __init__(self, search: Search, logs: Mapping[str, Array]) -> None:
        self.logs, self._search = logs, search
        self.covariance: dict[str, Array] = {}
        self.inverse: dict[str, Array] = {}
        self.changes: dict[str, list[Array]] = {}
        prior, log_prior = search.ridge.copy(), 0.0
        for motion, place in search.places.items():
            own, self.changes[motion] = search.priors[motion].at(logs[motion])
            factor = Positive(own)
            log_prior += factor.log_determinant
            self.covariance[motion] = own
            self.inverse[motion] = factor.inverse
            prior[place, place] += self.inverse[motion]
        self.prior = prior
        self.factor = Positive(search.matrix + prior)
        self.value = self.factor.solve(search.right)
        self.square = search.square - float(search.right @ self.value)
        self.likelihood = -0.5 * (self.square + self.factor.log_determinant + log_prior)

    def penalised(self, centres: Mapping[str, Array]) -> float:
        """Log likelihood less the price of logarithms away from the others."""
        away = [(self.logs[m] - centres[m]) / SIGMA_ABOUT_MEDIAN for m in self.logs]
        return self.likelihood - 0.5 * float(np.sum(np.square(away)))

    def slopes(self, centres: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """Score (j,), information (j, j), and moves V E c (use, j) of all logarithms."""
        places, V = self._search.places, self.factor.inverse
        count, width = len(places), len(START)
        D = -V
        for motion, place in places.items():
            D[place, place] += self.covariance[motion]
        score, moves, products = [], [], []
        for motion, place in places.items():
            inverse, own = self.inverse[motion], self.value[place]
            away = (self.logs[motion] - centres[motion]) / np.square(SIGMA_ABOUT_MEDIAN)
            E = inverse @ np.stack(self.changes[motion]) @ inverse
            traces = np.sum(E * D[place, place], axis=(1, 2))
            score.append(0.5 * (E @ own @ own - traces) - away)
            moves.append(V[:, place] @ (E @ own).T)
            products.append((E.reshape(-1, len(own)) @ D[place]).reshape(width, len(own), -1))
        # tr(E_i D_ij E_j D_ji): both factors are one product, the second by symmetry
        shared = np.empty((count, width, count, width))
        for (i, one), (j, other) in combinations_with_replacement(enumerate(places.values()), 2):
            first, second = products[i][:, :, other], products[j][:, :, one]
            traces = first.reshape(width, -1) @ np.swapaxes(second, 1, 2).reshape(width, -1).T
            shared[i, :, j], shared[j, :, i] = 0.5 * traces, 0.5 * traces.T
        information = shared.reshape(count * width, -1)
        information = information + np.diag(np.tile(1.0 / np.square(SIGMA_ABOUT_MEDIAN), count))
        return np.concatenate(score), information, np.concatenate(moves, axis=1)


class Search:
    """Search for the roughness that makes the data most likely.

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
        spans = [unknowns.free_blocks[name] for name in accepted]
        self.use = np.concatenate([np.arange(s.start, s.stop) for s in spans])
        ends = np.cumsum([s.stop - s.start for s in spans]).tolist()
        self.places: dict[str, slice] = {}
        self.priors: dict[str, CoefficientPrior] = {}
        for name, span, end in zip(accepted, spans, ends, strict=True):
            if is_motion(name) and span.stop > span.start:  # two nodes leave no straightness
                motion = ErrorMotion.of(name)
                self.places[name] = slice(end - (span.stop - span.start), end)
                self.priors[name] = CoefficientPrior(motion, unknowns.bases[motion.axis])
        self.matrix = normal.matrix[np.ix_(self.use, self.use)] * limit**2
        self.right = normal.right[self.use] * limit
        self.square, self.limit, self.free = normal.square, limit, unknowns.free
        loose = np.full(len(self.use), TRACE)
        for place in self.places.values():
            loose[place] = 0.0
        self.ridge = np.diag(loose)

    def _moved(self, logs: Mapping[str, Array], step: Array) -> dict[str, Array]:
        parts = step.reshape(-1, len(START))
        return {
            m: np.clip(logs[m] + part, LOWER_BOUNDS, UPPER_BOUNDS)
            for m, part in zip(self.places, parts, strict=True)
        }

    def run(self, start: Mapping[str, Array] | None = None) -> Roughness:
        """Climb by Fisher scoring.

        Parameters
        ----------
        start : mapping of motion to ndarray, optional
            Logarithms to start from.
        """
        start = start or {}
        point = _Point(self, {m: start.get(m, np.array(START)) for m in self.places})
        if not self.places:
            return self._answer(point, np.zeros((len(self.use), 0)))
        for _ in range(MAX_STEPS):
            centres = _centres(point.logs)
            score, information, _ = point.slopes(centres)
            step = np.asarray(np.linalg.solve(information, score), dtype=float)
            step *= min(1.0, MAX_STEP / float(np.abs(step).max()))
            best, share = point.penalised(centres), 1.0
            after = _Point(self, self._moved(point.logs, step))
            while after.penalised(centres) < best and share > SHORTEST_SHARE:
                share *= 0.3
                after = _Point(self, self._moved(point.logs, share * step))
            gain = after.penalised(centres) - best
            if gain > 0.0:
                point = after
            if gain < MIN_GAIN:
                break
        _, information, moves = point.slopes(_centres(point.logs))
        root = np.linalg.cholesky(np.linalg.inv(information))
        return self._answer(point, moves @ root)

    def _answer(self, point: _Point, drawn: Array) -> Roughness:
        precision = np.zeros((self.free, self.free))
        precision[np.ix_(self.use, self.use)] = point.prior / self.limit**2
        moved = np.zeros((self.free, drawn.shape[1]))
        moved[self.use] = drawn * self.limit
        return Roughness(point.logs, precision, moved, point.likelihood, point.square)


def _of_unit(unit: str, logs: Mapping[str, Array]) -> list[Array]:
    """Logarithms of the motions that have a unit."""
    return [own for motion, own in logs.items() if unit_of(motion) == unit]


def _centres(logs: Mapping[str, Array]) -> dict[str, Array]:
    """Median of the logarithms of the motions of one unit, for each motion."""
    units = {motion: unit_of(motion) for motion in logs}
    middle = {u: np.median(_of_unit(u, logs), axis=0) for u in set(units.values())}
    return {motion: middle[unit] for motion, unit in units.items()}


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
    return Positive(CoefficientPrior(motion, basis).at(np.median(like, axis=0))[0]).inverse


def expected_precision(
    unknowns: Unknowns, limit: float, size: float, waves: float = USUAL_WAVES
) -> Array:
    """Precision of the free unknowns for motions of a usual smoothness, before any data.

    Parameters
    ----------
    limit : float
        m and rad.
    size : float
        m; mean volumetric error. It is the length of a vector of three sums of some four motions
        of one size, which is the standard deviation of a motion (m and rad) and half of that of
        its slope over the range.
    waves : float
        Length of the waves, as a share of the range.

    Returns
    -------
    ndarray, shape (free, free), 1 / (m, rad)^2
    """
    precision = TRACE * np.eye(unknowns.free)
    size = size / np.sqrt(IN_A_VECTOR)
    own = 2.0 * np.log(size / limit)
    logs = np.array([own, np.log(waves), own + START[2] - START[0]])
    for motion, part in unknowns.free_blocks.items():
        if not isinstance(motion, ErrorMotion):
            continue
        if part.stop > part.start:
            usual = CoefficientPrior(motion, unknowns.bases[motion.axis], 2.0 * size / limit)
            covariance = usual.at(logs)[0]
            precision[part, part] = Positive(covariance).inverse
    return np.asarray(precision / limit**2)
