# SPDX-License-Identifier: Apache-2.0
"""Conditions and instrument: what was driven, when, with what, and what nobody stated."""

from __future__ import annotations

from otf_core.calibration.result import RunResult
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.circumstances import run_table, stated
from otf_core.reports.quantities import millimetres
from otf_core.reports.section import Section


def section(facts: Facts) -> Section:
    """Return the section."""
    result, given = facts.result, facts.machine.stated
    tables, said = stated(facts.machine)
    tables += [run_table(n, run) for n, run in enumerate(result.runs, start=1)]
    data = {'instrument': dict(given.instrument), 'conditions': dict(given.conditions)}
    text = tuple(_run_line(number, run) for number, run in enumerate(result.runs, start=1))
    return Section('conditions', 'Conditions and instrument', said, data, tuple(tables), text)


def _run_line(number: int, run: RunResult) -> str:
    where, offset = (
        ', '.join(map(millimetres, vector))
        for vector in (run.T_machine_tracker.translation, run.target_offset)
    )
    return (
        f'run {number}{f" ({run.name})" if run.name else ""}: {run.samples} samples, '
        f'{100 * run.coverage:.1f} % driven, tracker at ({where}) mm, target offset ({offset}) mm'
    )
