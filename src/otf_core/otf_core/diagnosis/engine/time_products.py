# SPDX-License-Identifier: Apache-2.0
"""Functions of time times a way to act: many shapes, which share what they act with."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.action import Acting
from otf_core.effects.base import Effect, Shape, State, Terms


class InTime(Effect):
    """Functions of time times a way to act; each run has its own."""

    heads: ClassVar[tuple[str, ...]]
    """Of the names of the coefficients, one for every function."""
    own_per_run: ClassVar[bool] = True

    @property
    def acts(self) -> Acting:
        """What the functions are multiplied with: the first of those in which it may switch."""
        return self.switches[0]

    @abstractmethod
    def course(self, state: State, shape: Shape) -> Array:
        """Return the functions of time, shape (n, m)."""

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return every term of the way to act times every function, one after the other."""
        base, course = self.acts(state, {}), self.course(state, shape)
        names = tuple(f'{head}_{name}' for name in base.names for head in self.heads)
        units = tuple(unit for unit in base.units for _ in self.heads)
        columns = base.columns[:, :, :, None] * course[:, None, None, :]
        return Terms(names, units, ('',) * len(names), columns.reshape(len(state), 3, -1))

    def products(self, state: State, shapes: Sequence[Shape], other: Array) -> Array:
        """Products of displacements with others (n, 3, q), shape (s, q, k) for k terms."""
        acts = np.moveaxis(self.acts(state, {}).columns, 2, 0)
        courses = np.concatenate([self.course(state, shape) for shape in shapes], axis=1)
        found = np.stack([np.einsum('ni,niq->qn', one, other) @ courses for one in acts])
        parts = found.reshape(*found.shape[:2], len(shapes), -1)
        return parts.transpose(2, 1, 0, 3).reshape(len(shapes), other.shape[2], -1)
