# SPDX-License-Identifier: Apache-2.0
"""History of a machine: control chart, what changed when, drift, when to calibrate again."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from otf_core.arrays import Array
from otf_core.documents import Document, stated
from otf_core.history.store import Series, Store, StoredEvent, mean_u, series_of
from otf_core.model.expanded import COVERAGE_FACTOR

# Has something changed between two runs: chi-square of a difference, motion by motion.
#
# d' C^+ d of a difference d with covariance C (JCGM 102) is chi-square distributed with rank(C)
# degrees of freedom if nothing has changed. Contributions that both runs share, such as the scale
# of one tracker, are counted twice in C: the test errs to the side of no change. Motions that are
# looked at together share one probability of a false alarm (Bonferroni).

FALSE_ALARM_CHANGE = 0.0027
"""Probability of a false alarm, all motions together: limits of three sigma of a control chart."""
SINGULAR_VALUE_RATIO = 1e-9
"""Relative size of singular values that count as zero."""


@dataclass(frozen=True)
class Change(Document):
    """Difference of a motion, of another error, or of all."""

    size: float = stated('root mean square over the nodes', 'm or rad')
    expected: float = stated('the same without a change, by u', 'm or rad')
    p: float = stated('probability of a difference as large or larger without a change')
    significant: bool = stated('beyond the limits of a control chart')


def judged_change(size: float, expected: float, p: float, tests: int = 1) -> Change:
    """Judge a difference that is looked at together with ``tests`` differences in all."""
    return Change(size, expected, p, p < FALSE_ALARM_CHANGE / tests)


def chi_square(difference: Array, covariance: Array) -> tuple[float, int]:
    """Chi-square of a difference and its degrees of freedom."""
    weight, rank = _inverse(covariance)
    return float(difference @ weight @ difference), rank


def _inverse(matrix: Array) -> tuple[Array, int]:
    """Pseudo-inverse of a symmetric matrix, and its rank."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    seen = values > SINGULAR_VALUE_RATIO * max(float(values[-1]), 1e-300)
    root = vectors[:, seen] / np.sqrt(values[seen]) / scale[:, None]
    return root @ root.T, int(seen.sum())


def probability(chi2: float, dof: int) -> float:
    """Probability of a chi-square as large or larger."""
    from scipy.special import chdtrc  # loaded on use

    return float(chdtrc(dof, chi2)) if dof else 1.0


def change_of(difference: Array, covariance: Array, tests: int = 1) -> Change:
    """Judge a difference by its covariance."""
    variance = np.diag(covariance)
    known = variance > 1e-30
    if not known.any():
        return judged_change(0.0, 0.0, 1.0, tests)
    part = np.ix_(known, known)
    chi2, dof = chi_square(difference[known], covariance[part])
    return judged_change(
        math.sqrt(float(np.mean(difference[known] ** 2))),
        math.sqrt(float(np.mean(variance[known]))),
        probability(chi2, dof),
        tests,
    )


def changes(series: Series, a: int, b: int) -> dict[str, Change]:
    """What changed from run a to run b, by motion, squareness and location error."""
    difference = series.values[b] - series.values[a]
    return by_motion(series, difference, series.covariances[a] + series.covariances[b])


def by_motion(series: Series, difference: Array, covariance: Array) -> dict[str, Change]:
    """Judge a difference of vectors of a series, motion by motion."""
    parts = series.common.parts
    return {n: change_of(difference[p], covariance[p, p], len(parts)) for n, p in parts.items()}


def volume_change(series: Series, a: int, b: int) -> Change:
    """The same over the volume: mean length of the error vectors, best rigid motion removed."""
    difference = series.values[b] - series.values[a]
    covariance = series.covariances[a] + series.covariances[b]
    size = float(series.lengths(difference).mean())
    p = change_of(difference, covariance).p
    return judged_change(size, mean_u(series.common, covariance), p)


# How fast a machine drifts, and until when its tables hold.
#
# Least-squares line of every node over time since the last event: rate = sum c_k x_k with c_k =
# (t_k - mean t) / sum (t - mean t)^2, covariance sum c_k^2 C_k, widened where the runs scatter
# about the line more than their uncertainties say (Birge ratio). The volume drifts by the mean
# length of the rates on a grid, best rigid motion removed.
#
# Whether a line describes the runs at all is tested from three runs on: what is left of every
# motion about its generalised least-squares line is chi-square distributed if it does. Where it
# does not, the line says nothing about the days to come, and the pace of the last step stands in
# for it.

FALSE_ALARM_DRIFT = 0.05
"""Probability of a false alarm of a drift."""


