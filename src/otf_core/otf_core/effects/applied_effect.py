# SPDX-License-Identifier: Apache-2.0
"""Effects with their parameters: what a simulation adds, what a diagnosis found."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import Effect, Shape, State


@dataclass(frozen=True)
class AppliedEffect:
    """An effect of a certain size.

    Attributes
    ----------
    parameters : mapping of str to float
        Coefficients and shape by name, in the units of the effect; what is missing is zero or
        the default.
    """

    effect: Effect
    parameters: Shape


def total_displacement(state: State, applied: Iterable[AppliedEffect]) -> Array:
    """Sum of the displacements of several effects, shape (n, 3), m."""
    total = np.zeros((len(state), 3))
    for one in applied:
        total += one.effect.displacement(state, one.parameters)
    return total
