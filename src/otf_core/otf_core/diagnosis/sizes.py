# SPDX-License-Identifier: Apache-2.0
"""The size of a cause: what stands for it in a headline, with unit and uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.cause_parameters import FittedCause
from otf_core.diagnosis.free_curves import Curve, number_words
from otf_core.effects import REGISTRY, State
from otf_core.effects.sizes import Coefficients, Size
from otf_core.model.expanded import COVERAGE_FACTOR
from otf_core.model.machine import Machine
from otf_core.model.quantities import quantity

WHOLE = 'rms across the path'
"""What stands for an effect of which no coefficient does."""


@dataclass(frozen=True)
class CauseSize:
    """A size of a cause.

    Attributes
    ----------
    of : str
        What of the cause it is the size of, such as 'of X' or 'along Z'; empty for all of it.
    value : float
        SI.
    u : float, optional
        Standard uncertainty; none of what is chosen, not estimated.
    remark : str
        What kind of size it is, in words.
    """

    of: str
    value: float
    u: float | None
    unit: str
    remark: str = ''

    @property
    def words(self) -> str:
        """Value, expanded uncertainty (k = 2) and unit."""
        return quantity(self.value, self.u, self.unit)

    @property
    def significant(self) -> bool:
        """True if it is larger than its expanded uncertainty."""
        return self.u is None or abs(self.value) > COVERAGE_FACTOR * self.u


def sizes_of(
    part: FittedCause, states: Sequence[State], curves: Sequence[Curve]
) -> tuple[CauseSize, ...]:
    """Sizes of a cause, those that are significant, or else the first.

    Parameters
    ----------
    states : sequence of State
        Of the pieces of every run.
    curves : sequence of Curve
        Of a free form, the largest first: what is stated of it is the largest value.
    """
    if curves:
        return (_of_curves(curves),)
    in_run = [_InRun(part, k, states) for k in range(_runs_of_its_own(part, states))]
    strongest = max(in_run, key=lambda one: one.displacement)
    found = [strongest.evaluated(s) for s in strongest.sizes()] or [strongest.whole()]
    return tuple([s for s in found if s.significant] or found[:1])


def chosen_sizes(
    effect: str, parameters: dict[str, float], machine: Machine
) -> tuple[CauseSize, ...]:
    """Sizes of an effect without coefficients."""
    found = REGISTRY[effect].sizes(Coefficients({}, {}, (), parameters, machine))
    return tuple(CauseSize(s.of, s.chosen, None, s.unit, s.remark) for s in found)


def sizes_words(sizes: Sequence[CauseSize], direction: str) -> str:
    """Sizes as they follow the name of a cause: ' of X, 5.02 +/- 0.19 um'."""
    kinds = dict.fromkeys(s.remark for s in sizes)
    parts = []
    for size in sizes:
        of = size.of or (f'along {direction}' if direction and size.unit == 'm' else '')
        remark = f' ({size.remark})' if size.remark and len(kinds) > 1 else ''
        parts.append(f' {of}, {size.words}{remark}' if of else f', {size.words}{remark}')
    common = next(iter(kinds)) if len(kinds) == 1 else ''
    return ', and'.join(parts) + (f' ({common})' if common else '')


def _runs_of_its_own(part: FittedCause, states: Sequence[State]) -> int:
    return len(states) if part.cause.option.effect.own_per_run else 1


def _of_curves(curves: Sequence[Curve]) -> CauseSize:
    """Largest value of the strongest function of a free form, and its root mean square."""
    term = curves[0].term
    own = [c for c in curves if c.term == term]
    value = np.concatenate([c.value for c in own])
    k = int(np.argmax(np.abs(value)))
    u = float(np.concatenate([c.u for c in own])[k])
    rms = number_words(float(np.sqrt(np.mean(value**2))), curves[0].unit)
    of = f'of {curves[0].axis or term}'
    return CauseSize(of, float(value[k]), u, curves[0].unit, f'free form: largest; rms {rms}')


class _InRun:
    """Coefficients of a cause in one run."""

    def __init__(self, part: FittedCause, run: int, states: Sequence[State]) -> None:
        option = part.cause.option
        count = option.terms.columns.shape[2]
        self.place = np.flatnonzero(option.take // max(count, 1) == run)
        names = [option.terms.names[i] for i in option.take[self.place] - run * count]
        self.part, self.names, self.pieces = part, names, sum(map(len, states))
        axes = part.axes or tuple(dict.fromkeys(option.terms.axes[i] for i in option.take))
        self.coefficients = Coefficients(
            dict(zip(names, part.value[self.place].tolist(), strict=True)),
            dict(zip(names, option.size[self.place].tolist(), strict=True)),
            axes,
            option.shape,
            states[run].machine,
        )
        self.remark = f'in run {run + 1}' if len(states) > 1 and option.effect.own_per_run else ''

    @property
    def displacement(self) -> float:
        """Root mean square displacement across the path, m."""
        plain = self.part.cause.option.plain[:, self.place] @ self.part.value[self.place]
        return float(np.sqrt(plain @ plain / self.pieces))

    def sizes(self) -> tuple[Size, ...]:
        """What the file of the effect states."""
        return self.part.cause.option.effect.sizes(self.coefficients)

    def evaluated(self, size: Size) -> CauseSize:
        """Value and standard uncertainty of a size."""
        weights = np.array([[p.get(n, 0.0) for n in self.names] for p in size.parts])
        values = weights @ self.part.value[self.place]
        if len(values) == 1:
            value, slope = float(values[0]), weights[0]
        else:
            value = float(np.linalg.norm(values))
            slope = values @ weights / max(value, 1e-300)
        remark = ', '.join(filter(None, (size.remark, self.remark)))
        return CauseSize(size.of, value, self._u(slope), size.unit, remark)

    def whole(self) -> CauseSize:
        """Displacement across the path with its standard uncertainty."""
        columns = self.part.cause.option.plain[:, self.place]
        value = self.displacement
        moved = columns @ self.part.value[self.place]
        slope = moved @ columns / (self.pieces * max(value, 1e-300))
        remark = ', '.join(filter(None, (WHOLE, self.remark)))
        return CauseSize('', value, self._u(slope), 'm', remark)

    def _u(self, slope: Array) -> float:
        own = self.place
        square = slope @ self.part.covariance[np.ix_(own, own)] @ slope
        return math.sqrt(max(0.0, float(square + np.sum((slope @ self.part.unseen[own]) ** 2))))