@dataclass(frozen=True)
class Drift:
    """Rates per day since the last event.

    Attributes
    ----------
    rate : ndarray, shape (m,), m or rad per day
    motions : mapping of motion or squareness error to Change
        Per day.
    volume : float
        Mean length of the rates on the grid, m per day.
    u_volume : float
        Its standard uncertainty.
    birge : float
        Scatter about the line over what the uncertainties say; 1 for two runs.
    p : float
        Probability of rates as large or larger without drift.
    runs : int
        Runs that it is estimated from.
    p_line : mapping of motion or squareness error to float
        Probability that what is left about a straight line is as large or larger if there is one;
        empty for two runs, which any line fits.
    """

    rate: Array
    motions: dict[str, Change]
    volume: float
    u_volume: float
    birge: float
    p: float
    runs: int
    p_line: dict[str, float]

    @property
    def significant(self) -> bool:
        """Return whether the drift is beyond what chance gives (5 %).

        Two runs are one step, which is judged as every other step.
        """
        return self.p < (FALSE_ALARM_DRIFT if self.runs > 2 else FALSE_ALARM_CHANGE)

    @property
    def bent(self) -> list[str]:
        """Motions that a straight line does not describe, the worst first."""
        motions = [n for n, p in self.p_line.items() if p < FALSE_ALARM_CHANGE / len(self.p_line)]
        return sorted(motions, key=self.p_line.__getitem__)


@dataclass(frozen=True)
class DueDate:
    """When the drift reaches a limit, days after the last run.

    Attributes
    ----------
    limit : float
        m; mean volumetric drift that is allowed.
    days : float or None
        None if no significant drift.
    earliest : float
        95 %: not before.
    latest : float or None
        95 %: not after; None if that cannot be said.
    withheld : str
        Why there is no date, in words; empty where there is one or no significant drift.
    """

    limit: float
    days: float | None
    earliest: float
    latest: float | None
    withheld: str = ''


def drift_of(series: Series) -> Drift | None:
    """Estimate the drift; None from fewer than two runs at different times."""
    days = series.days
    spread = days - days.mean()
    total = float(np.sum(spread**2))
    if len(days) < 2 or total <= 0.0:
        return None
    weight = spread / total
    rate = weight @ series.values
    covariance = np.einsum('r,rij->ij', weight**2, series.covariances)
    birge = _scatter(series, rate, spread)
    covariance = covariance * birge**2
    rows = series.common.field_rows
    field = (rows @ rate).reshape(-1, 3)
    length = np.linalg.norm(field, axis=1)
    unit = field / np.maximum(length, 1e-300)[:, None]
    slope = np.einsum('nc,ncm->m', unit, rows.reshape(len(unit), 3, -1)) / len(unit)
    return Drift(
        rate,
        by_motion(series, rate, covariance),
        float(length.mean()),
        float(np.sqrt(max(float(slope @ covariance @ slope), 0.0))),
        birge,
        change_of(rate, covariance).p,
        len(days),
        _line_probabilities(series),
    )


def _line_probabilities(series: Series) -> dict[str, float]:
    if len(series.runs) < 3:
        return {}
    return {name: _line_probability(series, part) for name, part in series.common.parts.items()}


def _line_probability(series: Series, part: slice) -> float:
    """Probability of the scatter of a motion about its generalised least-squares line."""
    known = np.all(np.diagonal(series.covariances, axis1=1, axis2=2)[:, part] > 1e-30, axis=0)
    which = np.arange(part.start, part.stop)[known]
    if not len(which):
        return 1.0
    values = series.values[:, which] - series.values[:, which].mean(axis=0)
    spread = series.days - series.days.mean()
    spread = spread / np.sqrt(np.mean(spread**2))
    normal = np.zeros((2 * len(which),) * 2)
    right, square, dof = np.zeros(len(normal)), 0.0, 0
    for time, value, covariance in zip(spread, values, series.covariances, strict=True):
        weight, rank = _inverse(covariance[np.ix_(which, which)])
        line = np.array([1.0, time])
        normal += np.kron(np.outer(line, line), weight)
        right += np.kron(line, weight @ value)
        square += float(value @ weight @ value)
        dof += rank
    inverse, rank = _inverse(normal)
    return probability(max(square - float(right @ inverse @ right), 0.0), dof - rank)


def _scatter(series: Series, rate: Array, spread: Array) -> float:
    """Birge ratio of the runs about their line, at least 1."""
    if len(spread) < 3:
        return 1.0
    residuals = series.values - series.values.mean(axis=0) - spread[:, None] * rate
    ratios = [
        chi_square(x[seen], c[np.ix_(seen, seen)])
        for x, c in zip(residuals, series.covariances, strict=True)
        for seen in [np.diag(c) > 1e-30]
    ]
    chi2, dof = sum(f[0] for f in ratios), sum(f[1] for f in ratios)
    free = dof * (len(spread) - 2) / len(spread)
    return float(np.sqrt(max(1.0, chi2 / max(free, 1.0))))


def due_date(drift: Drift, last: Drift, limit: float) -> DueDate:
    """When the mean volumetric drift since the last run reaches a limit.

    Parameters
    ----------
    drift : Drift
        Since the last event.
    last : Drift
        Of the last step alone.
    limit : float
        m

    Returns
    -------
    Due
        By the line where the runs lie on one; else without a date, and no earlier than at the pace
        of the line or of the last step, whichever is faster.
    """
    line = drift.volume + COVERAGE_FACTOR * drift.u_volume
    if drift.bent:
        pace = max(line, last.volume + COVERAGE_FACTOR * last.u_volume)
        why = f'a straight line does not describe {", ".join(drift.bent)}'
        return DueDate(limit, None, limit / max(pace, 1e-300), None, why)
    earliest = limit / max(line, 1e-300)
    if not drift.significant:
        return DueDate(limit, None, earliest, None)
    low = drift.volume - COVERAGE_FACTOR * drift.u_volume
    return DueDate(limit, limit / drift.volume, earliest, limit / low if low > 0 else None)


