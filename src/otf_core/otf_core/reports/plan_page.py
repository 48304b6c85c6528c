# SPDX-License-Identifier: Apache-2.0
"""Page of a plan: what it will show and how well, what it will not, where the tracker stands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.calibration.headline import Expected
from otf_core.model.expanded import COVERAGE_FACTOR, micro_significant
from otf_core.planning.plan_report import PlanReport
from otf_core.prediction.volumetric import length_sizes
from otf_core.reports.drawing.heat import heat_key, heat_step
from otf_core.reports.drawing.scene import SCRIPT
from otf_core.reports.page import Heading, page_html
from otf_core.reports.plots.plan import draw_error_bars, draw_grid, draw_path
from otf_core.reports.quantities import listed, millimetres, place
from otf_core.reports.section import Picture, Section, State, Table

PLACES = 8
"""Places of the tracker that are not folded away."""


def plan_html(report: PlanReport, date: str) -> str:
    """Return the page; ``date`` is when the plan was made."""
    sections = [_overview(report), _path(report), _tracker(report), _effects(report)]
    return page_html(_heading(report, date), [s for s in sections if s is not None])


def _expected(report: PlanReport) -> Expected:
    """What a calibration from this plan would state first; of noise alone if no more is known."""
    if report.systematic is not None:
        return report.systematic.expected
    noise = length_sizes(COVERAGE_FACTOR * np.linalg.norm(report.forecast.grid_u_free, axis=1))
    return Expected(noise, noise, COVERAGE_FACTOR, (), nothing_declared=True)


def _heading(report: PlanReport, date: str) -> Heading:
    plan, found = report.plan, report.forecast
    expected = _expected(report)
    wide, largest = (micro_significant(expected.expanded[size]) for size in ('mean', 'max'))
    noise, most = (micro_significant(expected.observed[size]) for size in ('mean', 'max'))
    label = 'tracker noise alone' if report.systematic is None else expected.label
    sentence = f'{expected.expanded_words[:1].upper()}{expected.expanded_words[1:]}.'
    if report.systematic is None:
        sentence = f'{expected.forecast_words[:1].upper()}{expected.forecast_words[1:]}.'
    missing = [f.error for f in report.findings]
    badge = (
        State(f'{len(missing)} errors not shown', 'open')
        if missing
        else State('all errors shown', 'good')
    )
    tiles = (
        ('Expected after compensation', wide,
         f'mean U over the volume (k = {expected.k:.3g}), largest {largest}; {label}'),
        ('Noise of the tracker alone', noise, f'the same mean, largest {most}'),
        ('Drive', f'{found.duration:.0f} s', f'{plan.path.length:.1f} m, '
         f'{len(plan.path.points)} points'),
    )  # fmt: skip
    name = report.setup.machine.name
    return Heading(
        f'Plan for {name}: {report.how}', sentence, (badge,), tiles, f'{name}, plan, {date}'
    )


def _overview(report: PlanReport) -> Section:
    words = [f'Not shown: {f.words}; needs {f.needs}.' for f in report.findings]
    words += [f'{a.words[:1].upper()}{a.words[1:]}.' for a in report.after]

    def draw() -> Sequence[Picture]:
        size = 1e6 * np.linalg.norm(report.forecast.grid_u_free, axis=1)
        step = heat_step(size)
        return [
            Picture(
                (draw_path(report, turns=True), draw_grid(report, step, turns=True)),
                'Left: the path, the tracker and its beams to the corners of the volume. Right: '
                'standard uncertainty of the error vector (k = 1) of tracker noise alone, best '
                'rigid motion taken out.',
                columns=2,
                key=heat_key(step, float(size.max()), 'µm'),
            ),
            Picture(
                (draw_error_bars(report, 'm'), draw_error_bars(report, 'rad')),
                'Standard uncertainty (k = 1) of tracker noise alone: bar and first number the '
                'mean over the nodes of a table, stroke the largest.',
                columns=2,
                title='All 21 errors',
            ),
        ]

    return Section('overview', '', tuple(words), draw=draw, script=SCRIPT)


def _path(report: PlanReport) -> Section:
    plan, setup = report.plan, report.setup
    points = plan.path.points
    feeds = np.unique(np.rint(60e3 * plan.feed)).astype(int)
    ranges = zip(setup.machine.axis_names, points.min(axis=0), points.max(axis=0), strict=True)
    driven = [f'{a} {millimetres(low)} to {millimetres(high)} mm' for a, low, high in ranges]
    rows = (
        ('how', report.how),
        ('driven', ', '.join(driven)),
        ('feeds', f'{", ".join(map(str, feeds))} mm/min'),
        ('accelerations assumed', f'{1e3 * setup.config.acceleration:g} mm/s²'),
        ('samples assumed', f'{setup.config.rate:g} a second'),
        ('noise assumed', str(setup.noise)),
        ('unknowns determined', f'{report.forecast.solution.rank} of '
         f'{report.forecast.solution.unknowns}'),
    )  # fmt: skip
    return Section('path', 'Path and what is assumed', tables=(Table(('', ''), rows),))


def _tracker(report: PlanReport) -> Section:
    words = (
        f'Assumed here: {place(report.setup.place)}.',
        *(f'{line[:1].upper()}{line[1:]}.' for line in report.advice),
    )
    rows = tuple(
        (p.words, place(p.place), f'{1e6 * p.mean_grid_u:.3f}',
         f'{p.shortest:.2f} to {p.longest:.2f}')
        for p in report.places
    )  # fmt: skip
    head = ('Place', 'Position', 'Mean u in the volume, noise alone (um)', 'Beam (m)')
    tables = [Table(head, rows[:PLACES], numbers=(2, 3), stacked=True)]
    if rows[PLACES:]:
        tables.append(Table(head, rows[PLACES:], (2, 3), folded='Other places', stacked=True))
    return Section('tracker', 'Where the tracker stands', words, tables=tuple(tables))


def _effects(report: PlanReport) -> Section | None:
    if not report.effects:
        return None
    rows = tuple(
        (e.effect.replace('_', ' '), e.words.removeprefix(e.effect).strip())
        for e in report.effects
    )
    hidden = [e.effect.replace('_', ' ') for e in report.effects if not e.data.get('visible')]
    words = (f'Not shown by this path: {listed(hidden)}.',) if hidden else ()
    table = Table(('Effect', 'Smallest size that a diagnosis would find'), rows, stacked=True)
    return Section('effects', 'Effects beyond the rigid body', words, tables=(table,))
