# SPDX-License-Identifier: Apache-2.0
"""What the sections of a calibration report share: facts, budget and conditions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.lines import BudgetLine
from otf_core.budget.typical import TypicalSystematic
from otf_core.calibration.calibration_result import CalibrationResult, RunResult
from otf_core.files.writing import tidy
from otf_core.model.machine import Machine, TrackerSpec
from otf_core.model.provenance import Origin, moment
from otf_core.model.sections import INSTRUMENT, NUMBERS, TEXTS
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import QUANTITIES
from otf_core.prediction.volumetric import VolumetricError
from otf_core.reports.page import Table, join_names, place

# The budget as data and as text: expanded uncertainties, sources, correlations.

LATTICE_AXES = 3
"""Axes up to which the volumetric error is stated on a lattice, see ``driven_positions``."""
SHORTEST_EDGE = 0.05
"""Of a box that is drawn, in its longest."""


def position_words(machine: Machine, q: Array) -> str:
    """Axis positions (k,), m and rad, in words: to 0.1 mm and 0.1 deg."""
    parts: dict[str, list[str]] = {}
    for axis, value in zip(machine.axis_names, q.tolist(), strict=True):
        factor, unit = machine.axes[axis].shown
        parts.setdefault(unit, []).append(f'{axis} {tidy(round(factor * value, 1)):g}')
    return ', '.join(f'{", ".join(own)} {unit}' for unit, own in parts.items())


# What the sections of a calibration's report share: the result, and what is computed once.


@dataclass(frozen=True)
class CalibrationFacts:
    """A calibration, its budget and where it comes from.

    Attributes
    ----------
    provenance : mapping
        Block of that name in error_tables.json.
    """

    result: CalibrationResult
    lines: tuple[BudgetLine, ...]
    provenance: Mapping[str, Any]

    @property
    def tables(self) -> ErrorTables:
        """Error tables."""
        return self.result.tables

    @property
    def machine(self) -> Machine:
        """The machine as set up in the first run."""
        return self.result.tables.machine

    @property
    def typical(self) -> TypicalSystematic | None:
        """What typical systematic contributions would add; None if all are declared."""
        return self.result.typical

    @cached_property
    def by_name(self) -> dict[str, BudgetLine]:
        """Lines of the budget by name."""
        return {line.name: line for line in self.lines}

    @property
    def volume(self) -> VolumetricError:
        """Errors over the volume of the tables, with the uncertainty of the headline."""
        return self.result.volume

    @property
    def points(self) -> str:
        """Where the volumetric error is stated, in words."""
        if len(self.machine.axis_names) > LATTICE_AXES:
            return f'{len(self.volume.grid)} positions spread over the driven ranges of all axes'
        return f'{len(self.volume.grid)} points of a regular grid over the driven volume'

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Corners of a box around the volume, m; no edge is much shorter than the others."""
        low, high = self.volume.grid.min(axis=0), self.volume.grid.max(axis=0)
        lack = np.maximum(0.0, SHORTEST_EDGE * (high - low).max() - (high - low))
        return low - 0.5 * lack, high + 0.5 * lack

    @cached_property
    def condition_number(self) -> float:
        """Largest over smallest standard uncertainty of what the covariance holds, um and urad."""
        covariance = self.result.covariance
        size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        own = size > 1e-6 * size.max(initial=0.0)
        if not own.any():
            return 1.0
        values = np.linalg.eigvalsh(covariance[np.ix_(own, own)])
        positive = values[values > 1e-12 * values[-1]]
        return float(np.sqrt(positive[-1] / positive[0]))

    @property
    def both_ways(self) -> bool:
        """True if forward and backward travel differ in this calibration."""
        return any(t.identifiable for t in self.result.reversal.motions.values())


# Conditions and instrument of reports: what was driven, with what, what is not stated.


def stated_tables(machine: Machine) -> tuple[list[Table], tuple[str, ...]]:
    """Tables of what machine.yaml states, and words about what it does not."""
    given = machine.stated
    instrument = [(words, given.instrument.get(key)) for key, words in INSTRUMENT.items()]
    about = [(words, given.conditions.get(key)) for key, words in TEXTS.items()]
    for key, (words, unit, _, _) in NUMBERS.items():
        value = given.conditions.get(key)
        about.append((words, None if value is None else f'{value:g} {unit}'))
    wished = [row for row in (*about, *instrument) if row[0] != TEXTS['remark']]
    missing = [words for words, value in wished if value is None]
    instrument.append(('specified standard uncertainties (k = 1)', _specified(machine.tracker)))
    tables = [
        Table(('', ''), tuple((w, str(v)) for w, v in rows if v is not None), title=title)
        for title, rows in (('Conditions', about), ('Instrument', instrument))
        if any(v is not None for _, v in rows)
    ]
    if not missing:
        return tables, ()
    sections = 'State it in the sections conditions and instrument of machine.yaml.'
    return tables, (f'Not stated: {join_names(missing)}. {sections}',)


def _specified(tracker: TrackerSpec) -> str:
    preset = f' (preset {tracker.preset})' if tracker.preset else ''
    return (
        f'{1e6 * tracker.u_range:.2f} um along the beam, {1e6 * tracker.u_angle:.2f} urad of each '
        f'angle{preset}'
    )


def measurement_dates(origins: Iterable[Origin]) -> str:
    """First and last stamp as dates, in words; empty if the stamps tell none."""
    dates = [moment(ns) for o in origins for ns in (o.first_ns, o.last_ns)]
    known = sorted(d for d in dates if d is not None)
    return f'{known[0][:19]}Z to {known[-1][:19]}Z' if known else ''


def run_table(number: int, run: RunResult) -> Table:
    """How a run was driven, and from where it was seen."""
    pieces = run.pieces
    noise = '; '.join(
        f'{name} {1e6 * part.level:.2f} {"um" if name == QUANTITIES[0] else "urad"}'
        for name, part in zip(QUANTITIES, run.noise, strict=True)
    )
    feeds = np.quantile(run.speed, (0.05, 0.5, 0.95)) * 6e4
    rows = [
        ('duration', f'{float((pieces.time + pieces.duration).max()):.1f} s'),
        ('samples', f'{run.samples}, {run.rate:.1f} Hz'),
        ('path driven', f'{100 * run.coverage:.1f} %'),
        ('tracker at', place(run.T_machine_tracker.translation)),
        ('target offset', place(run.target_offset)),
        ('noise of single samples, from the residuals (k = 1)', noise),
    ]
    if not pieces.standstill:
        rows.insert(2, ('feed', f'{feeds[1]:.0f} mm/min, 90 % of the path between '
                        f'{feeds[0]:.0f} and {feeds[2]:.0f}'))  # fmt: skip
    if len(run.parts) > 1:
        rows += [
            (f'part {n}', f'{p.target}, {p.corners} corners, {100 * p.driven:.1f} % driven')
            for n, p in enumerate(run.parts, start=1)
        ]
    return Table(('', ''), tuple(rows), title=f'Run {number} {run.name}'.strip())
