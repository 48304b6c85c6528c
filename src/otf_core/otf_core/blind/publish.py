# SPDX-License-Identifier: Apache-2.0
"""Tables and reliability diagram of a blind trial, for the terminal and for the docs.

Both come from the same rows, so nothing is published that a command did not write;
``tools/blind_table.py`` puts the fragments of Markdown into the docs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from otf_core.blind import score
from otf_core.blind.outcome import Outcome
from otf_core.blind.recovery import Recovery
from otf_core.blind.score import (
    ConfidenceClass,
    Row,
    binomial_interval,
    expected_calibration_error,
    reliability,
)
from otf_core.blind.seal import read_seal
from otf_core.files.strict_yaml import read_json
from otf_core.fleet.fleet import STATE

SIDE, EDGE = 260.0, 46.0
"""Pixels: of the square of both shares, and around it."""
TICKS = (0.0, 0.25, 0.5, 0.75, 1.0)


def _across(share: float) -> float:
    return EDGE + SIDE * share


def _up(share: float) -> float:
    return EDGE + SIDE * (1.0 - share)


def _line(x1: float, y1: float, x2: float, y2: float, look: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" {look}/>'


def _words(x: float, y: float, words: str, look: str = '') -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle" {look}>{words}</text>'


def _point(one: ConfidenceClass) -> list[str]:
    """A class: its share, the 95 % interval, and how many causes it holds."""
    x, low_high = _across(one.mean), binomial_interval(one.row.hits, one.row.of)
    bar = 'stroke="#1f77b4" stroke-width="2"'
    return [
        _line(x, _up(low_high[0]), x, _up(low_high[1]), bar),
        f'<circle cx="{x:.1f}" cy="{_up(one.row.hits / one.row.of):.1f}" r="5" fill="#1f77b4"/>',
        _words(x - 14.0, _up(low_high[0]) + 12.0, str(one.row.of), 'fill="#1f77b4"'),
    ]


def reliability_svg(classes: Sequence[ConfidenceClass]) -> str:
    """Draw the diagram as SVG; a point on the diagonal states what is so."""
    whole, plain = SIDE + 2.0 * EDGE, 'stroke="#888"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{whole:.0f}" height="{whole:.0f}" '
        f'viewBox="0 0 {whole:.0f} {whole:.0f}" font-family="sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="white"/>',
        f'<rect x="{EDGE}" y="{EDGE}" width="{SIDE}" height="{SIDE}" fill="none" {plain}/>',
        _line(_across(0.0), _up(0.0), _across(1.0), _up(1.0), f'{plain} stroke-dasharray="4"'),
    ]
    for tick in TICKS:
        parts.append(_words(_across(tick), _up(0.0) + 16.0, f'{tick:g}'))
        parts.append(_words(_across(0.0) - 18.0, _up(tick) + 4.0, f'{tick:g}'))
    for one in classes:
        parts += _point(one)
    middle = _across(0.5)
    parts.append(_words(middle, _up(0.0) + 34.0, 'confidence stated'))
    turned = f'transform="rotate(-90 12 {middle:.1f})"'
    parts.append(_words(12.0, middle, 'share of the causes that are there', turned))
    parts.append(_words(middle, 24.0, 'causes named in a blind trial, with 95 % intervals'))
    return '\n'.join([*parts, '</svg>\n'])


Cells = tuple[str, ...]


class Table(NamedTuple):
    """A table.

    Attributes
    ----------
    rows : sequence of tuple of str
        As many cells each.
    """

    head: Cells
    rows: Sequence[Cells]


def of_rows(head: Cells, rows: Sequence[Row]) -> Table:
    """Table of criteria with their intervals, less those that nothing was counted for."""
    return Table(
        (*head, '95 % interval'), [(row.name, row.share, row.interval) for row in rows if row.of]
    )


def as_text(table: Table) -> str:
    """Columns side by side, the head above."""
    first, *rows = [(table.head[0], *table.head[1:]), *table.rows]
    every = [first, *(tuple(_indented(c) for c in row) for row in rows)]
    width = [max(len(row[k]) for row in every) for k in range(len(first))]
    return '\n'.join(
        '  '.join(c.ljust(w) for c, w in zip(row, width, strict=True)).rstrip() for row in every
    )


def as_markdown(table: Table) -> str:
    """The same as a Markdown table."""
    lines = [table.head, ('---',) * len(table.head), *table.rows]
    cells = [[c.removeprefix(', ').replace('|', '\\|') for c in line] for line in lines]
    for line, plain in zip(cells, lines, strict=True):
        if plain[0].startswith(', '):
            line[0] = f'&nbsp;&nbsp;{line[0]}'
    return '\n'.join(f'| {" | ".join(line)} |' for line in cells)


def _indented(cell: str) -> str:
    return f'  {cell[2:]}' if cell.startswith(', ') else cell


def criteria(outcomes: Sequence[Outcome]) -> Table:
    """What a trial comes to, as it is published."""
    return of_rows(('what is hidden', 'cells or causes'), score.summary(outcomes))


def particulars(
    outcomes: Sequence[Outcome], recovered: Sequence[Recovery], alone: Sequence[Outcome] = ()
) -> list[Table]:
    """Sizes, what one of two tracker places says, every hidden effect, confidences."""
    confusion = [(row.name, row.share, words) for row, words in score.confusion(outcomes)]
    tables = [
        of_rows(('besides', 'cells'), score.further_counts(outcomes)),
        of_rows(('sizes', ''), score.sizes(recovered, outcomes)),
        Table(('hidden', 'answered correctly', 'answers'), confusion),
        confidences(outcomes),
    ]
    if alone:
        head = ('two tracker places, the first alone', 'cells')
        tables.append(of_rows(head, score.first_place(alone)))
    return tables


def confidences(outcomes: Sequence[Outcome]) -> Table:
    """Reliability: the confidence stated for causes, and how many of them are there."""
    classes = reliability(score.stated_confidences(outcomes))
    rows = [(s.row.name, f'{s.mean:.2f}', s.row.share, s.row.interval) for s in classes]
    error = expected_calibration_error(classes)
    rows.append(('expected calibration error', f'{error:.3f}', '', ''))
    head = ('confidence stated', 'on average', 'causes that are there', '95 % interval')
    return Table(head, rows)


def misses(outcomes: Sequence[Outcome]) -> Table:
    """Every cell that was not answered correctly, or with a needless cause."""
    rows = []
    for o in outcomes:
        if o.is_right and not o.extra:
            continue
        truth = ' + '.join(f'{t} {s:.2f} um' for t, s in zip(o.truth, o.size_um, strict=True))
        rows.append((o.cell, o.result, truth or 'nothing', f'{o.verdict}: {", ".join(o.named)}'))
    return Table(('cell', 'not right, or more than right', 'hidden', 'answer'), rows)


def shrink_words(recovered: Sequence[Recovery]) -> str:
    """How far the shrink that was predicted is off."""
    named = [r for r in recovered if r.true_gap_um > score.SMALL_GAP_UM and r.shrink_percent > 0]
    if not named:
        return ''
    difference = np.array([r.shrink_percent - r.achieved_percent for r in named])
    return (
        f'predicted less achieved shrink: median {np.median(difference):+.0f} points, '
        f'95 % within {np.percentile(np.abs(difference), 95):.0f} points'
    )


def leave_one_out_table(
    outcomes: Sequence[Outcome], recovered: Mapping[str, Recovery]
) -> list[Table]:
    """Leave one out: the criteria as they are published, and every cell."""
    rows = []
    for o in outcomes:
        pairs = zip(o.named, o.confidence, strict=True)
        words = ', '.join(f'{n} ({c:.2f})' for n, c in pairs) or '-'
        apart = score.distinguishability(o, recovered)
        seen = f'{o.size_um[0]:.2f} um' + ('' if all(o.visible) else ', no trace')
        separation = f'{apart:.0f}' if o.named and np.isfinite(apart) else ''
        rows.append((o.truth[0], seen, o.verdict, words, ', '.join(o.inputs) or '-', separation))
    head = ('taken out', 'left in the residual', 'verdict', 'causes (confidence)', 'inputs',
            'best separation (standard deviations)')  # fmt: skip
    first = ('what is hidden', 'cells or causes')
    return [of_rows(first, score.leave_one_out(outcomes, recovered)), Table(head, rows)]


TABLE, DIAGRAM = 'table.md', 'reliability.svg'
LEAVE_ONE_OUT, FIVE_AXES = '--leave-one-out', '--five-axes'
FOLDERS = {'': 'blind', LEAVE_ONE_OUT: 'without', FIVE_AXES: 'five'}
"""Options of the command, and the folders that its words name."""


@dataclass(frozen=True)
class TrialConditions:
    """Under what conditions a trial was measured.

    Attributes
    ----------
    key : str
        SHA-256 of the sealed key.
    seconds : tuple of float
        Of every diagnosis.
    option : str
        Of the command; a key of ``FOLDERS``.
    """

    cells: int
    seed: int
    date: str
    key: str
    seconds: tuple[float, ...]
    option: str = ''

    @classmethod
    def of(
        cls, folder: Path, entries: Sequence[Mapping[str, Any]], date: str, option: str = ''
    ) -> TrialConditions:
        """Read the conditions from the folder of a trial."""
        ended = [read_json(f)['outcome'] for f in sorted(folder.glob(f'{STATE}/answers*.json'))]
        times = tuple(float(e['seconds']) for e in ended if e['sha256'] is not None)
        return cls(len(entries), entries[0]['seed'], date, read_seal(folder), times, option)

    @property
    def command(self) -> str:
        """The command that makes the same cells again."""
        name = FOLDERS[self.option]
        option = f' {self.option}' if self.option else ''
        return f'./otf blind{option} --trials {self.cells} --seed {self.seed} --out {name}'


def sizes_words(recovered: Sequence[Recovery], outcomes: Sequence[Outcome]) -> str:
    """How well sizes hold, as a sentence."""
    rows = [r for r in score.sizes(recovered, outcomes) if r.of]
    return f'Sizes: {"; ".join(f"{r.name} in {r.share}" for r in rows)}.' if rows else ''


def fragment(measured: TrialConditions, table: Table, words: str = '') -> str:
    """Command, conditions, table and words below it."""
    times = measured.seconds
    lasted = (
        f'; a diagnosis took {median(times):.0f} s, at most {max(times):.0f} s' if times else ''
    )
    said = f'Measured on {measured.date}{lasted}. SHA-256 of the key: `{measured.key[:16]}...`.'
    parts = [f'```\n{measured.command}\n```', said, as_markdown(table), words]
    return '\n\n'.join(part for part in parts if part) + '\n'
