# SPDX-License-Identifier: Apache-2.0
"""Any course in time, by the products of piecewise linear functions of time.

They are tried as effects are, and never named: their products with each other and with the
residual hold those of every course in time, to the width of their nodes. So thousands of courses
are judged without a column of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.diagnosis.engine.effect_products import Tried, tried_shapes
from otf_core.diagnosis.engine.evidence import SPREADS
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.time_products import InTime
from otf_core.effects.action import Acting
from otf_core.effects.base import Effect, Shape, State

NEXT_TO_NOTHING = 1e-9
"""Share of a square that keeps a matrix positive definite."""
NODES = 64
"""Of the piecewise linear functions."""
FINE = 8 * NODES
"""Times at which a course is fitted by them."""


class CourseInTime(InTime):
    """Piecewise linear function of time times a way to act; never named."""

    name: ClassVar[str] = 'course_in_time'
    cause: ClassVar[str] = 'any'
    equation: ClassVar[str] = 'sum of c_jk h_k(t) A_j'
    typical: ClassVar[str] = 'any'
    source: ClassVar[str] = 'not of the catalogue'
    signature: ClassVar[str] = 'any course in time'
    needs: ClassVar[str] = ''
    heads: ClassVar[tuple[str, ...]] = tuple(f'H{k}' for k in range(NODES))

    def __init__(self, acts: Acting, drivers: Sequence[Effect]) -> None:
        self._acts, self.drivers = acts, tuple(drivers)

    @property
    def acts(self) -> Acting:
        """What the functions are multiplied with."""
        return self._acts

    def course(self, state: State, shape: Shape) -> Array:
        """Return one function for every node."""
        return _hats(state.time, state.end)


def _hats(time: Array, end: float) -> Array:
    """Piecewise linear functions, each one at its node and zero at all others, (n, NODES)."""
    nodes = np.linspace(0.0, end, NODES)
    return np.asarray(np.maximum(1.0 - np.abs(time[:, None] - nodes) / nodes[1], 0.0))


def courses_tried(rows: Rows, effects: Sequence[Effect]) -> dict[str, list[Tried]]:
    """Piecewise linear functions of time for every way to act in which effects may switch.

    Of one run alone: every run has moments of its own.
    """
    if len(rows.states) > 1 or not rows.states[0].end > 0.0:
        return {}
    ways = dict.fromkeys(acts for e in effects for acts in e.switches)
    found = {}
    for acts in ways:
        course = CourseInTime(acts, [e for e in effects if acts in e.switches])
        (tried,) = tried_shapes(rows, course, [{}])
        found[f'{course.name} {acts.__name__}'] = [tried.only(())]
    return found


@dataclass(frozen=True, eq=False)
class Courses:
    """Products of piecewise linear functions of time, by which every course is judged.

    Attributes
    ----------
    time : ndarray, shape (f,), s
        Evenly spaced from the start to the end.
    fitted : ndarray, shape (n, f)
        Values at the nodes that fit a course at these times best.
    normal : ndarray, shape (k, n, k, n)
    right : ndarray, shape (k, n)
    size : ndarray, shape (k,), m
        Displacement by a unit of each term of the way to act.
    """

    time: Array
    fitted: Array
    normal: Array
    right: Array
    size: Array
    variance: float

    @classmethod
    def of(cls, tried: Tried, end: float, variance: float) -> Courses:
        """Take the products of a ``CourseInTime``."""
        count, time = len(tried.size) // NODES, np.linspace(0.0, end, FINE)
        return cls(
            time,
            np.asarray(np.linalg.pinv(_hats(time, end)), np.float64),
            tried.normal.reshape(count, NODES, count, NODES),
            tried.right.reshape(count, NODES),
            tried.size.reshape(count, NODES).max(axis=1),
            variance,
        )

    @property
    def most(self) -> float:
        """Evidence that no course exceeds: half the fall of the sum of squares by all of them."""
        whole = self.normal.reshape(self.right.size, -1)
        whole = whole + np.diag(NEXT_TO_NOTHING * whole.diagonal() + np.finfo(np.float64).tiny)
        right = self.right.reshape(-1)
        return 0.5 * float(right @ np.linalg.solve(whole, right)) / self.variance

    def evidence_of_each(self, values: Array) -> Array:
        """Evidence of courses (n, m) at the nodes, each alone, shape (m,)."""
        first, second = np.triu_indices(len(self.right))
        normal = np.empty((values.shape[1], len(self.right), len(self.right)))
        own = np.sum((self._once @ values) * values, axis=1).T
        normal[:, first, second] = normal[:, second, first] = own
        square = np.sum(values**2, axis=0) / NODES
        return self._evidence(normal, (self.right @ values).T, square[:, None])

    @cached_property
    def _once(self) -> Array:
        """Products of every two terms of the way to act, each once, shape (l, n, n)."""
        first, second = np.triu_indices(len(self.right))
        return np.ascontiguousarray(self.normal[first, :, second])

    def evidence(self, values: Array, sets: Index) -> Array:
        """Evidence of sets of courses, each together.

        Parameters
        ----------
        values : ndarray, shape (n, u)
            Courses at the nodes.
        sets : ndarray of int, shape (m, c)
            Which of them belong together.

        Returns
        -------
        ndarray, shape (m,)
        """
        turned = np.tensordot(values, np.tensordot(self.normal, values, axes=(3, 0)), axes=(0, 1))
        normal = turned.transpose(0, 3, 1, 2)[sets[:, :, None], sets[:, None, :]]
        count = sets.shape[1] * len(self.right)
        whole = np.moveaxis(normal, 3, 2).reshape(-1, count, count)
        right = (self.right @ values).T[sets].reshape(-1, count)
        return self._evidence(whole, right, (np.sum(values**2, axis=0) / NODES)[sets])

    def _evidence(self, normal: Array, right: Array, square: Array) -> Array:
        """Evidence by products (m, c k, c k) and (m, c k); ``square`` (m, c): means over time."""
        scale = 1.0 / np.maximum(np.sqrt(square)[:, :, None] * self.size, 1e-300)
        scale = scale.reshape(right.shape)
        unit = normal * scale[:, :, None] * scale[:, None, :] / self.variance
        spread = np.array(SPREADS)[:, None, None]
        pull = spread * (right * scale / self.variance)
        # with the pull as its last row, a factor holds the half-solved system in its own
        whole = np.zeros((*pull.shape[:2], unit.shape[1] + 1, unit.shape[1] + 1))
        whole[..., :-1, :-1] = spread[..., None] ** 2 * unit + np.eye(unit.shape[1])
        whole[..., -1, :-1], whole[..., -1, -1] = pull, 1.0 + np.sum(pull**2, axis=2)
        factor = np.linalg.cholesky(whole)
        volume = np.log(np.diagonal(factor, axis1=2, axis2=3)[..., :-1]).sum(axis=2)
        found = 0.5 * np.sum(factor[..., -1, :-1] ** 2, axis=2) - volume
        return np.asarray(np.logaddexp.reduce(found, axis=0) - np.log(len(SPREADS)))
