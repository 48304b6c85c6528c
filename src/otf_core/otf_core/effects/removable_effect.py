# SPDX-License-Identifier: Apache-2.0
"""An effect that a calibration takes off: its shape, its coefficients, what is known before.

Coefficients have a normal prior about what a file says, or about zero-mean sizes like those that a
diagnosis found; what the effect is not linear in has one in its logarithm. So what the data do not
see stays as it was, uncertain by the size of the effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.effects.base import AppliedEffect, Effect
from otf_core.effects.terms import State
from otf_core.prediction.calibration_document import StatedEffect

FOUND: Literal['found'] = 'found'
FILE: Literal['file'] = 'file'
LARGEST_STEP = 0.5
"""Of the logarithm of a time constant or a period, in its prior standard deviations."""
DIFFERENCE = 1e-4
"""Step of the logarithm of a shape parameter, in its prior standard deviations."""
SPREAD = {FOUND: 3.0, FILE: 1.0}
"""Prior standard deviation of coefficients, over the largest displacement of the effect."""
LEAST_SPREAD = {FOUND: 0.0, FILE: 1e-6}
"""m; least prior standard deviation of the displacement by one coefficient."""


@dataclass(frozen=True)
class RemovableEffect:
    """One effect that is taken off.

    Attributes
    ----------
    names : tuple of str
        Coefficients that take part; all others are zero.
    values : ndarray, shape (r, k)
        One row for every run where each has its own, else one.
    known : ndarray, shape (r, k)
        What they were before these data.
    widths : mapping of str to float
        Shape parameters that are estimated: standard deviation of the logarithm before these data.
    start : mapping of str to float
        Their values before these data.
    how : str
        'found' by a diagnosis, or from a 'file'.
    """

    effect: Effect
    shape: Mapping[str, float]
    names: tuple[str, ...]
    values: Array
    known: Array
    widths: Mapping[str, float]
    start: Mapping[str, float]
    how: Literal['found', 'file']

    @property
    def size(self) -> int:
        """Number of parameters that are estimated."""
        return int(self.values.size) + len(self.widths)

    def displacement(self, state: State, run: int) -> Array:
        """Displacement of points of one run, shape (n, 3), m."""
        row = self.values[run if len(self.values) > 1 else 0]
        parameters = {**self.shape, **dict(zip(self.names, row.tolist(), strict=True))}
        return self.effect.displacement(state, parameters)

    def acting(self, run: int) -> Index:
        """Places of the parameters that act in a run: not those of others."""
        count, own = len(self.names), run if len(self.values) > 1 else 0
        return np.asarray(np.r_[own * count : (own + 1) * count, self.values.size : self.size])

    def columns(self, state: State, run: int) -> Array:
        """Derivatives of the displacement by the parameters that act, shape (n, 3, k)."""
        terms = self.effect.terms(state, self.effect.complete_shape(self.shape))
        place, count = [terms.names.index(name) for name in self.names], len(self.names)
        columns = np.empty((len(state), 3, count + len(self.widths)))
        columns[:, :, :count] = terms.columns[:, :, place]
        for k, (name, width) in enumerate(self.widths.items()):
            step = DIFFERENCE * width
            low, high = (
                replace(self, shape={**self.shape, name: self.shape[name] * np.exp(s)})
                for s in (-step, step)
            )
            change = high.displacement(state, run) - low.displacement(state, run)
            columns[:, :, count + k] = change / (2.0 * step)
        return columns

    def moved(self, step: Array) -> RemovableEffect:
        """The same with parameters moved by ``step`` (size,), those of the shape not far."""
        count = self.values.size
        shape = dict(self.shape)
        for (name, width), change in zip(self.widths.items(), step[count:], strict=True):
            bound = LARGEST_STEP * width
            shape[name] *= float(np.exp(np.clip(change, -bound, bound)))
        values = self.values + step[:count].reshape(self.values.shape)
        return replace(self, values=values, shape=shape)

    def away(self) -> Array:
        """Parameters less what they were before these data, shape (size,)."""
        logs = [np.log(self.shape[n] / self.start[n]) for n in self.widths]
        return np.concatenate([(self.values - self.known).ravel(), logs])

    def precision(self, size: Array) -> Array:
        """Inverse variances before these data, for columns of size (size,), m per unit."""
        largest = float(np.max(np.abs(self.known.ravel()) * size[: self.values.size], initial=0.0))
        spread = max(SPREAD[self.how] * largest, LEAST_SPREAD[self.how], 1e-9)
        smaller = np.tile(1.0 + self.effect.orders_of(self.names), len(self.values))
        own = (size[: self.values.size] * smaller / spread) ** 2
        # what does not act here at all stays as it was
        own = np.maximum(own, 1e-12 * float(own.max(initial=1.0)))
        return np.concatenate([own, [1.0 / w**2 for w in self.widths.values()]])

    def applied(self, run: int) -> AppliedEffect:
        """The effect in one run."""
        row = self.values[run if len(self.values) > 1 else 0]
        return AppliedEffect(
            self.effect, {**self.shape, **dict(zip(self.names, row.tolist(), strict=True))}
        )


@dataclass(frozen=True)
class RemovedEffects:
    """Effects that were taken off, and what the unknowns are uncertain by for them.

    Attributes
    ----------
    of_unknowns : ndarray, shape (full, full), m and rad
        Covariance.
    """

    stated: tuple[StatedEffect, ...]
    of_unknowns: Array


def removable_effect(
    applied: Sequence[AppliedEffect], how: Literal['found', 'file']
) -> RemovableEffect:
    """Set up an effect to be taken off.

    Parameters
    ----------
    applied : sequence of AppliedEffect
        The same effect in every run.
    how : str
        'found': its time constant or period is improved with the data; 'file': it is held.
    """
    effect, first = applied[0].effect, applied[0].parameters
    shape = {n: float(v) for n, v in first.items() if n in effect.shape_names}
    rows = applied if effect.own_per_run else applied[:1]
    names = tuple(dict.fromkeys(n for a in rows for n in a.parameters if n not in shape))
    values = np.array([[float(a.parameters.get(n, 0.0)) for n in names] for a in rows])
    widths = effect.loose(shape) if how == FOUND else {}
    start = {n: shape[n] for n in widths}
    return RemovableEffect(effect, shape, names, values, values.copy(), widths, start, how)
