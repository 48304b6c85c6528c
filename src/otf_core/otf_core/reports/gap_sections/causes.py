# SPDX-License-Identifier: Apache-2.0
"""The causes that were found, ranked, with their parameters."""

from __future__ import annotations

from otf_core.diagnosis.corrected_calibration import in_reversal_tables
from otf_core.diagnosis.result import Diagnosis, NamedCause
from otf_core.effects import REGISTRY, BelongsTo
from otf_core.model.quantities import quantity
from otf_core.reports.gap_words import (
    confidence_words,
    effect_cause,
    effect_meaning,
    effect_name,
    left_out_words,
    shape_words,
    shown_parameters,
)
from otf_core.reports.section import Cell, Section, Table


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    held = [w for cause in diagnosis.causes if (w := _held_words(diagnosis, cause))]
    lines = [line for cause in diagnosis.causes for line in _text(cause)]
    text = (*lines, *held, '') if lines else ()
    if not diagnosis.causes:
        reason = {
            'none': 'None: the run shows no more than its simulation.',
            'unknown': 'None named: no effect of the catalogue explains the gap.'
            + ('' if diagnosis.unnamed else f' Its structure: {diagnosis.unexplained_where}.'),
        }.get(diagnosis.verdict, 'None found.')
        return Section('causes', 'Causes', (reason, *_unnamed(diagnosis)), text=text)
    words: tuple[str, ...] = ()
    if diagnosis.table_change_um > 0:
        words = (
            f'With the causes in the calibration the error tables change the predicted volumetric '
            f'error by {diagnosis.table_change_um:.2f} um on average over the volume.',
        )
    words = (*words, *held)
    rows = tuple(_row(k, c) for k, c in enumerate(diagnosis.causes, start=1))
    head = ('', 'Cause', 'Axes', 'Parameters, U with k = 2', 'Gap (um)', 'Confidence')
    tables = (Table(head, rows, numbers=(4,)), *_meanings(diagnosis))
    return Section('causes', 'Causes', words, tables=tables, text=text)


def _held_words(diagnosis: Diagnosis, cause: NamedCause) -> str:
    """What the reversal tables of the calibration hold of a cause; empty of any other."""
    known = REGISTRY.get(cause.effect)
    if known is None or known.belongs_to is not BelongsTo.REVERSAL:
        return ''
    held = in_reversal_tables(diagnosis.calibration.plain.reversal, cause.axes)
    name = effect_name(cause.effect)
    return f'The reversal tables of the calibration hold {name} as well{held}.' if held else ''


def _meanings(diagnosis: Diagnosis) -> tuple[Table, ...]:
    """What the parameters stand for, effect by effect."""
    named = dict.fromkeys(c.effect for c in diagnosis.causes)
    found = [(effect_name(e), *effect_meaning(e)) for e in named if any(effect_meaning(e))]
    head = ('Cause', 'Displacement of the target', 'Parameters')
    return (Table(head, tuple(found), title='What the parameters are'),) if found else ()


def _unnamed(diagnosis: Diagnosis) -> tuple[str, ...]:
    """What is known of a cause without a name."""
    unnamed = diagnosis.unnamed
    if unnamed is None:
        return ()
    low, high = unnamed.shrink_interval_percent
    return (
        f'It {unnamed.words}.',
        f'An empirical effect of these inputs takes the gap from {unnamed.before_um:.2f} um to '
        f'{unnamed.after_um:.2f} um on legs that it was not fitted to (95 % interval of the '
        f'shrink: {low:.0f} % to {high:.0f} %). It stands in effects.yaml for simulate and '
        f'calibrate.',
    )


def _row(rank: int, cause: NamedCause) -> tuple[Cell, ...]:
    about = effect_cause(cause.effect)
    rivals = ' or '.join(effect_name(r) for r in cause.indistinguishable_from)
    named = [effect_name(cause.effect), *([about] if about else [])]
    sure = [confidence_words(cause.confidence)]
    if cause.departs:
        named.append(f'Departs from the formula: {cause.departs}')
    if rivals:
        named.append(f'In these data indistinguishable from {rivals}')
        sure.append('that it is one of these')
    names, more, weak = shown_parameters(cause)
    parameters = [
        _unbroken(f'{n} {quantity(cause.parameters[n], cause.u[n], cause.units.get(n, ""))}')
        for n in names
    ]
    shape = shape_words(cause)
    rest = left_out_words(more, weak)
    return (
        str(rank),
        tuple(named),
        ', '.join(cause.axes) or '–',
        ('', *parameters, *rest, *([shape] if shape else [])),
        (f'{cause.before_um:.2f} → {cause.after_um:.2f}',
         f'shrinks by {cause.shrink_percent:.0f} %'),
        tuple(sure) if rivals else sure[0],
    )  # fmt: skip


def _unbroken(words: str) -> str:
    return words.replace(' +/- ', '\u00a0±\u00a0').replace(' ', '\u00a0')


def _text(cause: NamedCause) -> list[str]:
    axes = f' ({", ".join(cause.axes)})' if cause.axes else ''
    lines = [
        f'cause {cause.effect}{axes}: gap {cause.before_um:.2f} um -> {cause.after_um:.2f} um, '
        f'confidence {100 * cause.confidence:.0f} %'
    ]
    names, more, weak = shown_parameters(cause)
    for name in names:
        shown = quantity(cause.parameters[name], cause.u[name], cause.units.get(name, ''))
        lines.append(f'    {name} = {shown} (k = 2)')
    rest = (shape_words(cause), *left_out_words(more, weak))
    lines += [f'    {words}' for words in rest if words]
    if cause.departs:
        lines.append(f'    departs from the formula: {cause.departs}')
    if cause.indistinguishable_from:
        lines.append(f'    indistinguishable from {", ".join(cause.indistinguishable_from)}')
    return lines
