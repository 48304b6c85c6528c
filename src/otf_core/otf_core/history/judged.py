# SPDX-License-Identifier: Apache-2.0
"""The history of one machine: control chart, what changed when, drift, next calibration.

A machine is steady only where that was judged: at least two runs since the last event, no change
beyond chance between them, no drift, and none of them before an event that no run has followed.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from otf_core.arrays import Array
from otf_core.history.change import Change, changes, volume_change
from otf_core.history.drift import Drift, Due, drift_of, due
from otf_core.history.series import Series, series_of
from otf_core.history.store import Store, StoredEvent


class Standing(Enum):
    """What is known of a machine; the value is said of it."""

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
    volume : Change
    motions : mapping of motion or squareness error to Change
    """

    after: int
    events: tuple[StoredEvent, ...]
    volume: Change
    motions: dict[str, Change]

    @property
    def changed(self) -> list[str]:
        """Motions that changed significantly, largest against expectation first."""
        found = [name for name, change in self.motions.items() if change.significant]
        return sorted(found, key=lambda n: -self.motions[n].size / self.motions[n].expected)

    @property
    def significant(self) -> bool:
        """Tell whether anything changed beyond chance, one motion or all together."""
        return self.volume.significant or bool(self.changed)


@dataclass(frozen=True)
class History:
    """One machine.

    Attributes
    ----------
    machine : str
    series : Series
    chart : tuple of mapping
        For every run the change of each motion since the first run.
    volume : tuple of Change
        The same over the volume.
    error : ndarray, shape (r,), m
        Mean length of the errors over the volume by every run, best rigid motion taken out.
    u_error : ndarray, shape (r,), m
        Mean standard uncertainty of these errors.
    steps : tuple of Step
    events : tuple of StoredEvent
        From the first run on.
    reference : int
        First run since the last event that a run followed.
    drift : Drift, optional
        Since then; None from fewer than two runs.
    last : Drift, optional
        Of the last step alone, if no event lies in it.
    due : Due, optional
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
    due: Due | None

    @property
    def open_events(self) -> tuple[StoredEvent, ...]:
        """Events that no run has followed: what they changed is not known."""
        return tuple(e for e in self.events if e.at > self.series.runs[-1].at)

    @property
    def standing(self) -> Standing:
        """What is known of the machine now."""
        if self.open_events or len(self.series.runs) < 2:
            return Standing.UNJUDGED
        if self.drift is None:
            return Standing.CHANGED if self.steps[-1].significant else Standing.UNJUDGED
        if self.drift.bent:
            return Standing.BENT
        if self.drift.runs > 2 and self.drift.significant:
            return Standing.DRIFT
        if any(s.significant for s in self.steps[self.reference :]):
            return Standing.CHANGED
        return Standing.STEADY


def _between(store: Store, series: Series, run: int) -> tuple[StoredEvent, ...]:
    """Events between a run and the one before."""
    low, high = series.runs[run - 1].at, series.runs[run].at
    return tuple(e for e in store.events if low < e.at <= high)


def uncertainty(series: Series, run: int) -> float:
    """Mean standard uncertainty of the tables of a run over the grid, m."""
    rows = series.field_rows
    variance = np.einsum('ij,ij->i', rows @ series.covariances[run], rows)
    return float(np.mean(np.sqrt(np.maximum(variance.reshape(-1, 3).sum(axis=1), 0.0))))


def history_of(store: Store, machine: str, limit: float | None = None) -> History:
    """Judge the runs of one machine.

    Parameters
    ----------
    store : Store
    machine : str
    limit : float, optional
        m; mean volumetric drift that is allowed; if not given, twice the mean standard
        uncertainty of the latest tables.
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
    u_error = np.array([uncertainty(series, k) for k in range(count)])
    allowed = 2.0 * float(u_error[-1]) if limit is None else limit
    events = tuple(e for e in own.events if e.at > series.runs[0].at)
    open_ = any(e.at > series.runs[-1].at for e in events)
    return History(
        machine,
        series,
        tuple(changes(series, 0, k) for k in range(count)),
        tuple(volume_change(series, 0, k) for k in range(count)),
        error,
        u_error,
        steps,
        events,
        reference,
        drift,
        last,
        None if drift is None or last is None or open_ else due(drift, last, allowed),
    )
