# SPDX-License-Identifier: Apache-2.0
"""How large the gap is, and how well each view separates it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from otf_core.diagnosis.result import Diagnosis, Gap
from otf_core.reports.drawing.bars import Bar, bars
from otf_core.reports.section import Picture, Section, Table

LISTED = 8
"""Groupings that are listed."""


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
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
        (_view(s['view'], s['grouping']), f'{s["share_percent"]:.0f} %')
        for s in where.separation[:LISTED]
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
        draw=lambda: _pictures(gap, bool(diagnosis.causes)),
    )


def _view(view: str, grouping: str) -> str:
    return grouping if view == grouping else f'{view}: {grouping}'


def _pictures(gap: Gap, causes: bool) -> Sequence[Picture]:
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
