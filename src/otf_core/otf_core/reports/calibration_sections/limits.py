# SPDX-License-Identifier: Apache-2.0
"""Verdict by the limits of machine.yaml, limit by limit."""

from __future__ import annotations

from otf_core.calibration.verdict import FAIL, OPEN, PASS, UNKNOWN, WHAT, Judged
from otf_core.model.expanded import figure, significant
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.quantities import listed, micro_unit
from otf_core.reports.section import Cell, Section, State, Table

MOODS = {PASS: 'good', FAIL: 'bad', OPEN: 'open', UNKNOWN: 'open'}


def section(facts: Facts) -> Section:
    """Return the section."""
    verdict, typical = facts.result.machine_verdict, facts.typical
    rule = (
        'Decision rule (ISO 14253-1): a limit is kept if value + U is at most the limit, broken '
        'if value - U is above it; in between neither is proven, which does not pass.'
    )
    if verdict is None:
        lead = 'No verdict: machine.yaml states no limits (section limits).'
        return Section('limits', 'Verdict', (lead, rule))
    words = [f'{verdict.sentence[:1].upper()}{verdict.sentence[1:]}.', rule]
    if typical:
        words.append(
            f'U holds typical values for what machine.yaml does not declare: '
            f'{listed(typical.missing)}.'
        )
    rows = tuple(_row(one) for one in verdict.judged)
    head = ('Quantity', 'Value', 'U (95 %)', 'Limit', 'Unit', 'State')
    table = Table(head, rows, numbers=(1, 2, 3), stacked=True)
    return Section('limits', 'Verdict', tuple(words), facts.result.verdicts.to_dict(), (table,))


def _row(one: Judged) -> tuple[Cell, ...]:
    what = WHAT.get(one.name, f'{one.name}')
    unit = micro_unit(one.unit)
    value = '' if one.state == UNKNOWN else figure(1e6 * one.value, 1e6 * (one.U or one.value))
    wide = significant(1e6 * one.U) if one.U else ''
    return what, value, wide, f'{1e6 * one.limit:g}', unit, State(one.state, MOODS[one.state])
