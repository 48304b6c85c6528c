# SPDX-License-Identifier: Apache-2.0
"""First screen: how large the gap is, before and with the causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from otf_core.diagnosis.result import Diagnosis, Gap
from otf_core.reports.drawing.bars import Bar, bars
from otf_core.reports.gap_words import VERDICTS
from otf_core.reports.page import Heading
from otf_core.reports.quantities import listed
from otf_core.reports.section import Picture, Section, State

TITLE = 'Gap between run and simulation'
MOODS = {'none': 'good', 'explained': 'good', 'partly_explained': 'open', 'unknown': 'bad'}


def heading(diagnosis: Diagnosis) -> Heading:
    """Top of the page."""
    gap, verdict = diagnosis.gap, diagnosis.verdict
    tiles = [
        ('Residual of the run', f'{gap.measured_um:.2f} um',
         f'its simulation leaves {gap.simulated_um:.2f} um'),
        ('Gap', f'{gap.before_um:.2f} um', 'what the run shows beyond its simulation'),
    ]  # fmt: skip
    if diagnosis.causes:
        low, high = gap.shrink_interval_percent
        tiles.append(
            ('Gap with the causes', f'{gap.after_um:.2f} um',
             f'smaller by {gap.shrink_percent:.0f} % (95 % interval {low:.0f} to {high:.0f})')
        )  # fmt: skip
    title = f'{TITLE} · {listed(diagnosis.runs)}'
    badge = State(VERDICTS.get(verdict, verdict), MOODS.get(verdict, ''))
    return Heading(title, diagnosis.sentence, (badge,), tuple(tiles))


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    gap = diagnosis.gap
    words = [
        'Residual: distance of the aligned, compensated measurement across the path, root mean '
        'square over path pieces. Gap: square root of measured squared minus simulated squared.'
    ]
    if diagnosis.causes:
        low, high = gap.shrink_interval_percent
        words.append(
            f'With the causes added to the simulation the gap shrinks by {gap.shrink_percent:.0f} '
            f'% (95 % interval {low:.0f} % to {high:.0f} %), judged on legs that the causes were '
            f'not fitted to.'
        )
    text = (
        f'verdict: {diagnosis.verdict}',
        diagnosis.sentence,
        f'residual {gap.measured_um:.2f} um, simulated {gap.simulated_um:.2f} um; gap '
        f'{gap.before_um:.2f} um -> {gap.after_um:.2f} um',
        '',
    )
    return Section('overview', '', tuple(words), {'gap': asdict(gap)}, text=text,
                   draw=lambda: _pictures(gap, bool(diagnosis.causes)))  # fmt: skip


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
