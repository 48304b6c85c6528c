# SPDX-License-Identifier: Apache-2.0
"""Overview: which cause, how large, where the gap lies, and in which recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import combinations

from otf_core.diagnosis.place.separation import TIME, VOLUME, groupings_by_view
from otf_core.diagnosis.result import Diagnosis, Gap, NamedCause
from otf_core.model.provenance import moment
from otf_core.reports.condition_tables import measured, run_table, stated
from otf_core.reports.drawing.bars import Bar, bars
from otf_core.reports.gap_sections.causes import effect_name
from otf_core.reports.gap_sections.residual_views import (
    groups_side_by_side,
    size_pictures,
    volume_picture,
)
from otf_core.reports.page import Heading
from otf_core.reports.section import Picture, Section, State, Table
from otf_core.reports.wording import listed
from otf_core.version import __version__

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
    title = f'{GAP_TITLE} · {listed(diagnosis.runs)}'
    badge = State(VERDICT_WORDS.get(verdict, verdict), VERDICT_MOODS.get(verdict, ''))
    return Heading(title, diagnosis.sentence, (badge,), tuple(tiles), running_words(diagnosis))


def running_words(diagnosis: Diagnosis) -> str:
    """Head of printed pages: machine, run, date."""
    machines = dict.fromkeys(o.machine.name for o in diagnosis.origin if o.machine)
    date = measured(diagnosis.origin)
    parts = [*machines, f'diagnosis of {listed(diagnosis.runs)}', *([date] if date else [])]
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
    words = [diagnosis.where.summary, *looked_at(diagnosis)]
    text = (
        f'verdict: {diagnosis.verdict}',
        diagnosis.sentence,
        *words,
        f'residual {gap.measured_um:.2f} um, simulated {gap.simulated_um:.2f} um; gap '
        f'{gap.before_um:.2f} um -> {gap.after_um:.2f} um',
        '',
    )
    return Section('overview', '', tuple(words), {'gap': asdict(gap)}, text=text,
                   draw=lambda: [where_picture(diagnosis)])  # fmt: skip


def looked_at(diagnosis: Diagnosis) -> list[str]:
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
        f'Looked for: {len(seen) + len(hidden)} effects. {len(seen)} of them would have been '
        f'found from a root mean square displacement of {sizes[0]} to {sizes[1]} on.'
    ]
    if hidden:
        words.append(
            f'Not seen in these data, whatever their size: {listed(map(effect_name, hidden))}.'
        )
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
    if where.view == VOLUME:
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
        found = _grouping_axes(name)
        if len(found) == 2 and own <= set(found):
            return axes.index(found[0]), axes.index(found[1])
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
            f'% (95 % interval {low:.0f} % to {high:.0f} %), judged on legs that the causes were '
            f'not fitted to.'
        )
    if where.view:
        words.append(
            'The picture above shows the view that separates the gap most: the share of its '
            'variance between groups of pieces, less what as many groups have by chance (adjusted '
            'R squared), is largest there.'
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
        when = f'{dates[0]} to {dates[1]}' if all(dates) else 'the stamps tell no date'
        rows += [(f'{name}: measured', when), (f'{name}: SHA-256', one.sha256)]
    tables, said = stated(plain.tables.machine)
    tables += [run_table(number, run) for number, run in enumerate(plain.runs, start=1)]
    shown = tuple(row for row in rows if row[0] not in RUN_CONDITIONS)
    tables.append(Table(('', ''), shown, title='Recordings and versions'))
    return Section('conditions', 'Conditions and instrument', said, dict(rows), tuple(tables))
