# SPDX-License-Identifier: Apache-2.0
"""Error motions as splines of an axis position: gauge, prior, tables; formulation.md, 9 and 12.

Degree 1 is a table: the coefficients are the values at the knots.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from certified.exact_chain import AXES, MOTIONS, influences

LIMIT = 1e-4
"""m or rad; what is more uncertain counts as not determined."""
LOOSE = 1e-2
"""m or rad; standard deviation of poses and squareness before any data."""
BEND, SIZE = 1e-3, 1e-2
"""m or rad; of second differences and of values, where no roughness is used."""

JITTER = (1e-18, 1e-9)
"""Independent variance of the coefficients: m^2 or rad^2, and as a share of that of the waves."""
SLOPE = 1e-3
"""m or rad; standard deviation of the slope over the range, of what is no straightness."""


def splines(knots, degree, q):
    """Values (n, k) of all B-splines at q (n,), by the recursion of Cox and de Boor."""
    t = np.concatenate([knots[:1].repeat(degree), knots, knots[-1:].repeat(degree)])
    last = degree + len(knots) - 2
    interval = np.clip(np.searchsorted(t, q, side='right') - 1, degree, last)
    found = (interval[:, None] == np.arange(len(t) - 1)).astype(float)
    for d in range(1, degree + 1):
        rise, fall = t[d:-1] - t[: -d - 1], t[d + 1 :] - t[1:-d]
        up = (q[:, None] - t[: -d - 1]) / np.where(rise > 0, rise, 1.0) * found[:, :-1]
        down = (t[d + 1 :] - q[:, None]) / np.where(fall > 0, fall, 1.0) * found[:, 1:]
        found = up + down
    return found


@dataclass(frozen=True)
class Motion:
    """One error motion: its name, the index of its axis, knots (k,) in m, degree."""

    name: str
    axis: int
    knots: np.ndarray
    degree: int

    @property
    def straightness(self):
        """Tell whether it is a translation across its own axis."""
        return self.name[1] in 'XYZ' and self.name[1] != self.name[2]

    def at(self, q):
        """Values (n, size) of all splines at positions q (n,)."""
        return splines(self.knots, self.degree, np.clip(q, self.knots[0], self.knots[-1]))

    @cached_property
    def places(self):
        """Means of the inner knots of every spline (Greville), shape (size,), m."""
        t = np.pad(self.knots, self.degree, mode='edge')
        size = len(self.knots) + self.degree - 1
        return np.array([t[k + 1 : k + self.degree + 1].mean() for k in range(size)])

    @cached_property
    def reference(self):
        """Values (size,) of all splines where the motion is zero: at zero, else at the minimum."""
        low, high = self.knots[[0, -1]]
        return self.at(np.array([0.0 if low <= 0.0 <= high else low]))[0]

    @cached_property
    def gauge(self):
        """All coefficients from those that the gauge leaves free, (size, free)."""
        columns = np.eye(len(self.places))
        if self.straightness:
            return columns[:, 1:-1]
        dropped = np.argmax(self.reference)
        columns[dropped] = -self.reference / self.reference[dropped]
        return np.delete(columns, dropped, axis=1)

    @cached_property
    def _of_process(self):
        """Free coefficients from values at the places, in the gauge; and those of the slope."""
        x = (self.places - self.knots[0]) / (self.knots[-1] - self.knots[0])
        less = np.eye(len(x))
        if self.straightness:
            less[:, 0] -= 1.0 - x
            less[:, -1] -= x
            kept = np.arange(1, len(x) - 1)
        else:
            less -= self.reference
            kept = np.delete(np.arange(len(x)), np.argmax(self.reference))
        return (less @ np.linalg.inv(self.at(self.places)))[kept], (less @ x)[kept]

    def process(self, variance, length, kinks):
        """Covariance of the free coefficients that a Gaussian process makes.

        variance * exp(-(x - x')^2 / (2 length^2)) + kinks * (integrated Wiener process), x from
        0 to 1; and its derivatives by the logarithms of the three, (3, free, free).
        """
        x = (self.places - self.knots[0]) / (self.knots[-1] - self.knots[0])
        far = ((x[:, None] - x) / length) ** 2
        waves = variance * np.exp(-0.5 * far)
        a, b = np.minimum(x[:, None], x), np.maximum(x[:, None], x)
        wiener = kinks * (a**2 * b / 2 - a**3 / 6)
        inner, slope = self._of_process
        covariance = inner @ (waves + wiener) @ inner.T
        covariance += (JITTER[0] + JITTER[1] * variance) * np.eye(len(inner))
        if not self.straightness:
            covariance += SLOPE**2 * np.outer(slope, slope)
        return covariance, np.stack([inner @ d @ inner.T for d in (waves, waves * far, wiener)])

    def table(self, nodes):
        """Values at nodes (m,) of the nearest table in the gauge, from all coefficients."""
        hats = Motion(self.name, self.axis, nodes, 1)
        ends = np.unique(np.concatenate([self.knots, nodes]))
        points, weights = np.polynomial.legendre.leggauss(5)
        half = 0.5 * np.diff(ends)[:, None]
        q, root = (ends[:-1, None] + half * (1 + points)).ravel(), np.sqrt(half * weights).ravel()
        own, wanted = hats.at(q) @ hats.gauge, self.at(q)
        return (
            hats.gauge
            @ np.linalg.lstsq(root[:, None] * own, root[:, None] * wanted, rcond=None)[0]
        )


def block_diagonal(blocks):
    """Matrices (a, b) along the diagonal of one."""
    ends = np.cumsum([(0, 0)] + [b.shape for b in blocks], axis=0)
    whole = np.zeros(ends[-1])
    for block, (i, j) in zip(blocks, ends[:-1], strict=True):
        whole[i : i + block.shape[0], j : j + block.shape[1]] = block
    return whole


class ErrorModel:
    """What rows are made of: pose, squareness and the motions that one target offset shows.

    The free values are six of the pose, three of squareness and those of the motions.
    ``knots``: of X, Y, Z.
    """

    def __init__(self, run, knots, degree):
        self.machine = run['machine']
        seen = [m for m in MOTIONS if m not in run['not_identifiable']]
        self.motions = [Motion(m, AXES.index(m[2]), knots[AXES.index(m[2])], degree) for m in seen]
        self.gauge = block_diagonal([np.eye(9), *(m.gauge for m in self.motions)])
        ends = 9 + np.cumsum([0] + [m.gauge.shape[1] for m in self.motions])
        self.places = [slice(a, b) for a, b in pairwise(ends)]

    def columns(self, q, influence):
        """Columns (n, full - 6) of all errors for influences (n, 21) at positions q (n, 3)."""
        parts = [influence[:, 18:]]
        for m in self.motions:
            parts.append(influence[:, MOTIONS.index(m.name), None] * m.at(q[:, m.axis]))
        return np.concatenate(parts, axis=1)

    def design(self, rows):
        """Derivatives of the rows by the free values, (r, free)."""
        ends = [self.columns(q, part) for q, part in zip(rows.q, rows.influence, strict=True)]
        return np.concatenate([rows.pose, 0.5 * (ends[0] + ends[1])], axis=1) @ self.gauge

    def coefficient_rows(self, q):
        """Derivatives of the error vectors at q (n, 3) by all but the pose, (n, 3, full - 6)."""
        parts = influences(self.machine['chain'], np.array(self.machine['target_offset']), q)
        return np.stack([self.columns(q, parts[:, k]) for k in range(3)], axis=1)

    def error_rows(self, q):
        """Derivatives of the error vectors at q (n, 3) by the free values, (n, 3, free)."""
        return self.coefficient_rows(q) @ self.gauge[6:]

    def prior(self, roughness):
        """Root L of the inverse covariance L'L of all free values before any data."""
        own = [np.linalg.cholesky(m.process(*roughness[m.name])[0]) for m in self.motions]
        return block_diagonal([np.eye(9) / LOOSE, *(np.linalg.inv(root) for root in own)])

    def prior_changes(self, roughness):
        """Derivatives of that covariance by the logarithms of the roughness: (place, matrix)."""
        return [
            (place, change)
            for motion, place in zip(self.motions, self.places, strict=True)
            for change in motion.process(*roughness[motion.name])[1]
        ]

    def tie_breaker(self):
        """Root of the inverse covariance where no roughness is used: second differences, size."""
        bends = [np.diff(m.gauge, 2, axis=0) / BEND for m in self.motions]
        size = np.eye(self.gauge.shape[1]) / SIZE
        return np.concatenate([block_diagonal([np.zeros((0, 9)), *bends]), size])

    def tables(self, nodes):
        """Values at the nodes of X, Y, Z from the free values, (nodes, free) for every motion."""
        free = np.eye(self.gauge.shape[1])
        return [
            m.table(nodes[m.axis]) @ m.gauge @ free[place]
            for m, place in zip(self.motions, self.places, strict=True)
        ]
