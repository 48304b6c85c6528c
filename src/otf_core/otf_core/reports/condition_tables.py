# SPDX-License-Identifier: Apache-2.0
"""Conditions and instrument of reports: what was driven, with what, what is not stated."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from otf_core.calibration.result import RunResult
from otf_core.model.circumstances import INSTRUMENT, NUMBERS, TEXTS
from otf_core.model.machine import Machine, TrackerSpec
from otf_core.model.provenance import Origin, moment
from otf_core.noise.model import QUANTITIES
from otf_core.reports.section import Table
from otf_core.reports.wording import listed, place


def stated(machine: Machine) -> tuple[list[Table], tuple[str, ...]]:
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
    said = (f'Not stated: {listed(missing)}. machine.yaml has the sections conditions and '
            f'instrument for it.',) if missing else ()  # fmt: skip
    return tables, said


def _specified(tracker: TrackerSpec) -> str:
    preset = f' (preset {tracker.preset})' if tracker.preset else ''
    return (
        f'{1e6 * tracker.u_range:.2f} um along the beam, {1e6 * tracker.u_angle:.2f} urad of each '
        f'angle{preset}'
    )


def measured(origins: Iterable[Origin]) -> str:
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
    feeds = np.quantile(pieces.speed, (0.05, 0.5, 0.95)) * 6e4
    rows = [
        ('duration', f'{pieces.end or float(pieces.time.max()):.1f} s'),
        ('samples', f'{run.samples}, {run.rate:.1f} Hz'),
        ('path driven', f'{100 * run.coverage:.1f} %'),
        ('tracker at', place(run.T_machine_tracker.translation)),
        ('target offset', place(run.target_offset)),
        ('noise of single samples, from the residuals (k = 1)', noise),
    ]
    if not pieces.standstill:
        rows.insert(2, ('feed', f'{feeds[1]:.0f} mm/min, 90 % of the path between '
                        f'{feeds[0]:.0f} and {feeds[2]:.0f}'))  # fmt: skip
    return Table(('', ''), tuple(rows), title=f'Run {number} {run.name}'.strip())
