# SPDX-License-Identifier: Apache-2.0
"""Which cause, how large, where the gap lies, what stays open, what to measure next."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from itertools import combinations

import numpy as np

from otf_core.diagnosis.cause_parameters import SCALES, Curve, at_words
from otf_core.diagnosis.corrected_calibration import in_reversal_tables
from otf_core.diagnosis.place.placement import TIME, VOLUME, groupings_by_view
from otf_core.diagnosis.result import Diagnosis, Gap, NamedCause
from otf_core.effects import EVERY, BelongsTo
from otf_core.effects.inputs import label_of
from otf_core.model.expanded import COVERAGE_FACTOR, quantity
from otf_core.model.provenance import moment
from otf_core.reports.calibration_facts import measurement_dates, run_table, stated_tables
from otf_core.reports.charts import Bar, Panel, Scale, bars, scale_around
from otf_core.reports.gap_sections.residual_views import (
    groups_side_by_side,
    size_pictures,
    volume_picture,
)
from otf_core.reports.page import Cell, Heading, Picture, Section, State, Table, join_names
from otf_core.version import __version__

# Causes of the gap: what was found, its functions, what stays open, what to measure next.

DRAWN_CURVES = 6
"""Curves of one cause that are drawn, the largest first."""
HIDDEN_TITLE = 'What these data cannot show'
CONFIDENCE_WORDS = (
    (0.99, 'practically certain'),
    (0.95, 'very likely'),
    (0.8, 'likely'),
    (0.5, 'more likely than not'),
    (0.0, 'doubtful'),
)
SHOWN_PARAMETERS = 8
"""Of longer lists the most significant ones are shown."""


def causes_section(diagnosis: Diagnosis) -> Section:
    """The causes that were found, ranked, with their parameters."""
    held = [w for cause in diagnosis.causes if (w := _held_words(diagnosis, cause))]
    lines = [line for cause in diagnosis.causes for line in _cause_lines(cause)]
    text = (*lines, *held, '') if lines else ()
    if not diagnosis.causes:
        reason = {
            'none': 'None: the run shows nothing beyond its simulation.',
            'unknown': 'None named: no effect of the catalogue explains the gap.'
            + ('' if diagnosis.unnamed else f' Its structure: {diagnosis.unexplained_where}.'),
        }.get(diagnosis.verdict, 'None found.')
        return Section('causes', 'Causes', (reason, *_unnamed_words(diagnosis)), text=text)
    words: tuple[str, ...] = ()
    if diagnosis.table_change_um > 0:
        words = (
            f'Including the causes in the calibration changes the predicted volumetric error by'
            f' {diagnosis.table_change_um:.2f} um on average over the volume.',
        )
    words = (*words, *held, *_unnamed_words(diagnosis))
    rows = tuple(_cause_row(k, c) for k, c in enumerate(diagnosis.causes, start=1))
    head = ('', 'Cause', 'Axes', 'Parameters, U with k = 2', 'Gap (um)', 'Confidence')
    tables = (Table(head, rows, numbers=(4,)), *_meaning_tables(diagnosis))
    return Section('causes', 'Causes', words, tables=tables, text=text)


def _held_words(diagnosis: Diagnosis, cause: NamedCause) -> str:
    """What the reversal tables of the calibration hold of a cause; empty of any other."""
    known = EVERY.get(cause.effect)
    if known is None or known.belongs_to is not BelongsTo.REVERSAL:
        return ''
    held = in_reversal_tables(diagnosis.reversal, cause.axes)
    name = effect_name(cause.effect)
    return f'The reversal tables of the calibration contain {name} as well{held}.' if held else ''


def _meaning_tables(diagnosis: Diagnosis) -> tuple[Table, ...]:
    """What the parameters stand for, effect by effect."""
    named = dict.fromkeys(c.effect for c in diagnosis.causes)
    meanings = [(effect_name(e), *effect_meaning(e)) for e in named if any(effect_meaning(e))]
    head = ('Cause', 'Displacement of the target', 'Parameters')
    return (Table(head, tuple(meanings), title='What the parameters are'),) if meanings else ()


def _unnamed_words(diagnosis: Diagnosis) -> tuple[str, ...]:
    """What is known of a cause without a name."""
    unnamed = diagnosis.unnamed
    if unnamed is None:
        return ()
    low, high = unnamed.shrink_interval_percent
    what = 'The rest' if diagnosis.causes else 'It'
    return (
        f'{what} {unnamed.words}.',
        f'An empirical effect of these inputs reduces the gap from {unnamed.before_um:.2f} um to '
        f'{unnamed.after_um:.2f} um on legs not used for its fit (95 % interval of the reduction: '
        f'{low:.0f} % to {high:.0f} %). It is in effects.yaml for simulate and calibrate.',
    )


def _cause_row(rank: int, cause: NamedCause) -> tuple[Cell, ...]:
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


def _cause_lines(cause: NamedCause) -> list[str]:
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


def effect_name(effect: str) -> str:
    """Name of an effect in words."""
    return effect.replace('_', ' ')


def effect_cause(effect: str) -> str:
    """What causes an effect; empty for a name that is not in the catalogue."""
    known = EVERY.get(effect)
    return known.cause if known else ''


def effect_meaning(effect: str) -> tuple[str, str]:
    """Formula of an effect and what its parameters are; empty if it is not in the catalogue."""
    known = EVERY.get(effect)
    return (known.equation, known.coefficients) if known else ('', '')


def confidence_words(confidence: float) -> str:
    """Confidence in words and as a number."""
    word = next(word for least, word in CONFIDENCE_WORDS if confidence >= least)
    number = '>\u00a099.9\u00a0%' if confidence > 0.999 else f'{100 * confidence:.3g}\u00a0%'
    return f'{word} ({number})'


def shown_parameters(cause: NamedCause) -> tuple[list[str], int, int]:
    """Estimated parameters worth showing; how many more are significant, and how many are not.

    Significant is what is larger than its expanded uncertainty.
    """

    def strength(name: str) -> float:
        u = cause.u[name]
        return abs(cause.parameters[name]) / u if u > 0 else math.inf

    estimated = [n for n in cause.parameters if n in cause.u]
    significant = [n for n in estimated if strength(n) > COVERAGE_FACTOR]
    strongest = set(sorted(significant, key=strength, reverse=True)[:SHOWN_PARAMETERS])
    shown = [n for n in significant if n in strongest]
    return shown, len(significant) - len(shown), len(estimated) - len(significant)


def left_out_words(more: int, weak: int) -> list[str]:
    """What is not listed of the parameters of a cause."""
    words = [f'{more} more significant ones in gap.json'] if more else []
    if weak:
        verb = 'is' if weak == 1 else 'are'
        words.append(f'{weak} further {verb} not significant (|value| < U), in gap.json')
    return words


def shape_words(cause: NamedCause) -> str:
    """Parameters that were chosen, not estimated; empty if there are none."""
    chosen = [
        f'{name} {quantity(value, None, cause.units.get(name, ""))}'
        for name, value in cause.parameters.items()
        if name not in cause.u
    ]
    return f'chosen: {", ".join(chosen)}' if chosen else ''


def functions_section(diagnosis: Diagnosis) -> Section:
    """Functions found, with their bands; empty where everything follows a formula."""
    unnamed = diagnosis.unnamed
    shown = [(effect_name(c.effect), c.departs, c.curves) for c in diagnosis.causes if c.curves]
    if unnamed is not None:
        shown.append(('Cause without a name', unnamed.words, unnamed.curves))
    if not shown:
        return Section('functions', '')
    words = tuple(f'{effect_name(c.effect)}: {c.departs}.' for c in diagnosis.causes if c.curves)
    return Section(
        'functions',
        'Functions found',
        words,
        draw=lambda: [_curve_picture(name, curves) for name, _, curves in shown],
    )


def _curve_picture(name: str, curves: Sequence[Curve]) -> Picture:
    caption = (
        f'{name}: the function determined by the data; band: k = 2, without the part that '
        f'tables and tracker pose share.'
    )
    return Picture(
        tuple(_curve_panel(c) for c in curves[:DRAWN_CURVES]), caption, columns=2, title=name
    )


def _curve_panel(curve: Curve) -> str:
    factor, unit = SCALES.get(curve.unit, (1.0, curve.unit))
    across, of_input = (1e3, 'mm') if curve.input_unit == 'm' else (1.0, curve.input_unit)
    at = across * np.array(curve.at)
    value, u = factor * np.array(curve.value), factor * np.array(curve.u)
    low, high = value - 2.0 * u, value + 2.0 * u
    label = label_of(curve.input) + (f' ({of_input})' if of_input else '')
    ends = float(at[0]), max(float(at[-1]), float(at[0]) + 1e-9)
    panel = Panel(
        Scale(*ends, label),
        scale_around(np.concatenate([[0.0], low, high]), unit.replace('u', 'µ', 1)),
    )
    marks = [
        panel.level(0.0, 'soft'),
        panel.band(at, low, high, 'after band'),
        panel.line(at, value, 'after'),
    ]
    held = ', '.join(at_words(n, v) for n, v in curve.held.items())
    heading = f'{curve.term}, {held}' if held else curve.term
    return panel.draw(marks, f'{curve.term} against {label_of(curve.input)}', heading)


def unexplained_section(diagnosis: Diagnosis) -> Section:
    """What stays unexplained."""
    where = diagnosis.unexplained_where
    words = f'{diagnosis.unexplained_um:.2f} um (root mean square)' + (
        f': {where}.' if where else '.'
    )
    data = {'rms_um': diagnosis.unexplained_um, 'where': where}
    size = f'left: {diagnosis.unexplained_um:.2f} um'
    named = diagnosis.unnamed is not None  # in the sentence of the first screen
    text = (size if named or not where else f'{size}, {where}', '')
    return Section('unexplained', 'What stays unexplained', (words,), data, text=text)


def hidden_section(diagnosis: Diagnosis) -> Section:
    """What these data cannot show."""
    if not diagnosis.not_visible:
        words = 'Every effect of the catalogue would have left a trace in these data.'
        return Section('hidden', HIDDEN_TITLE, (words,))
    rows = tuple(((effect_name(e), effect_cause(e)), needs) for e, needs in diagnosis.not_visible)
    words = 'These effects leave no trace in these data, so they are neither found nor absent.'
    text = tuple(f'not visible: {e}; needs {n}' for e, n in diagnosis.not_visible)
    return Section('hidden', HIDDEN_TITLE, (words,), tables=(Table(('Effect', 'Shown by'), rows),),
                   text=text)  # fmt: skip


def next_section(diagnosis: Diagnosis) -> Section:
    """What to measure next."""
    lines = next_measurements(diagnosis) or ['Nothing more is needed for this question.']
    return Section('next', 'What to measure next', tuple(lines), {'measure': lines})


def _needed_for(effect: str) -> str:
    known = EVERY.get(effect)
    return known.needs if known else ''


def next_measurements(diagnosis: Diagnosis) -> list[str]:
    """What to measure next, plain text, most useful first."""
    wishes: list[tuple[str, str]] = []
    for cause in diagnosis.causes:
        rivals = cause.indistinguishable_from
        if rivals:
            others = ' or '.join(r.replace('_', ' ') for r in rivals)
            reason = f'to distinguish {cause.effect.replace("_", " ")} from {others}'
            wishes += [
                (n, reason) for n in dict.fromkeys(map(_needed_for, (cause.effect, *rivals))) if n
            ]
    if diagnosis.verdict in ('unknown', 'partly_explained'):
        wishes.append(
            (
                'the same path once more, also backwards and at a second feed, and from a second '
                'tracker place',
                'to see whether the unexplained part depends on time, travel or tracker',
            )
        )
    for effect, needs in diagnosis.not_visible:
        wishes.append((needs, effect.replace('_', ' ')))
    return _merged_wishes(wishes, {e.replace('_', ' ') for e, _ in diagnosis.not_visible})


def _merged_wishes(wishes: Iterable[tuple[str, str]], hidden: set[str]) -> list[str]:
    """One line for wishes that begin alike: what is wanted, details, what for."""
    grouped: dict[str, tuple[list[str], list[str]]] = {}
    for wish, reason in wishes:
        head, *rest = re.split(r'[,;:] ', wish, maxsplit=1)
        details, reasons = grouped.setdefault(head, ([], []))
        details += [r for r in rest if r not in details]
        reasons.append(reason)
    lines = []
    for head, (details, reasons) in grouped.items():
        own = [r for r in reasons if r not in hidden]
        unseen = [r for r in reasons if r in hidden]
        if unseen:
            own.append('to see ' + join_names(unseen))
        detail = f' ({"; ".join(details)})' if details else ''
        lines.append(f'{head[:1].upper()}{head[1:]}{detail}: {"; ".join(dict.fromkeys(own))}.')
    return lines


# Overview: which cause, how large, where the gap lies, and in which recordings.

GAP_TITLE = 'Gap between run and simulation'
VERDICT_WORDS = {
    'none': 'no gap',
    'explained': 'explained',
    'partly_explained': 'partly explained',
    'unknown': 'cause unknown',
}
VERDICT_MOODS = {'none': 'good', 'explained': 'good', 'partly_explained': 'open', 'unknown': 'bad'}
CAUSE_TILES = 2
"""Causes whose size has a tile of its own."""
PLAIN_GROUPING = 'lines'
"""Grouping that is drawn where none separates."""
LISTED_GROUPINGS = 8
"""Groupings that are listed."""
RUN_CONDITIONS = ('samples',)
"""Conditions that the tables of the runs show."""


def heading(diagnosis: Diagnosis) -> Heading:
    """Top of the page."""
    gap, verdict = diagnosis.gap, diagnosis.verdict
    tiles = [tile for cause in diagnosis.causes[:CAUSE_TILES] if (tile := _size_tile(cause))]
    if diagnosis.causes:
        low, high = gap.shrink_interval_percent
        tiles.append(
            ('Gap', f'{gap.before_um:.2f} → {gap.after_um:.2f} um',
             f'smaller by {gap.shrink_percent:.0f} % (95 % interval {low:.0f} to {high:.0f}) with '
             f'the cause{"s" if len(diagnosis.causes) > 1 else ""}')
        )  # fmt: skip
    else:
        tiles.append(
            ('Gap', f'{gap.before_um:.2f} um', 'what the run shows beyond its simulation')
        )
    tiles.append(
        ('Residual of the run', f'{gap.measured_um:.2f} um',
         f'its simulation leaves {gap.simulated_um:.2f} um')
    )  # fmt: skip
    title = f'{GAP_TITLE} · {join_names(diagnosis.runs)}'
    badge = State(VERDICT_WORDS.get(verdict, verdict), VERDICT_MOODS.get(verdict, ''))
    return Heading(title, diagnosis.sentence, (badge,), tuple(tiles), running_words(diagnosis))


def running_words(diagnosis: Diagnosis) -> str:
    """Head of printed pages: machine, run, date."""
    machines = dict.fromkeys(o.machine.name for o in diagnosis.origin if o.machine)
    date = measurement_dates(diagnosis.origin)
    parts = [*machines, f'diagnosis of {join_names(diagnosis.runs)}', *([date] if date else [])]
    return ', '.join(parts)


def _size_tile(cause: NamedCause) -> tuple[str, str, str] | None:
    """What a cause is called, its largest size, and what kind of size it is."""
    if not cause.sizes:
        return None
    first, *others = cause.sizes
    more = [f'{s.of} {s.words}'.strip() for s in others]
    remark = [first.remark, 'U, k = 2' if first.u is not None else '', *more]
    name = f'{effect_name(cause.effect)} {first.of}'.strip()
    return name[:1].upper() + name[1:], first.words, '; '.join(filter(None, remark))


def overview_section(diagnosis: Diagnosis) -> Section:
    """First screen: which cause, how large; where the gap lies; how far it shrinks."""
    gap = diagnosis.gap
    words = [diagnosis.where.summary, *describe_search(diagnosis)]
    text = (
        f'verdict: {diagnosis.verdict}',
        diagnosis.sentence,
        *words,
        f'residual {gap.measured_um:.2f} um, simulated {gap.simulated_um:.2f} um; gap '
        f'{gap.before_um:.2f} um -> {gap.after_um:.2f} um',
        '',
    )
    contradictions = [f'{f.severity.capitalize()}, {f.check}: {f.words}.' for f in
                      diagnosis.contradictions]  # fmt: skip
    return Section('overview', '', (*words, *contradictions), {'gap': asdict(gap)}, text=text,
                   draw=lambda: [where_picture(diagnosis)])  # fmt: skip


def describe_search(diagnosis: Diagnosis) -> list[str]:
    """What was looked for and how small an effect would have been seen; nothing of a cause."""
    if diagnosis.causes:
        return []
    hidden = [effect for effect, _ in diagnosis.not_visible]
    seen = {
        effect: size
        for effect, size in diagnosis.smallest_found_um.items()
        if effect not in hidden
    }
    if not seen:
        return []
    order = sorted(seen, key=seen.__getitem__)
    least, most = order[0], order[-1]
    sizes = [f'{seen[name]:.2f} um ({effect_name(name)})' for name in (least, most)]
    words = [
        f'Considered: {len(seen) + len(hidden)} effects. {len(seen)} of them would have been '
        f'detected from a root mean square displacement of'
        f' {sizes[0]} to {sizes[1]} on.'
    ]
    if hidden:
        names = join_names(map(effect_name, hidden))
        words.append(f'Not visible in these data, whatever their size: {names}.')
    return words


def where_picture(diagnosis: Diagnosis) -> Picture:
    """The view that separates the gap most, before and after side by side at one scale."""
    title = 'Where the gap lies' if diagnosis.where.view else 'Residual against noise'
    return replace(_separating_picture(diagnosis), title=title)


def _separating_picture(diagnosis: Diagnosis) -> Picture:
    """That view: time, volume, or bars of groups."""
    views, where = diagnosis.shown.views, diagnosis.where
    if where.view == TIME and len(views) == 1:
        return size_pictures(diagnosis)
    if where.view == VOLUME and not views[0].rotary:
        return volume_picture(diagnosis, [_separating_plane(diagnosis)])
    name = where.grouping or PLAIN_GROUPING
    grouping = next(g for _, g in groupings_by_view(views) if g.kind == name)
    return groups_side_by_side(diagnosis, grouping)


def _separating_plane(diagnosis: Diagnosis) -> tuple[int, int]:
    """Plane of the grouping, or of a single axis the one that separates most with it."""
    axes = diagnosis.shown.views[0].axis_names
    names = [diagnosis.where.grouping, *(s['grouping'] for s in diagnosis.where.separation)]
    own = set(_grouping_axes(names[0]))
    for name in names:
        grouping = _grouping_axes(name)
        if len(grouping) == 2 and own <= set(grouping):
            return axes.index(grouping[0]), axes.index(grouping[1])
    return next(p for p in combinations(range(3), 2) if own <= {axes[k] for k in p})


def _grouping_axes(grouping: str) -> Sequence[str]:
    """Axes in the name of a grouping by position."""
    head = 'position of '
    return grouping.removeprefix(head).split(' and ') if grouping.startswith(head) else ()


def where_section(diagnosis: Diagnosis) -> Section:
    """How large the gap is, and how well each view separates it."""
    where, gap = diagnosis.where, diagnosis.gap
    words = [
        'Residual: distance of the aligned, compensated measurement across the path, root mean '
        'square over path pieces. Gap: square root of measured squared minus simulated squared; '
        'its components along X, Y and Z add up to it in squares.'
    ]
    if diagnosis.causes:
        low, high = gap.shrink_interval_percent
        words.append(
            f'With the causes added to the simulation the gap shrinks by {gap.shrink_percent:.0f} '
            f'% (95 % interval {low:.0f} % to {high:.0f} %), evaluated on legs that were not '
            f'used to fit the causes.'
        )
    if where.view:
        words.append(
            'The picture above shows the view that separates the gap most: the share of its '
            'variance between groups of pieces, minus what as many groups have by chance '
            '(adjusted R squared), is largest there.'
        )
    rows = tuple(
        (_view_name(s['view'], s['grouping']), f'{s["share_percent"]:.0f} %')
        for s in where.separation[:LISTED_GROUPINGS]
    )
    head = ('View of the gap', 'Share of its variance')
    tables = [Table(head, rows, numbers=(1,))] if diagnosis.verdict != 'none' else []
    parts = tuple(
        (p['label'], f'{p["gap_um"]:.2f}', f'{p["share_of_gap_percent"]:.0f} %',
         f'{p["share_of_path_percent"]:.0f} %')
        for p in where.parts
    )  # fmt: skip
    if parts:
        columns = (where.grouping, 'Gap there (um)', 'Of the squared gap', 'Of the path')
        tables.insert(0, Table(columns, parts, numbers=(1, 2, 3)))
    data = {k: v for k, v in asdict(where).items() if not k.startswith('by_')}
    return Section(
        'where',
        'How large it is and where it lies',
        tuple(words),
        data,
        tuple(tables),
        draw=lambda: _gap_bars(gap, bool(diagnosis.causes)),
    )


def _view_name(view: str, grouping: str) -> str:
    return grouping if view == grouping else f'{view}: {grouping}'


def _gap_bars(gap: Gap, causes: bool) -> Sequence[Picture]:
    rows = [
        Bar('Residual of the run', ((gap.measured_um, 'noise'),), f'{gap.measured_um:.2f} µm'),
        Bar('Residual of its simulation', ((gap.simulated_um, 'noise'),),
            f'{gap.simulated_um:.2f} µm'),
        Bar('Gap before', ((gap.before_um, 'before'),), f'{gap.before_um:.2f} µm'),
    ]  # fmt: skip
    caption = ''
    if causes:
        low, high = (gap.before_um * (1.0 - s / 100.0) for s in gap.shrink_interval_percent[::-1])
        rows.append(Bar('Gap after', ((gap.after_um, 'after'),), f'{gap.after_um:.2f} µm',
                        ends=(max(low, 0.0), max(high, 0.0))))  # fmt: skip
        caption = 'Stroke: 95 % interval.'
    return [
        Picture((bars(rows, 'sizes of residuals and gap', names=158.0, width=440.0),), caption)
    ]


def conditions_section(diagnosis: Diagnosis) -> Section:
    """Conditions and instrument, the runs, versions and hashes."""
    plain = diagnosis.calibration.plain
    rows = [('runs', ', '.join(diagnosis.runs)), ('otf_core', __version__)]
    rows += list(diagnosis.shown.conditions.items())
    for one in diagnosis.origin:
        name = one.name or 'the run'
        dates = moment(one.first_ns), moment(one.last_ns)
        when = f'{dates[0]} to {dates[1]}' if all(dates) else 'the stamps contain no date'
        rows += [(f'{name}: measured', when), (f'{name}: SHA-256', one.sha256)]
    tables, words = stated_tables(diagnosis.machine)
    tables += [run_table(number, run) for number, run in enumerate(plain.runs, start=1)]
    shown = tuple(row for row in rows if row[0] not in RUN_CONDITIONS)
    tables.append(Table(('', ''), shown, title='Recordings and versions'))
    return Section('conditions', 'Conditions and instrument', words, dict(rows), tuple(tables))
