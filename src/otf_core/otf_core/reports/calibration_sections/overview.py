# SPDX-License-Identifier: Apache-2.0
"""First screen: is it good, how large is the error, what is worst and where, what is not known."""

from __future__ import annotations

import numpy as np

from otf_core.budget.typical import typical_warnings
from otf_core.calibration.verdict import FAIL, PASS, Verdicts
from otf_core.model.expanded import micro_figure, micro_significant, micro_with_expanded
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.calibration_pictures import error_bars, volume_pictures
from otf_core.reports.circumstances import measured
from otf_core.reports.drawing.scene import SCRIPT
from otf_core.reports.page import Heading
from otf_core.reports.quantities import listed, micro, place
from otf_core.reports.section import Section, State

WORST = 3
"""Motions that are named as the largest contributors."""


def section(facts: Facts) -> Section:
    """Return the section."""
    result, volume = facts.result, facts.volume
    now = result.headline.error
    at = volume.grid[int(np.argmax(volume.length))]
    worst = contributions(facts)[:WORST]
    mean = result.headline.expanded['mean']
    words = [
        f'Worst: the longest error vector of the grid, '
        f'{micro_figure(now["max"], result.headline.of_largest)}, lies at '
        f'{place(at)}. Most is due to '
        + listed(f'{name} ({micro_figure(size, mean)})' for name, size in worst)
        + ', each alone, root mean square over the volume.',
        *_unknown(facts),
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
        text=_text(facts),
        draw=lambda: (volume_pictures(facts), error_bars(facts)),
        script=SCRIPT,
    )


def _text(facts: Facts) -> tuple[str, ...]:
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


def _unknown(facts: Facts) -> list[str]:
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
