# SPDX-License-Identifier: Apache-2.0
"""First screen: which cause, how large; where the gap lies; how far it shrinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import combinations

from otf_core.diagnosis.place.separation import TIME, VOLUME, groupings_by_view
from otf_core.diagnosis.result import Diagnosis, NamedCause
from otf_core.reports.circumstances import measured
from otf_core.reports.gap_pictures import groups_side_by_side
from otf_core.reports.gap_sections.over_time import size_pictures
from otf_core.reports.gap_sections.place import volume_picture
from otf_core.reports.gap_words import VERDICTS, effect_name, looked_at
from otf_core.reports.page import Heading
from otf_core.reports.quantities import listed
from otf_core.reports.section import Picture, Section, State

TITLE = 'Gap between run and simulation'
MOODS = {'none': 'good', 'explained': 'good', 'partly_explained': 'open', 'unknown': 'bad'}
TILES = 2
"""Causes whose size has a tile of its own."""
PLAIN = 'lines'
"""Grouping that is drawn where none separates."""


def heading(diagnosis: Diagnosis) -> Heading:
    """Top of the page."""
    gap, verdict = diagnosis.gap, diagnosis.verdict
    tiles = [tile for cause in diagnosis.causes[:TILES] if (tile := _size_tile(cause))]
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
    title = f'{TITLE} · {listed(diagnosis.runs)}'
    badge = State(VERDICTS.get(verdict, verdict), MOODS.get(verdict, ''))
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


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
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


def where_picture(diagnosis: Diagnosis) -> Picture:
    """The view that separates the gap most, before and after side by side at one scale."""
    title = 'Where the gap lies' if diagnosis.where.view else 'Residual against noise'
    return replace(_picture(diagnosis), title=title)


def _picture(diagnosis: Diagnosis) -> Picture:
    """That view: time, volume, or bars of groups."""
    views, where = diagnosis.shown.views, diagnosis.where
    if where.view == TIME and len(views) == 1:
        return size_pictures(diagnosis)
    if where.view == VOLUME:
        return volume_picture(diagnosis, [_plane(diagnosis)])
    name = where.grouping or PLAIN
    grouping = next(g for _, g in groupings_by_view(views) if g.kind == name)
    return groups_side_by_side(diagnosis, grouping)


def _plane(diagnosis: Diagnosis) -> tuple[int, int]:
    """Plane of the grouping, or of a single axis the one that separates most with it."""
    axes = diagnosis.shown.views[0].axis_names
    names = [diagnosis.where.grouping, *(s['grouping'] for s in diagnosis.where.separation)]
    own = set(_axes(names[0]))
    for name in names:
        found = _axes(name)
        if len(found) == 2 and own <= set(found):
            return axes.index(found[0]), axes.index(found[1])
    return next(p for p in combinations(range(3), 2) if own <= {axes[k] for k in p})


def _axes(grouping: str) -> Sequence[str]:
    """Axes in the name of a grouping by position."""
    head = 'position of '
    return grouping.removeprefix(head).split(' and ') if grouping.startswith(head) else ()
