# SPDX-License-Identifier: Apache-2.0
"""Conditions and instrument: what was driven, when, with what, and what nobody stated."""

from __future__ import annotations

import numpy as np

from otf_core.calibration.result import RunResult
from otf_core.model.circumstances import INSTRUMENT, NUMBERS, TEXTS
from otf_core.model.machine import TrackerSpec
from otf_core.model.provenance import Origin, moment
from otf_core.noise.model import QUANTITIES
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.quantities import listed, place
from otf_core.reports.section import Section, Table


def section(facts: Facts) -> Section:
    """Return the section."""
    result, machine = facts.result, facts.machine
    stated = machine.stated
    instrument = [(words, stated.instrument.get(key)) for key, words in INSTRUMENT.items()]
    about = [(words, stated.conditions.get(key)) for key, words in TEXTS.items()]
    for key, (words, unit, _, _) in NUMBERS.items():
        value = stated.conditions.get(key)
        about.append((words, None if value is None else f'{value:g} {unit}'))
    missing = [words for words, value in (*about, *instrument) if value is None]
    instrument.append(('specified standard uncertainties (k = 1)', _specified(machine.tracker)))
    tables = [
        Table(('', ''), tuple((w, str(v)) for w, v in rows if v is not None), title=title)
        for title, rows in (('Conditions', about), ('Instrument', instrument))
        if any(v is not None for _, v in rows)
    ]
    tables += [_run(n, run) for n, run in enumerate(result.runs, start=1)]
    said = (f'Not stated: {listed(missing)}. machine.yaml has the sections conditions and '
            f'instrument for it.',) if missing else ()  # fmt: skip
    data = {'instrument': dict(stated.instrument), 'conditions': dict(stated.conditions)}
    text = tuple(_run_line(number, run) for number, run in enumerate(result.runs, start=1))
    return Section('conditions', 'Conditions and instrument', said, data, tuple(tables), text)


def _specified(tracker: TrackerSpec) -> str:
    preset = f' (preset {tracker.preset})' if tracker.preset else ''
    return (
        f'{1e6 * tracker.u_range:.2f} um along the beam, {1e6 * tracker.u_angle:.2f} urad of each '
        f'angle{preset}'
    )


def measured(origins: tuple[Origin, ...]) -> str:
    """First and last stamp as dates, in words; empty if the stamps tell none."""
    dates = [moment(ns) for o in origins for ns in (o.first_ns, o.last_ns)]
    known = sorted(d for d in dates if d is not None)
    return f'{known[0][:19]}Z to {known[-1][:19]}Z' if known else ''


def _run(number: int, run: RunResult) -> Table:
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


def _run_line(number: int, run: RunResult) -> str:
    where, offset = (
        ', '.join(f'{v:.3f}' for v in vector)
        for vector in (run.T_machine_tracker.translation, run.target_offset)
    )
    return (
        f'run {number}{f" ({run.name})" if run.name else ""}: {run.samples} samples, '
        f'{100 * run.coverage:.1f} % driven, tracker at ({where}) m, target offset ({offset}) m'
    )
