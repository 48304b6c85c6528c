# SPDX-License-Identifier: Apache-2.0
"""Page of a noise report: level, colour and tails of the noise, what happened in standstills."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.model.expanded import COVERAGE_FACTOR, micro_with_expanded
from otf_core.noise.model import QUANTITIES
from otf_core.noise.report import NoiseReport
from otf_core.reports.page import Heading, page_html
from otf_core.reports.plots.noise import CAPTION, draw_spectrum, draw_variogram
from otf_core.reports.section import Picture, Section, State, Table

UNITS = ('m', 'rad', 'rad')
"""Of range, horizontal and vertical angle."""


def noise_html(
    report: NoiseReport, name: str, date: str, events: Sequence[str], colour: str
) -> str:
    """Return the page.

    Parameters
    ----------
    report : NoiseReport
    name : str
        Of the recording.
    date : str
        When this was written.
    events : sequence of str
        Lost samples, steps, drift and peaks in words.
    colour : str
        How the noise is correlated.
    """
    measured = report.measured
    levels = [_known(report.measured.noise.level[k], report.u_total[k], k) for k in range(3)]
    tiles = tuple(
        (what[:1].upper() + what[1:], value, 'standard deviation of a single sample, ± U (k = 2)')
        for what, value in zip(QUANTITIES, levels, strict=True)
    )
    warned = len(report.warnings)
    badge = (
        State(f'{warned} warning{"s" if warned > 1 else ""}', 'open')
        if warned
        else State('no warnings', 'good')
    )
    heading = Heading(
        f'Noise of the tracker at rest{f", {name}" if name else ""}',
        f'A single sample scatters by {levels[0]} along the beam, {levels[1]} and {levels[2]} in '
        f'the angles; {colour}.',
        (badge,),
        tiles,
        f'noise of the tracker, run {name}, {date}' if name else f'noise of the tracker, {date}',
    )
    facts = (
        ('standstills', f'{report.standstills}, of which {report.duration:.1f} s are used'),
        ('samples', f'{measured.samples} at {report.rate:.0f} Hz in {measured.windows} windows, '
         f'{measured.left_out} louder ones left out'),
        ('beam', f'{report.distance:.2f} m long on average'),
    )  # fmt: skip
    found = tuple(f'{event[:1].upper()}{event[1:]}.' for event in events)
    words = tuple(f'Warning: {text}.' for text in report.warnings)
    sections = [
        Section('overview', '', words, draw=lambda: _pictures(report)),
        Section('levels', 'Levels', tables=(_levels(report),)),
        Section('standstills', 'Standstills', found, tables=(Table(('', ''), facts),)),
    ]
    return page_html(heading, sections)


def _known(level: float, u: float, quantity: int) -> str:
    wide = COVERAGE_FACTOR * float(u)
    return micro_with_expanded(float(level), wide if np.isfinite(wide) else 0.0, UNITS[quantity])


def _pictures(report: NoiseReport) -> Sequence[Picture]:
    panels = [draw(report, k) for draw in (draw_variogram, draw_spectrum) for k in range(3)]
    return [Picture(tuple(panels), CAPTION, columns=3)]


def _levels(report: NoiseReport) -> Table:
    rows, noise = [], report.measured.noise
    for k, name in enumerate(QUANTITIES):
        tail = report.measured.tails[k]
        kind = 'normal' if tail.freedom is None else f"Student's t, {tail.freedom:.0f} dof"
        rows.append((
            name, _known(noise.level[k], report.u_total[k], k),
            _known(noise.white[k], report.u_white[k], k), f'{tail.excess_kurtosis:.2f}', kind,
        ))  # fmt: skip
    head = ('Noise', 'Total (k = 1) ± U', 'White part (k = 1) ± U', 'Excess kurtosis', 'Tails')
    return Table(head, tuple(rows), numbers=(3,), stacked=True)
