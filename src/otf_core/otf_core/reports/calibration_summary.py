# SPDX-License-Identifier: Apache-2.0
"""A calibration in a dozen lines: verdicts, headline, worst errors, warnings, what to open."""

from __future__ import annotations

from otf_core.budget.typical import typical_warnings
from otf_core.calibration.result import Fit
from otf_core.model.expanded import micro_figure, with_expanded
from otf_core.model.motions import SQUARENESS
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.calibration_sections.overview import contributions

WORST = 4
"""Errors that are named as the largest contributors."""
WARNINGS, WIDTH = 3, 110
"""Warnings that are shown, and letters of each; summary.txt has all of them."""


def calibration_summary(facts: Facts) -> str:
    """Return the lines of a terminal; ``calibration_sections`` hold all the rest."""
    result, fit = facts.result, facts.result.fit
    lines = [
        f'{facts.machine.name}, chain {facts.machine.chain}, run {result.run_id}',
        *result.verdicts.words,
        *result.headline.words,
        _worst(facts),
        _squareness(facts),
        *filter(None, [result.offset_bound.sentence]),
        f'distance from the path: mean {_um(fit.path_mae_before, fit)} before, '
        f'{_um(fit.path_mae_after, fit)} after compensation, on the run itself',
    ]
    if result.not_identifiable:
        lines.append(f'not seen, zero in the tables: {", ".join(result.not_identifiable)}')
    if result.effects_sentence:
        lines.append(result.effects_sentence)
    lines += _warnings(facts)
    return '\n'.join(lines)


def _worst(facts: Facts) -> str:
    first = facts.result.headline
    named = (
        f'{name} {micro_figure(size, first.expanded["mean"])}'
        for name, size in contributions(facts)[:WORST]
    )
    return f'largest contributions, each alone, rms over the volume: {", ".join(named)}'


def _squareness(facts: Facts) -> str:
    result, said = facts.result, []
    for name in SQUARENESS:
        if name in result.not_identifiable:
            said.append(f'{name} not known')
            continue
        value, wide = result.tables.squareness[name].value, float(result.expanded[name][0])
        said.append(f'{name} {with_expanded(1e6 * value, 1e6 * wide)} urad')
    return f'squareness: {", ".join(said)}'


def _um(value: float, fit: Fit) -> str:
    """A distance, to two digits of what compensation leaves."""
    return micro_figure(value, fit.path_mae_after)


def _warnings(facts: Facts) -> list[str]:
    said = typical_warnings(facts.typical)
    every = [w for w in facts.result.warnings if w not in said]
    lines = [f'warning: {shortened(w)}' for w in every[:WARNINGS]]
    more = len(every) - WARNINGS
    if more > 0:
        lines.append(f'warning: {more} more in summary.txt')
    return lines


def shortened(text: str) -> str:
    """One line of a long warning: its first clauses, as many as fit."""
    if len(text) <= WIDTH:
        return text
    cut = max(text.rfind(mark, 0, WIDTH) for mark in ('; ', ': ', ', ', ' '))
    return f'{text[:cut].rstrip(" ,;:")} ...'
