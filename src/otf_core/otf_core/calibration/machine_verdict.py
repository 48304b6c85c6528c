# SPDX-License-Identifier: Apache-2.0
"""Two verdicts of a calibration: is the measurement good; is the machine within its limits.

The first is by the quality gates. The second is by the limits of machine.yaml, with a guard band
(ISO 14253-1); a machine out of tolerance is no failure of the measurement that shows it.

A value y with expanded uncertainty U (95 %) keeps a limit if y + U is at most the limit, breaks
it if y - U is above; in between lies the zone in which neither is proven. Only kept limits pass.
``uncertainty`` is itself an expanded uncertainty and is compared as it stands. Where an axis was
not driven over its range, its motions and the volume are not known.

References
----------
ISO 14253-1:2017, rules for verifying conformity: acceptance zone = limit less guard band; the
guard band is U here, the careful choice for two-sided 95 %.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import Budget
from otf_core.model.expanded import (
    micro_significant,
    micro_unit,
    micro_with_expanded,
)
from otf_core.model.sections import UNCERTAINTY, VOLUMETRIC, limit_unit
from otf_core.model.tables import ErrorTables
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.volumetric import VolumetricError, table_places

PASS, FAIL, OPEN, UNKNOWN = 'pass', 'fail', 'not proven', 'not known'
WORDS = {PASS: 'kept', FAIL: 'broken', OPEN: 'not proven', UNKNOWN: 'not known'}
"""States of a limit in words."""
NOT_STATED = 'not stated'
"""State of a machine without limits."""
MEASUREMENT_FAILED, LIMIT_NOT_PROVEN = 4, 5
"""Exit codes: a quality gate failed; the measurement is good, a limit is not proven to be met."""
MEANING = {
    VOLUMETRIC: 'volumetric error, at the decisive point',
    UNCERTAINTY: 'expanded uncertainty of the volumetric error, largest',
}


@dataclass(frozen=True)
class LimitVerdict:
    """One limit.

    Attributes
    ----------
    name : str
        Key of ``limits``.
    U : float
        Expanded uncertainty of the value, 95 %; zero for ``uncertainty``.
    state : str
        ``PASS``, ``FAIL``, ``OPEN`` within the guard band, ``UNKNOWN`` without a value.
    """

    name: str
    unit: str
    limit: float
    value: float
    U: float
    state: str

    @property
    def words(self) -> str:
        """One line."""
        limit = f'limit {1e6 * self.limit:g} {micro_unit(self.unit)}: {WORDS[self.state]}'
        what = MEANING.get(self.name, self.name)
        if self.state == UNKNOWN:
            return f'{what}: the data do not show it, {limit}'
        if not self.U:
            return f'{what} {micro_significant(self.value, self.unit)}, {limit}'
        return f'{what} {micro_with_expanded(self.value, self.U, self.unit)}, {limit}'


@dataclass(frozen=True)
class Verdict:
    """All limits of a machine."""

    judged: tuple[LimitVerdict, ...]

    @property
    def passed(self) -> bool:
        """True if every limit is proven to be kept."""
        return all(one.state == PASS for one in self.judged)

    @property
    def open(self) -> tuple[str, ...]:
        """Limits that are not proven to be kept, a line each."""
        return tuple(one.words for one in self.judged if one.state != PASS)

    @property
    def state(self) -> str:
        """Of all limits together: the worst state."""
        states = {one.state for one in self.judged}
        return next(s for s in (FAIL, UNKNOWN, OPEN, PASS) if s in states)

    @property
    def sentence(self) -> str:
        """The verdict."""
        count = len(self.judged)
        limits = 'limit' if count == 1 else 'limits'
        if self.passed:
            return f'{count} of {count} {limits} met'
        states = [one.state for one in self.judged]
        counts = [(states.count(s), WORDS[s]) for s in (FAIL, OPEN, UNKNOWN) if s in states]
        (first, state), *more = counts
        rest = ''.join(f', {number} {word}' for number, word in more)
        return f'{first} of {count} {limits} {state}{rest}'


@dataclass(frozen=True)
class Verdicts:
    """The two verdicts of a calibration, which never mix.

    Attributes
    ----------
    failed_gates : tuple of str
        Quality gates of the measurement that failed.
    machine : Verdict, optional
        By the limits of machine.yaml; None without any.
    """

    failed_gates: tuple[str, ...]
    machine: Verdict | None

    @property
    def good(self) -> bool:
        """True if the measurement is good."""
        return not self.failed_gates

    @property
    def exit_code(self) -> int:
        """0, 4 if the measurement is not good, 5 if it is and a limit is not proven to be met."""
        if not self.good:
            return MEASUREMENT_FAILED
        return LIMIT_NOT_PROVEN if self.machine and not self.machine.passed else 0

    @property
    def machine_state(self) -> str:
        """'pass', 'fail', 'not proven', 'not known' or 'not stated'."""
        return self.machine.state if self.machine else NOT_STATED

    @property
    def measurement_words(self) -> str:
        """The first verdict in one line."""
        if self.good:
            return 'measurement: good, all checks passed'
        return f'measurement: NOT GOOD, {"; ".join(self.failed_gates)}'

    @property
    def machine_words(self) -> str:
        """The second verdict in one line."""
        if self.machine is None:
            return 'machine: no limits stated in machine.yaml'
        return f'machine: {self.machine.sentence} (guard band U, ISO 14253-1)'

    @property
    def words(self) -> tuple[str, ...]:
        """Both, and a line for each limit that is not proven to be kept."""
        lines = self.machine.open if self.machine else ()
        return (self.measurement_words, self.machine_words, *(f'  {line}' for line in lines))

    def to_dict(self) -> dict[str, Any]:
        """Entry ``verdicts`` of error_tables.json, SI."""
        return {
            'measurement': {
                'good': self.good,
                'failed': list(self.failed_gates),
                'sentence': self.measurement_words,
            },
            'machine': {
                'state': self.machine_state,
                'sentence': self.machine_words,
                'rule': 'pass: value + U <= limit; fail: value - U > limit (ISO 14253-1)',
                'limits': [asdict(one) for one in self.machine.judged] if self.machine else [],
            },
        }


def _with_guard(value: float, wide: float, limit: float) -> str:
    if value + wide <= limit:
        return PASS
    return FAIL if value - wide > limit else OPEN


def judge(
    tables: ErrorTables,
    covariance: Array,
    budget: Budget,
    hidden: Collection[str],
) -> Verdict | None:
    """Compare a calibration with the limits of its machine.

    Parameters
    ----------
    covariance : ndarray, shape (m, m), m and rad
    budget : Budget
        Of the same nodes: coverage factors.
    hidden : collection of str
        Errors that the data cannot see.

    Returns
    -------
    Verdict or None
        None without limits.
    """
    limits = tables.machine.limits
    if limits is None:
        return None
    volume = VolumetricError(tables, covariance)
    short = _partly_driven(tables)
    unseen = {
        *hidden,
        *((VOLUMETRIC, UNCERTAINTY) if short else ()),
        *(m for m in tables.machine.motions if m.axis in short),
    }
    judged = []
    for name, limit in limits.values.items():
        unit = limit_unit(name)
        if name in unseen:
            judged.append(LimitVerdict(name, unit, limit, 0.0, 0.0, UNKNOWN))
            continue
        if name == VOLUMETRIC:
            value, wide = _largest(volume, budget, limit)
        elif name == UNCERTAINTY:
            value, wide = _uncertainty(volume, budget), 0.0
        else:
            value, wide = size_and_expanded(name, tables, budget)
        judged.append(
            LimitVerdict(name, unit, limit, value, wide, _with_guard(value, wide, limit))
        )
    return Verdict(tuple(judged))


RANGE_COVERED = 0.98
"""Share of the range of every axis that tables must cover to judge the volume."""


def _partly_driven(tables: ErrorTables) -> list[str]:
    """Axes whose tables cover only a part of their range."""
    machine, (low, high) = tables.machine, table_ranges(tables)
    short = high - low < RANGE_COVERED * (machine.upper - machine.lower)
    return [a for a, part in zip(machine.axis_names, short.tolist(), strict=True) if part]


def _expanded(budget: Budget, rows: Array) -> Array:
    """Expanded uncertainty of linear combinations (n, m), each with the largest k of all."""
    variances = budget.variances(rows)
    return np.asarray(budget.expansion(variances)[0] * np.sqrt(variances.sum(axis=0)))


def _largest(volume: VolumetricError, budget: Budget, limit: float) -> tuple[float, float]:
    """Length and U of the vector that decides: proven to be too long, else longest with U."""
    wide = _expanded(budget, volume.length_rows)
    sure = volume.length - wide
    at = int(np.argmax(sure if sure.max() > limit else volume.length + wide))
    return float(volume.length[at]), float(wide[at])


def _uncertainty(volume: VolumetricError, budget: Budget) -> float:
    k, _ = budget.expansion(budget.variances(volume.rows))
    return k * float(volume.u_size.max())


def size_and_expanded(name: str, tables: ErrorTables, budget: Budget) -> tuple[float, float]:
    """Size of a scalar, or largest less smallest value of a motion, and its U."""
    place = table_places(tables)[name]
    row = np.zeros((1, len(budget.rows)))
    if name in tables.machine.scalars:
        row[0, place] = 1.0
        return abs(tables.scalar(name)), float(_expanded(budget, row)[0])
    table = tables.motions[name]
    high, low = int(table.value.argmax()), int(table.value.argmin())
    row[0, place.start + high] += 1.0
    row[0, place.start + low] -= 1.0
    return float(table.value[high] - table.value[low]), float(_expanded(budget, row)[0])