# The history of one machine: control chart, what changed when, drift, next calibration.
#
# A machine is steady only where that was judged: at least two runs since the last event, no
# significant change between them, no drift, and none of them before an event that no run has
# followed.


class MachineStatus(Enum):
    """What is known of a machine; the value describes it."""

    STEADY = 'steady'
    DRIFT = 'drift'
    BENT = 'not linear'
    CHANGED = 'changed'
    UNJUDGED = 'not judged'


@dataclass(frozen=True)
class Step:
    """From one run to the next.

    Attributes
    ----------
    after : int
        The later run.
    events : tuple of StoredEvent
        What happened between them.
    motions : mapping of motion or squareness error to Change
    """

    after: int
    events: tuple[StoredEvent, ...]
    volume: Change
    motions: dict[str, Change]

    @property
    def changed(self) -> list[str]:
        """Motions that changed significantly, largest against expectation first."""
        motions = [name for name, change in self.motions.items() if change.significant]
        return sorted(motions, key=lambda n: -self.motions[n].size / self.motions[n].expected)

    @property
    def significant(self) -> bool:
        """Return whether anything changed beyond chance, one motion or all together."""
        return self.volume.significant or bool(self.changed)


@dataclass(frozen=True)
class History:
    """One machine.

    Attributes
    ----------
    chart : tuple of mapping
        For every run the change of each motion since the first run.
    volume : tuple of Change
        The same over the volume.
    error : ndarray, shape (r,), m
        Mean length of the errors over the volume by every run, best rigid motion removed.
    u_error : ndarray, shape (r,), m
        Mean standard uncertainty of these errors, with all that is stated.
    events : tuple of StoredEvent
        From the first run on.
    reference : int
        First run since the last event that a run followed.
    drift : Drift, optional
        Since then; None from fewer than two runs.
    last : Drift, optional
        Of the last step alone, if no event lies in it.
    due : DueDate, optional
        None without a drift, and where an event has no run after it.
    """

    machine: str
    series: Series
    chart: tuple[dict[str, Change], ...]
    volume: tuple[Change, ...]
    error: Array
    u_error: Array
    steps: tuple[Step, ...]
    events: tuple[StoredEvent, ...]
    reference: int
    drift: Drift | None
    last: Drift | None
    due: DueDate | None

    @property
    def open_events(self) -> tuple[StoredEvent, ...]:
        """Events that no run has followed: what they changed is not known."""
        return tuple(e for e in self.events if e.at > self.series.runs[-1].at)

    @property
    def standing(self) -> MachineStatus:
        """What is known of the machine now."""
        if self.open_events or len(self.series.runs) < 2:
            return MachineStatus.UNJUDGED
        if self.drift is None:
            return MachineStatus.CHANGED if self.steps[-1].significant else MachineStatus.UNJUDGED
        if self.drift.bent:
            return MachineStatus.BENT
        if self.drift.runs > 2 and self.drift.significant:
            return MachineStatus.DRIFT
        if any(s.significant for s in self.steps[self.reference :]):
            return MachineStatus.CHANGED
        return MachineStatus.STEADY


def _between(store: Store, series: Series, run: int) -> tuple[StoredEvent, ...]:
    """Events between a run and the one before."""
    low, high = series.runs[run - 1].at, series.runs[run].at
    return tuple(e for e in store.events if low < e.at <= high)


def history_of(store: Store, machine: str, limit: float | None = None) -> History:
    """Judge the runs of one machine.

    Parameters
    ----------
    limit : float, optional
        m; mean volumetric drift that is allowed; if not given, twice the mean standard
        uncertainty of what does not repeat in the latest tables: noise, misfit and what is
        declared.
    """
    own = store.of(machine)
    series = series_of(own.runs)
    count = len(series.runs)
    steps = tuple(
        Step(k, _between(own, series, k), volume_change(series, k - 1, k),
             changes(series, k - 1, k))
        for k in range(1, count)
    )  # fmt: skip
    reference = max((s.after for s in steps if s.events), default=0)
    drift = drift_of(series.since(reference))
    last = None if drift is None else drift_of(series.since(count - 2)) or drift
    error = np.array([series.lengths(v).mean() for v in series.values])
    allowed = 2.0 * mean_u(series.common, series.covariances[-1]) if limit is None else limit
    events = tuple(e for e in own.events if e.at > series.runs[0].at)
    open_ = any(e.at > series.runs[-1].at for e in events)
    return History(
        machine,
        series,
        tuple(changes(series, 0, k) for k in range(count)),
        tuple(volume_change(series, 0, k) for k in range(count)),
        error,
        series.u,
        steps,
        events,
        reference,
        drift,
        last,
        None if drift is None or last is None or open_ else due_date(drift, last, allowed),
    )
