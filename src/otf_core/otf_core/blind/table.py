# SPDX-License-Identifier: Apache-2.0
"""Tables of a blind trial: as text for the terminal, as Markdown for the docs.

Both come from the same rows, so nothing is published that a command did not write.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from otf_core.blind import score
from otf_core.blind.counts import Row, expected_calibration_error, reliability
from otf_core.blind.outcome import Outcome
from otf_core.blind.recovery import Recovery

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


def criteria(
    outcomes: Sequence[Outcome], recovered: Sequence[Recovery], alone: Sequence[Outcome] = ()
) -> list[Table]:
    """What a trial comes to: names, sizes, what one of two tracker places says."""
    tables = [
        of_rows(('what is hidden', 'cells or causes'), score.summary(outcomes)),
        of_rows(('sizes', ''), score.sizes(recovered, outcomes)),
    ]
    if alone:
        head = ('two tracker places, the first alone', 'cells')
        tables.append(of_rows(head, score.first_place(alone)))
    return tables


def particulars(outcomes: Sequence[Outcome]) -> list[Table]:
    """Names by size in the residual, by hidden effect, by the confidence stated."""
    confusion = [(row.name, row.share, words) for row, words in score.confusion(outcomes)]
    return [
        of_rows(('left in the residual by one effect', 'named rightly'), score.by_size(outcomes)),
        Table(('hidden', 'answered rightly', 'answers'), confusion),
        confidences(outcomes),
    ]


def confidences(outcomes: Sequence[Outcome]) -> Table:
    """Reliability: the confidence stated for causes, and how many of them are there."""
    classes = reliability(score.stated(outcomes))
    rows = [(s.row.name, f'{s.mean:.2f}', s.row.share, s.row.interval) for s in classes]
    error = expected_calibration_error(classes)
    rows.append(('expected calibration error', f'{error:.3f}', '', ''))
    head = ('confidence stated', 'on average', 'causes that are there', '95 % interval')
    return Table(head, rows)


def misses(outcomes: Sequence[Outcome]) -> Table:
    """Every cell that was not answered rightly, or with a needless cause."""
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


def without_itself(outcomes: Sequence[Outcome], recovered: Mapping[str, Recovery]) -> list[Table]:
    """Leave one out: the criteria, and every cell."""
    rows = []
    for o in outcomes:
        pairs = zip(o.named, o.confidence, strict=True)
        words = ', '.join(f'{n} ({c:.2f})' for n, c in pairs) or '-'
        apart = score.told_apart(o, recovered)
        seen = f'{o.size_um[0]:.2f} um' + ('' if all(o.visible) else ', no trace')
        told = f'{apart:.0f}' if o.named and np.isfinite(apart) else ''
        rows.append((o.truth[0], seen, o.verdict, words, ', '.join(o.inputs) or '-', told))
    head = ('taken out', 'left in the residual', 'verdict', 'causes (confidence)', 'inputs',
            'told apart at best by (standard deviations)')  # fmt: skip
    first = ('effects that leave a trace, each taken out of the catalogue', 'cells')
    return [of_rows(first, score.leave_one_out(outcomes, recovered)), Table(head, rows)]
