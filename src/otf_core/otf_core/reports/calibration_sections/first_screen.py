# SPDX-License-Identifier: Apache-2.0
"""First screen of a page, summary of a terminal, verdict: is it good, how large is the error."""

from __future__ import annotations

import numpy as np

from otf_core.budget.typical import typical_warnings
from otf_core.calibration.result import Fit
from otf_core.calibration.verdict import FAIL, OPEN, PASS, UNKNOWN, WHAT, Judged, Verdicts
from otf_core.model.expanded import (
    figure,
    micro_figure,
    micro_significant,
    micro_with_expanded,
    significant,
    with_expanded,
)
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.calibration_pictures import error_bars, volume_pictures
from otf_core.reports.condition_tables import measured
from otf_core.reports.drawing.scene import SCRIPT
from otf_core.reports.page import Heading
from otf_core.reports.section import Cell, Section, State, Table
from otf_core.reports.wording import listed, micro, micro_unit, place

NAMED_CONTRIBUTORS = 3
"""Motions that are named as the largest contributors."""
MOODS = {PASS: 'good', FAIL: 'bad', OPEN: 'open', UNKNOWN: 'open'}
SUMMARY_CONTRIBUTORS = 4
"""Errors that are named as the largest contributors."""
SUMMARY_WARNINGS, SUMMARY_WIDTH = 3, 110
"""Warnings that are shown, and letters of each; summary.txt has all of them."""


def overview_section(facts: Facts) -> Section:
    """First screen: is it good, how large is the error, where is it worst, what is not known."""
    result, volume = facts.result, facts.volume
    now = result.headline.error
    at = volume.grid[int(np.argmax(volume.length))]
    worst = contributions(facts)[:NAMED_CONTRIBUTORS]
    mean = result.headline.expanded['mean']
    words = [
        f'Worst: the longest error vector of the grid, '
        f'{micro_figure(now["max"], result.headline.of_largest)}, lies at '
        f'{place(at)}. Most is due to '
        + listed(f'{name} ({micro_figure(size, mean)})' for name, size in worst)
        + ', each alone, root mean square over the volume.',
        *_unknown_words(facts),
    ]
    warnings = [
        f'Warning: {w}' for w in result.warnings if w not in typical_warnings(facts.typical)
    ]
    return Section(
        'overview',
        '',
        tuple(words + warnings),
        {
            'headline': result.headline.to_dict(),
            'verdicts': result.verdicts.to_dict(),
            'worst_at': at.tolist(),
            'contributions': dict(contributions(facts)),
            'warnings': list(result.warnings),
        },
        text=_overview_lines(facts),
        draw=lambda: (volume_pictures(facts), error_bars(facts)),
        script=SCRIPT,
    )


def _overview_lines(facts: Facts) -> tuple[str, ...]:
    result, fit, machine = facts.result, facts.result.fit, facts.machine
    return (
        *(f'WARNING {line}' for line in result.warnings),
        f'{machine.name}, chain {machine.chain}, run {result.run_id}',
        f'samples {fit.samples}, used {fit.used} in {fit.pieces} path pieces; '
        f'{fit.unknowns} unknowns, rank {fit.rank}; path driven {100 * fit.coverage:.1f} %',
        f'mean distance from the path {micro(fit.path_mae_before)} um, compensated '
        f'{micro(fit.path_mae_after)} um; residual rms {micro(fit.residual_rms)} um',
        f'the volumetric error is that of {result.headline.points} points of a regular grid over '
        f'the whole volume, best rigid motion taken out',
    )


def contributions(facts: Facts) -> list[tuple[str, float]]:
    """What every motion and squareness error makes alone, root mean square, m; largest first."""
    names = [n for n in (*SQUARENESS, *MOTIONS) if n not in facts.result.not_identifiable]
    sizes = [float(np.sqrt(np.mean(np.sum(facts.volume.part(n) ** 2, axis=1)))) for n in names]
    return sorted(zip(names, sizes, strict=True), key=lambda pair: -pair[1])


def heading(facts: Facts) -> Heading:
    """Top of the page."""
    result, machine = facts.result, facts.machine
    error, expected, _ = result.headline.words
    sentence = f'{error[:1].upper()}{error[1:]}; {expected}.'
    return Heading(
        f'Calibration of {machine.name}, chain {machine.chain}',
        sentence,
        badges(result.verdicts),
        _tiles(facts),
        running_words(facts),
    )


def badges(verdicts: Verdicts) -> tuple[State, State]:
    """One for the measurement, one for the machine."""
    measurement = (
        State('measurement: good', 'good')
        if verdicts.good
        else State('measurement: not good', 'bad')
    )
    machine = verdicts.machine
    if machine is None:
        return measurement, State('machine: no limits stated')
    mood = {PASS: 'good', FAIL: 'bad'}.get(machine.state, 'open')
    return measurement, State(f'machine: {machine.sentence}', mood)


