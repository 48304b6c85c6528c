# SPDX-License-Identifier: Apache-2.0
"""First screen: is it good, how large is the error, what is worst and where, what is not known."""

from __future__ import annotations

import numpy as np

from otf_core.budget.typical import typical_warnings
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
    now, after, k = volume.sizes(), volume.u_sizes(), facts.k_volume
    at = volume.grid[int(np.argmax(volume.length))]
    worst = contributions(facts)[:WORST]
    words = [
        f'Worst: the longest error vector of the grid, {micro(now["max"])} um, lies at '
        f'{place(at)}. Most is due to '
        + listed(f'{name} ({micro(size)} um)' for name, size in worst)
        + ', each alone, root mean square over the volume.',
        _good(facts),
        *(f'{line[:1].upper()}{line[1:]}.' for line in _failures(facts)),
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
            'volumetric_error': dict(now),
            'expected_after_compensation': {'u': after, 'k': k, 'U_max': k * after['max']},
            'worst_at': at.tolist(),
            'contributions': dict(contributions(facts)),
            'failed_gates': list(result.failed_gates),
            'warnings': list(result.warnings),
            **({'verdict': result.verdict.to_dict()} if result.verdict else {}),
        },
        text=_text(facts),
        draw=lambda: (volume_pictures(facts), error_bars(facts)),
        script=SCRIPT,
    )


def _text(facts: Facts) -> tuple[str, ...]:
    result, fit, machine = facts.result, facts.result.fit, facts.machine
    now = facts.volume.sizes()
    return (
        *(f'WARNING {line}' for line in result.warnings),
        *(f'FAILED {line}' for line in result.failed_gates),
        *((result.verdict.sentence,) if result.verdict else ()),
        f'{machine.name}, chain {machine.chain}, run {result.run_id}',
        f'samples {fit.samples}, used {fit.used} in {fit.pieces} path pieces; '
        f'{fit.unknowns} unknowns, rank {fit.rank}; path driven {100 * fit.coverage:.1f} %',
        f'mean distance from the path {micro(fit.path_mae_before)} um, compensated '
        f'{micro(fit.path_mae_after)} um; residual rms {micro(fit.residual_rms)} um',
        f'volumetric error that these tables predict on {len(facts.volume.grid)} points of the '
        f'whole volume: mean {micro(now["mean"])} um, 95 % below {micro(now["p95"])} um, largest '
        f'{micro(now["max"])} um (best rigid motion taken out)',
    )


def contributions(facts: Facts) -> list[tuple[str, float]]:
    """What every motion and squareness error makes alone, root mean square, m; largest first."""
    names = [n for n in (*SQUARENESS, *MOTIONS) if n not in facts.result.not_identifiable]
    sizes = [float(np.sqrt(np.mean(np.sum(facts.volume.part(n) ** 2, axis=1)))) for n in names]
    return sorted(zip(names, sizes, strict=True), key=lambda pair: -pair[1])


def heading(facts: Facts) -> Heading:
    """Top of the page."""
    result, machine = facts.result, facts.machine
    now, after = facts.volume.sizes(), facts.volume.u_sizes()
    sentence = (
        f'Volumetric error up to {micro(now["max"])} um. Compensated with these tables, errors '
        f'within {micro(facts.k_volume * after["max"])} um are to be expected (U, 95 %)'
        + (', as far as u is stated.' if facts.typical else '.')
    )
    verdict = result.verdict
    badge = State('no limits stated')
    if verdict and verdict.passed:
        badge = State('pass', 'good')
    elif verdict:
        badge = State('fail', 'bad')
    if own_gates(facts):
        badge = State('quality gate failed', 'bad')
    if verdict:
        sentence = f'{verdict.sentence[:1].upper()}{verdict.sentence[1:]}. {sentence}'
    return Heading(
        f'Calibration of {machine.name}, chain {machine.chain}',
        sentence,
        (badge,),
        _tiles(facts),
        running_words(facts),
    )


def running_words(facts: Facts) -> str:
    """Head of printed pages: machine, run, date."""
    date = measured(facts.result.origin) or f'written {facts.provenance["written"]}'
    return f'{facts.machine.name}, run {facts.result.run_id}, {date}'


def own_gates(facts: Facts) -> list[str]:
    """Quality gates that failed, limits left out."""
    verdict = facts.result.verdict
    known = verdict.failures if verdict else ()
    return [gate for gate in facts.result.failed_gates if gate not in known]


def _good(facts: Facts) -> str:
    fit, gates = facts.result.fit, own_gates(facts)
    if gates:
        return f'Not good: {"; ".join(gates)}.'
    return (
        f'Quality: all checks of this calibration passed; the tables leave '
        f'{micro(fit.residual_rms)} um root mean square across the path, '
        f'{fit.residual_ratio:.2f} times the noise that is specified for single samples.'
    )


def _failures(facts: Facts) -> tuple[str, ...]:
    return facts.result.verdict.failures if facts.result.verdict else ()


def _unknown(facts: Facts) -> list[str]:
    result, found = facts.result, []
    if result.not_identifiable:
        found.append(
            f'Not known: {listed(result.not_identifiable)} cannot be determined from these data; '
            f'they stand as zero in the tables.'
        )
    typical = facts.typical
    if typical:
        stated, with_them = typical.grid
        found.append(
            f'Not known: nothing is declared for {listed(typical.missing)}, so U does not hold '
            f'them. With typical values the standard uncertainty of the error vectors would be '
            f'{micro(with_them)} um instead of {micro(stated)} um (k = 1, root mean square).'
        )
    return found or ['Not known: all motions were determined and all contributions declared.']


def _tiles(facts: Facts) -> tuple[tuple[str, str, str], ...]:
    now, after, k = facts.volume.sizes(), facts.volume.u_sizes(), facts.k_volume
    fit, more = facts.result.fit, ''
    if facts.typical:
        more = f'; typically {micro(facts.typical.grid[1])} um (k = 1) with what is not declared'
    return (
        (
            'Volumetric error, as the machine stands',
            f'{micro(now["max"])} um',
            f'largest; mean {micro(now["mean"])} um, 95 % below {micro(now["p95"])} um',
        ),
        (
            'Expected after compensation',
            f'{micro(k * after["max"])} um',
            f'largest U (95 %), mean {micro(k * after["mean"])} um: predicted, not measured{more}',
        ),
        (
            'Distance from the path, measured',
            f'{micro(fit.path_mae_before)} → {micro(fit.path_mae_after)} um',
            'mean, before and after compensation, on the run the tables come from',
        ),
    )
