# SPDX-License-Identifier: Apache-2.0
"""Page of a comparison: do two sources agree, in the volume, motion by motion, in squareness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.comparison.compare import COVERAGE_FACTOR, Comparison, agreement
from otf_core.model.evaluation import mean_length
from otf_core.model.frames import XYZ
from otf_core.model.motions import DIRECTIONS, ErrorMotion, unit_of
from otf_core.reports.drawing.bars import Bar, bars
from otf_core.reports.drawing.heat import heat_key, heat_step
from otf_core.reports.drawing.typography import text
from otf_core.reports.page import Heading, page_html
from otf_core.reports.plots.comparison import (
    BANDS,
    difference_histogram,
    difference_panel,
    motion_panel,
    vectors,
)
from otf_core.reports.quantities import micro, micro_unit
from otf_core.reports.section import Picture, Section, State, Table

Array = NDArray[np.float64]

AGREES = 0.95
"""Share of normalised errors up to 1 from which two sources agree: that of their coverage."""


def all_normalised(result: Comparison) -> Array:
    """E_n of all nodes and squareness errors, those without an uncertainty left out, (n,)."""
    parts = [m.normalised for m in result.motions.values()]
    parts.append(np.array([s.normalised for s in result.squareness.values()]))
    found = np.concatenate(parts)
    return np.asarray(found[np.isfinite(found)])


def comparison_html(result: Comparison, convention: str, remarks: Sequence[str], date: str) -> str:
    """Return the page.

    Parameters
    ----------
    result : Comparison
    convention : str
        In which both are compared.
    remarks : sequence of str
        What has to be known beside the numbers.
    date : str
        When this was written.
    """
    gauge = (f'{convention[:1].upper()}{convention[1:]}.',)
    sections = [
        _overview(result, remarks),
        _errors(result),
        Section('motions', 'Error motions of both', gauge,
                draw=lambda: _motions(result)),
        Section('volume', 'Differences in the volume', draw=lambda: _volume(result)),
    ]  # fmt: skip
    return page_html(_heading(result, date), sections)


def _heading(result: Comparison, date: str) -> Heading:
    a, b = result.names
    found, volume = all_normalised(result), result.volume
    mean = micro(mean_length(volume.difference))
    badge = State('no uncertainty stated', 'open')
    tiles = [
        (f'a: {a}', f'{micro(mean_length(volume.a))} um', 'mean error in the volume'),
        (f'b: {b}', f'{micro(mean_length(volume.b))} um', 'mean error in the volume'),
        ('b - a', f'{mean} um', 'mean length of the difference, without squareness'),
    ]
    if volume.squareness is not None:
        mean = micro(volume.squareness[2])
        tiles = [
            (f'a: {a}', f'{micro(volume.squareness[0])} um', 'mean error in the volume'),
            (f'b: {b}', f'{micro(volume.squareness[1])} um', 'mean error in the volume'),
            ('b - a', f'{mean} um', 'mean length of the difference; rigid motion taken out'),
        ]
    sentence = f'They differ by {mean} um on average in the volume.'
    if found.size:
        share = agreement(found)
        good = share >= AGREES
        badge = State('agree within U', 'good') if good else State('differ beyond U', 'bad')
        sentence += (
            f' {100 * share:.0f} % of the values agree within their expanded uncertainties '
            f'(E_n up to 1), the largest E_n is {found.max():.2f}.'
        )
        tiles.append(('E_n up to 1', f'{100 * share:.0f} %', f'of {found.size} values'))
    title, machine = f'Comparison of {a} and {b}', result.common.machine.name
    return Heading(title, sentence, (badge,), tuple(tiles), f'{machine}, {title}, {date}')


def _overview(result: Comparison, remarks: Sequence[str]) -> Section:
    def draw() -> Sequence[Picture]:
        rows = [_bar(n, m.normalised) for n, m in result.motions.items()]
        rows += [_bar(n, np.array([s.normalised])) for n, s in result.squareness.items()]
        difference = result.volume.difference
        step = heat_step(1e6 * np.linalg.norm(difference, axis=1))
        key = heat_key(step, 1e6 * float(np.linalg.norm(difference, axis=1).max()), 'µm')
        arrows = vectors(result.volume.q, difference, step)
        what = 'Left: difference b less a of the error vectors, squareness left out.'
        if not all_normalised(result).size:
            return [Picture((arrows,), what, key=key)]
        caption = f'{what} Right: largest E_n of each error; stroke: 1, the limit of agreement.'
        return [Picture((arrows, bars(rows, 'largest E_n', width=480.0)), caption, 2, key=key)]

    words = tuple(f'{line[:1].upper()}{line[1:]}.' for line in remarks)
    return Section('overview', '', words, draw=draw)


def _bar(name: str, normalised: Array) -> Bar:
    known = normalised[np.isfinite(normalised)]
    if not known.size:
        return Bar(name, (), 'no uncertainty')
    worst = float(known.max())
    kind = 'good' if worst <= 1.0 else 'bad'
    return Bar(name, ((worst, kind),), f'{worst:.2f}', 1.0)


def _errors(result: Comparison) -> Section:
    k, rows = COVERAGE_FACTOR, []
    for name, motion in result.motions.items():
        known = motion.normalised[np.isfinite(motion.normalised)]
        rows.append((
            name, micro_unit(unit_of(name)), micro(float(np.ptp(motion.a))),
            micro(float(np.ptp(motion.b))), micro(float(np.abs(motion.difference).max())),
            _wide(k * float(motion.u_a.max())), _wide(k * float(motion.u_b.max())),
            *_judged(known),
        ))  # fmt: skip
    for name, one in result.squareness.items():
        found = np.array([one.normalised])
        rows.append((
            name, 'urad', micro(one.a), micro(one.b), micro(abs(one.difference)),
            _wide(k * one.u_a), _wide(k * one.u_b), *_judged(found[np.isfinite(found)]),
        ))  # fmt: skip
    words = (
        'a and b: span of an error motion, value of a squareness error, both in the same gauge; '
        'U: largest, k = 2; E_n: difference over the root of the sum of both U squared.',
    )
    head = ('Error', 'Unit', 'a', 'b', 'Largest |b - a|', 'U of a', 'U of b', 'Largest E_n',
            'E_n up to 1')  # fmt: skip
    table = Table(head, tuple(rows), numbers=tuple(range(2, 8)), stacked=True)
    return Section('errors', 'Error by error', words, tables=(table,))


def _wide(value: float) -> str:
    return micro(value) if value > 0 else '-'


def _judged(known: Array) -> tuple[str, State]:
    if not known.size:
        return '-', State('no uncertainty')
    share = agreement(known)
    mood = 'good' if share >= AGREES else 'bad'
    return f'{known.max():.2f}', State(f'{100 * share:.0f} %', mood)


def _motions(result: Comparison) -> Sequence[Picture]:
    axes, a, b = result.common.machine.axis_names, *result.names
    motions = [ErrorMotion(d, axis) for d in DIRECTIONS for axis in axes]
    key = ''.join(
        f'<span class="{kind}-key"><span class="key"></span>{text(said)}</span> '
        for kind, said in (('after', f'a: {a}'), ('before', f'b: {b}'))
    )
    legend = f'<p class="soft keys">{key}</p>'
    return [
        Picture(tuple(motion_panel(result, m) for m in motions), BANDS, 3, key=legend),
        Picture(tuple(difference_panel(result, m) for m in motions),
                'Line: b less a; grey: U of the difference.', 3, 'Differences'),
    ]  # fmt: skip


def _volume(result: Comparison) -> Sequence[Picture]:
    difference = 1e6 * result.volume.difference
    reach = float(np.abs(difference).max()) or 1.0
    panels = tuple(difference_histogram(difference[:, k], reach, XYZ[k]) for k in range(3))
    return [Picture(panels, 'Share of points by the difference along X, Y and Z.', 3)]