def running_words(facts: Facts) -> str:
    """Head of printed pages: machine, run, date."""
    date = measured(facts.result.origin) or f'written {facts.provenance["written"]}'
    return f'{facts.machine.name}, run {facts.result.run_id}, {date}'


def _unknown_words(facts: Facts) -> list[str]:
    result, found = facts.result, []
    if result.not_identifiable:
        found.append(
            f'Not known: {listed(result.not_identifiable)} cannot be determined from these data; '
            f'they stand as zero in the tables.'
        )
    if facts.typical:
        found.append(
            f'Not declared in machine.yaml: {listed(facts.typical.missing)}; U holds typical '
            f'values of them.'
        )
    return found or ['Not known: all motions were determined and all contributions declared.']


def _tiles(facts: Facts) -> tuple[tuple[str, str, str], ...]:
    first, fit = facts.result.headline, facts.result.fit
    return (
        (
            'Volumetric error, as the machine stands',
            micro_with_expanded(first.error['max'], first.of_largest),
            f'largest; mean {micro_figure(first.error["mean"], first.expanded["mean"])}',
        ),
        (
            'Expected after compensation',
            micro_significant(first.expanded['max']),
            f'largest U (k = {first.k:.3g}), mean {micro_significant(first.expanded["mean"])}; '
            f'{first.label}; {first.observed_words}',
        ),
        (
            'Distance from the path, measured',
            f'{micro(fit.path_mae_before)} → {micro(fit.path_mae_after)} um',
            'mean, before and after compensation, on the run the tables come from',
        ),
    )


def limits_section(facts: Facts) -> Section:
    """Verdict by the limits of machine.yaml, limit by limit."""
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
    rows = tuple(_limit_row(one) for one in verdict.judged)
    head = ('Quantity', 'Value', 'U (95 %)', 'Limit', 'Unit', 'State')
    table = Table(head, rows, numbers=(1, 2, 3), stacked=True)
    return Section('limits', 'Verdict', tuple(words), facts.result.verdicts.to_dict(), (table,))


def _limit_row(one: Judged) -> tuple[Cell, ...]:
    what = WHAT.get(one.name, f'{one.name}')
    unit = micro_unit(one.unit)
    value = '' if one.state == UNKNOWN else figure(1e6 * one.value, 1e6 * (one.U or one.value))
    wide = significant(1e6 * one.U) if one.U else ''
    return what, value, wide, f'{1e6 * one.limit:g}', unit, State(one.state, MOODS[one.state])


def calibration_summary(facts: Facts) -> str:
    """Return the lines of a terminal; ``calibration_sections`` hold all the rest."""
    result, fit = facts.result, facts.result.fit
    lines = [
        f'{facts.machine.name}, chain {facts.machine.chain}, run {result.run_id}',
        *result.verdicts.words,
        *result.headline.words,
        _contributors_line(facts),
        _squareness_line(facts),
        *filter(None, [result.offset_bound.sentence]),
        f'distance from the path: mean {_distance_figure(fit.path_mae_before, fit)} before, '
        f'{_distance_figure(fit.path_mae_after, fit)} after compensation, on the run itself',
    ]
    if result.not_identifiable:
        lines.append(f'not seen, zero in the tables: {", ".join(result.not_identifiable)}')
    if result.effects_sentence:
        lines.append(result.effects_sentence)
    lines += _warning_lines(facts)
    return '\n'.join(lines)


def _contributors_line(facts: Facts) -> str:
    first = facts.result.headline
    named = (
        f'{name} {micro_figure(size, first.expanded["mean"])}'
        for name, size in contributions(facts)[:SUMMARY_CONTRIBUTORS]
    )
    return f'largest contributions, each alone, rms over the volume: {", ".join(named)}'


def _squareness_line(facts: Facts) -> str:
    result, said = facts.result, []
    for name in SQUARENESS:
        if name in result.not_identifiable:
            said.append(f'{name} not known')
            continue
        value, wide = result.tables.squareness[name].value, float(result.expanded[name][0])
        said.append(f'{name} {with_expanded(1e6 * value, 1e6 * wide)} urad')
    return f'squareness: {", ".join(said)}'


def _distance_figure(value: float, fit: Fit) -> str:
    """A distance, to two digits of what compensation leaves."""
    return micro_figure(value, fit.path_mae_after)


def _warning_lines(facts: Facts) -> list[str]:
    said = typical_warnings(facts.typical)
    every = [w for w in facts.result.warnings if w not in said]
    lines = [f'warning: {shortened(w)}' for w in every[:SUMMARY_WARNINGS]]
    more = len(every) - SUMMARY_WARNINGS
    if more > 0:
        lines.append(f'warning: {more} more in summary.txt')
    return lines


def shortened(text: str) -> str:
    """One line of a long warning: its first clauses, as many as fit."""
    if len(text) <= SUMMARY_WIDTH:
        return text
    cut = max(text.rfind(mark, 0, SUMMARY_WIDTH) for mark in ('; ', ': ', ', ', ' '))
    return f'{text[:cut].rstrip(" ,;:")} ...'
