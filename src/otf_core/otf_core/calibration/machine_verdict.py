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

from collections.abc import Collection, Sequence
from typing import Literal

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import Budget
from otf_core.model.expanded import COVERAGE_FACTOR
from otf_core.model.sections import UNCERTAINTY, VOLUMETRIC, limit_unit
from otf_core.model.tables import ErrorTables
from otf_core.prediction.calibration_document import (
    FAIL,
    NOT_STATED,
    OPEN,
    PASS,
    STATE_WORDS,
    UNKNOWN,
    LimitVerdict,
    MachineVerdict,
    MeasurementVerdict,
)
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.volumetric import VolumetricError, table_places


def _state(value: float, wide: float, limit: float) -> Literal['pass', 'fail', 'not proven']:
    if value + wide <= limit:
        return PASS
    return FAIL if value - wide > limit else OPEN


def machine_verdict(judged: Sequence[LimitVerdict]) -> MachineVerdict:
    """Put limits together; none: not stated."""
    if not judged:
        return MachineVerdict(NOT_STATED, 'machine: no limits stated in machine.yaml')
    count, states = len(judged), [one.state for one in judged]
    limits = 'limit' if count == 1 else 'limits'
    counts = [(states.count(s), STATE_WORDS[s]) for s in (FAIL, OPEN, UNKNOWN) if s in states]
    sentence = f'{count} of {count} {limits} met'
    if counts:
        (first, state), *more = counts
        rest = ''.join(f', {number} {word}' for number, word in more)
        sentence = f'{first} of {count} {limits} {state}{rest}'
    worst = next(s for s in (FAIL, UNKNOWN, OPEN, PASS) if s in states)
    return MachineVerdict(worst, f'machine: {sentence} (guard band U, ISO 14253-1)', tuple(judged))


def measurement_verdict(failed: Sequence[str]) -> MeasurementVerdict:
    """Whether the measurement is good, by the quality gates that failed."""
    words = f'NOT GOOD, {"; ".join(failed)}' if failed else 'good, all checks passed'
    return MeasurementVerdict(not failed, tuple(failed), f'measurement: {words}')


def judge(
    tables: ErrorTables,
    covariance: Array,
    budget: Budget,
    hidden: Collection[str],
) -> MachineVerdict:
    """Compare a calibration with the limits of its machine.

    Parameters
    ----------
    covariance : ndarray, shape (m, m), m and rad
    budget : Budget
        Of the same nodes: coverage factors.
    hidden : collection of str
        Errors that the data cannot see.
    """
    limits = tables.machine.limits
    if limits is None:
        return machine_verdict(())
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
            judged.append(LimitVerdict(name, unit, limit, 0.0, 0.0, COVERAGE_FACTOR, UNKNOWN))
            continue
        if name == VOLUMETRIC:
            value, u, k = _largest(volume, budget, limit)
        elif name == UNCERTAINTY:
            k, _ = budget.expansion(budget.variances(volume.rows))
            value, u = k * float(volume.u_size.max()), 0.0
        else:
            value, u, k = size_and_u(name, tables, budget)
        judged.append(LimitVerdict(name, unit, limit, value, u, k, _state(value, k * u, limit)))
    return machine_verdict(judged)


RANGE_COVERED = 0.98
"""Share of the range of every axis that tables must cover to judge the volume."""


def _partly_driven(tables: ErrorTables) -> list[str]:
    """Axes whose tables cover only a part of their range."""
    machine, (low, high) = tables.machine, table_ranges(tables)
    short = high - low < RANGE_COVERED * (machine.upper - machine.lower)
    return [a for a, part in zip(machine.axis_names, short.tolist(), strict=True) if part]


def _u_and_k(budget: Budget, rows: Array) -> tuple[Array, float]:
    """Standard uncertainty of linear combinations (n, m), and the largest k of all."""
    variances = budget.variances(rows)
    return np.sqrt(variances.sum(axis=0)), budget.expansion(variances)[0]


def _largest(volume: VolumetricError, budget: Budget, limit: float) -> tuple[float, float, float]:
    """Length, u and k of the vector that decides: proven to be too long, else longest with U."""
    u, k = _u_and_k(budget, volume.length_rows)
    sure = volume.length - k * u
    at = int(np.argmax(sure if sure.max() > limit else volume.length + k * u))
    return float(volume.length[at]), float(u[at]), k


def size_and_u(name: str, tables: ErrorTables, budget: Budget) -> tuple[float, float, float]:
    """Size of a scalar, or largest less smallest value of a motion, its u and k."""
    place = table_places(tables)[name]
    row = np.zeros((1, len(budget.rows)))
    if name in tables.machine.scalars:
        row[0, place] = 1.0
        size = abs(tables.scalar(name))
    else:
        table = tables.motions[name]
        high, low = int(table.value.argmax()), int(table.value.argmin())
        row[0, place.start + high] += 1.0
        row[0, place.start + low] -= 1.0
        size = float(table.value[high] - table.value[low])
    u, k = _u_and_k(budget, row)
    return size, float(u[0]), k
