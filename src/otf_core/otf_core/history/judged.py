# SPDX-License-Identifier: Apache-2.0
"""The history of one machine: control chart, what changed when, drift, next calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.history.change import Change, changes, volume_change
from otf_core.history.drift import Drift, Due, drift_of, due
from otf_core.history.series import Series, series_of
from otf_core.history.store import Store, StoredEvent


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


@dataclass(frozen=True)
class History:
    """One machine.

    Attributes
    ----------
    machine : str
    series : Series
    chart : tuple of mapping
        For every run the change of each motion since the reference.
    volume : tuple of Change
        The same over the volume.
    steps : tuple of Step
    reference : int
        First run since the last event.
    drift : Drift, optional
        Since then; None from fewer than two runs.
    due : Due, optional
    """

    machine: str
    series: Series
    chart: tuple[dict[str, Change], ...]
    volume: tuple[Change, ...]
    steps: tuple[Step, ...]
    reference: int
    drift: Drift | None
    due: Due | None


def _between(store: Store, series: Series, run: int) -> tuple[StoredEvent, ...]:
    """Events between a run and the one before."""
    low, high = series.runs[run - 1].at, series.runs[run].at
    return tuple(e for e in store.events if low < e.at <= high)


def uncertainty(series: Series) -> float:
    """Mean standard uncertainty of the latest tables over the grid, m."""
    rows = series.field_rows
    variance = np.einsum('ij,ij->i', rows @ series.covariances[-1], rows)
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
    later = series.since(reference)
    drift = drift_of(later)
    allowed = 2.0 * uncertainty(series) if limit is None else limit
    return History(
        machine,
        series,
        tuple(changes(series, reference, k) for k in range(count)),
        tuple(volume_change(series, reference, k) for k in range(count)),
        steps,
        reference,
        drift,
        None if drift is None else due(drift, allowed),
    )
