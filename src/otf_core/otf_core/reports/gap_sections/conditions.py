# SPDX-License-Identifier: Apache-2.0
"""Conditions and instrument, the runs, versions and hashes."""

from __future__ import annotations

from otf_core.diagnosis.result import Diagnosis
from otf_core.model.provenance import moment
from otf_core.reports.circumstances import run_table, stated
from otf_core.reports.section import Section, Table
from otf_core.version import __version__

OF_RUNS = ('samples',)
"""Conditions that the tables of the runs show."""


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    plain = diagnosis.calibration.plain
    rows = [('runs', ', '.join(diagnosis.runs)), ('otf_core', __version__)]
    rows += list(diagnosis.shown.conditions.items())
    for one in diagnosis.origin:
        name = one.name or 'the run'
        dates = moment(one.first_ns), moment(one.last_ns)
        when = f'{dates[0]} to {dates[1]}' if all(dates) else 'the stamps tell no date'
        rows += [(f'{name}: measured', when), (f'{name}: SHA-256', one.sha256)]
    tables, said = stated(plain.tables.machine)
    tables += [run_table(number, run) for number, run in enumerate(plain.runs, start=1)]
    shown = tuple(row for row in rows if row[0] not in OF_RUNS)
    tables.append(Table(('', ''), shown, title='Recordings and versions'))
    return Section('conditions', 'Conditions and instrument', said, dict(rows), tuple(tables))
