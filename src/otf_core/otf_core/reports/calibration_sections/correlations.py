# SPDX-License-Identifier: Apache-2.0
"""Correlations between tables: pairs, a picture of all of them, the worst combination."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.prediction.volumetric import table_places
from otf_core.reports.budget import LISTED, STRONG, correlations
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.drawing.panel import svg, words
from otf_core.reports.quantities import listed
from otf_core.reports.section import Picture, Section, Table

Array = NDArray[np.float64]

NAMES = (*SQUARENESS, *MOTIONS)
CELL, ROOM = 17.0, 42.0
"""px; size of a cell, room for names."""
WARN = 0.8
SHOWN = 6
"""Pairs that are not folded away."""
ROUNDS = 60
"""Of the power iteration."""


def section(facts: Facts) -> Section:
    """Return the section."""
    covariance = facts.result.covariance
    strong = correlations(facts.tables, covariance)
    strongest = [c for c in strong if abs(c.r) > WARN]
    share, members = worst_combination(facts)
    listed_members = listed(f'{name} ({100 * part:.0f} %)' for name, part in members)
    said = (
        f'The combination that is known worst: {listed_members}; it holds {100 * share:.0f} % of '
        f'the whole variance of the tables (um and urad counted alike).',
        f'{len(strong)} pairs of tables are correlated by at least {STRONG}, {len(strongest)} by '
        f'more than {WARN}; of two tables the pair of nodes with the strongest correlation '
        f'counts. Predictions use the full covariance, so correlations are not lost.',
    )
    rows = tuple((*c.between, f'{c.r:.2f}') for c in strong[:LISTED])
    head = ('Between', 'and', 'r')
    tables = [Table(head, rows[:SHOWN], numbers=(2,), title='Strongest')] if rows else []
    if len(rows) > SHOWN:
        more = f'The next ones, up to {LISTED}'
        tables.append(Table(head, rows[SHOWN:], numbers=(2,), folded=more))
    data = {'pairs': len(strong), 'worst': {'share': share, 'members': dict(members)}}
    return Section('correlations', 'Correlations', said, data, tuple(tables),
                   draw=lambda: _pictures(facts))  # fmt: skip


def worst_combination(facts: Facts) -> tuple[float, list[tuple[str, float]]]:
    """Share of the variance of the combination known worst, and of its largest members."""
    covariance = facts.result.covariance
    vector = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not vector.any():
        return 0.0, []
    for _ in range(ROUNDS):
        vector = covariance @ vector
        vector = vector / np.linalg.norm(vector)
    largest = float(vector @ covariance @ vector)
    parts = {n: float(np.sum(vector[p] ** 2)) for n, p in table_places(facts.tables).items()}
    members = sorted(parts.items(), key=lambda pair: -pair[1])[:4]
    return largest / float(np.trace(covariance)), [m for m in members if m[1] > 0.02]


def _strongest(facts: Facts) -> Array:
    """Largest correlation in size between every two tables, shape (21, 21)."""
    covariance = facts.result.covariance
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    size = np.abs(covariance) / np.outer(*[np.where(u > 1e-6 * u.max(initial=0.0), u, np.inf)] * 2)
    starts = [p.start for p in table_places(facts.tables).values()]
    rows = np.maximum.reduceat(size, starts, axis=0)
    return np.asarray(np.maximum.reduceat(rows, starts, axis=1))


def _pictures(facts: Facts) -> Sequence[Picture]:
    r, unknown = _strongest(facts), set(facts.result.not_identifiable)
    marks: list[str] = []
    for i, name in enumerate(NAMES):
        y = ROOM + i * CELL
        marks.append(words(ROOM - 4.0, y + 12.0, name, 'end'))
        marks.append(words(ROOM + i * CELL + 12.0, ROOM - 4.0, name, '', turned=True))
        for j in range(i):
            if {name, NAMES[j]} & unknown:
                continue
            level = int(min(r[i, j], 0.999) * 5)
            marks.append(
                f'<rect class="area heat h{level}" x="{ROOM + j * CELL:.0f}" y="{y:.0f}" '
                f'width="{CELL - 1:.0f}" height="{CELL - 1:.0f}"/>'
            )
    size = ROOM + len(NAMES) * CELL + 6.0
    keys = ''.join(
        f'<span class="h{k}"><span class="key"></span>{0.2 * k:.1f} to {0.2 * k + 0.2:.1f}</span> '
        for k in range(5)
    )
    picture = svg(size, size, marks, 'largest correlation between tables')
    key = f'<p class="soft keys">{keys}</p>'
    caption = 'Largest correlation in size between the nodes of every two tables.'
    if unknown:
        caption += ' No colour: a motion that the data do not show.'
    return [Picture((picture + key,), caption)]
