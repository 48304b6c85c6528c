# SPDX-License-Identifier: Apache-2.0
"""Conditions of the runs, versions and hashes."""

from __future__ import annotations

from otf_core.diagnosis.result import Diagnosis
from otf_core.model.provenance import moment
from otf_core.reports.section import Section, Table
from otf_core.version import __version__


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    rows = [('runs', ', '.join(diagnosis.runs)), ('otf_core', __version__)]
    rows += list(diagnosis.shown.conditions.items())
    for one in diagnosis.origin:
        name = one.name or 'the run'
        dates = moment(one.first_ns), moment(one.last_ns)
        when = f'{dates[0]} to {dates[1]}' if all(dates) else 'the stamps tell no date'
        rows += [(f'{name}: measured', when), (f'{name}: SHA-256', one.sha256)]
    table = Table(('', ''), tuple(rows))
    return Section('conditions', 'Conditions', (), dict(rows), (table,))
