# SPDX-License-Identifier: Apache-2.0
"""Uncertainty: the budget by source, and correlations between the tables."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import (
    EFFECTS,
    MISFIT,
    NOISE,
    PLACES,
    SMOOTHNESS,
    STRAIGHT,
    SYSTEMATIC,
    TYPICAL_SOURCE,
    Budget,
)
from otf_core.budget.lines import GRID, LISTED_CORRELATION, BudgetLine, correlations
from otf_core.calibration.document import LISTED_PAIRS
from otf_core.model.expanded import quantity, readable_unit
from otf_core.model.machine import Machine
from otf_core.model.presets import TYPICAL
from otf_core.model.sections import DECLARABLE
from otf_core.model.tables import ErrorTables
from otf_core.prediction.volumetric import table_places
from otf_core.reports.calibration_facts import (
    CalibrationFacts,
)
from otf_core.reports.drawing.panel import Bar, bars, svg
from otf_core.reports.drawing.panel import words as svg_words
from otf_core.reports.drawing.style import text
from otf_core.reports.page import Picture, Section, Table, dof_words, join_names, micro

TYPE_A = (NOISE, MISFIT, SMOOTHNESS)
"""Evaluated from the observations (GUM 2.3.2); all others are type B."""
SHARED = {NOISE: 'within 1 s', MISFIT: 'along a line', SMOOTHNESS: 'between nodes', STRAIGHT: 'no',
          EFFECTS: 'yes, whole run'}  # fmt: skip
"""Over what a contribution is common to several observations."""
CELL_SIZE, NAME_WIDTH = 17.0, 42.0
"""px; size of a cell, room for names."""
VERY_STRONG = 0.8
"""Coefficient above which a pair is counted once more."""
UNFOLDED_PAIRS = 6
"""Pairs that are not folded away."""
POWER_ITERATIONS = 60
"""Of the power method that finds the worst combination."""


def budget_section(facts: CalibrationFacts) -> Section:
    """The uncertainty budget of a calibration."""
    return section_of_budget(facts.tables, facts.result.budget, facts.lines)


def section_of_budget(tables: ErrorTables, budget: Budget, lines: Sequence[BudgetLine]) -> Section:
    """The uncertainty budget: every quantity as a bar, every source as a row.

    Parameters
    ----------
    budget : Budget
        As stated, of the same nodes.
    lines : sequence of BudgetLine
        With typical values where nothing is declared; the grid last.
    """
    words = [
        'Standard uncertainties (k = 1) by source, root mean square over the nodes of a table '
        '(those that the gauge fixes left out) or over a grid of the driven volume; squares add '
        'up. The share of a colour in a bar is its share of the variance.',
    ]
    if budget.not_stated:
        words.append(
            f'Not declared in machine.yaml: {join_names(budget.not_stated)}; typical values are '
            f'used for them as one source (presets {join_names(TYPICAL)}).'
        )
    grid = lines[-1]
    most = max(grid.parts, key=lambda name: grid.parts[name])
    share = 100.0 * grid.parts[most] ** 2 / max(grid.u**2, 1e-300)
    words.insert(0, f'The largest contribution in the volume is {most}: {share:.0f} % of the '
                    f'variance.')  # fmt: skip
    rows = tuple(
        _source_row(tables.machine, budget, name, grid)
        for name, part in grid.parts.items()
        if part > 0
    )
    head = ('Source', 'Type', 'Distribution', 'Standard uncertainty stated',
            'Sensitivity (um per unit)', 'In the volume (um)', 'Share (%)', 'dof',
            'Correlated')  # fmt: skip
    listed = (
        Table(head, rows, numbers=(5, 6, 7), title='Error vector in the volume'),
        _quantity_table(lines),
    )
    data = {line.name: {'u': line.u, 'k': line.k, 'sources': line.parts} for line in lines}
    return Section('budget', 'Uncertainty budget', tuple(words), data, listed,
                   draw=lambda: _budget_pictures(lines))  # fmt: skip


def _source_row(machine: Machine, budget: Budget, name: str, grid: BudgetLine) -> tuple[str, ...]:
    part = grid.parts[name]
    freedoms = dict(zip(budget.names, budget.freedoms.tolist(), strict=True))
    share = 100.0 * part**2 / max(grid.u**2, 1e-300)
    stated, sensitivity = _stated_words(machine, name, part)
    return (
        name,
        'A' if name in TYPE_A else 'B',
        'normal',
        stated,
        sensitivity,
        micro(part, 3),
        f'{share:.1f}',
        dof_words(freedoms.get(name, np.inf)),
        SHARED.get(name, 'yes, all observations'),
    )


def _stated_words(machine: Machine, name: str, part: float) -> tuple[str, str]:
    """What machine.yaml states for a source, and what the volume gets per unit of it."""
    if name == TYPICAL_SOURCE:
        return f'typical: presets {join_names(TYPICAL)}', '-'
    keys = next((s.keys for s in SYSTEMATIC if s.source == name), ())
    declared = machine.uncertainty
    if name == PLACES:
        return 'targets: u of every place', '-'
    values = {k: declared.values[k] for k in keys if declared and declared.values.get(k)}
    if not values:
        return 'from the data', '-'
    words = ', '.join(
        f'{key.replace("_", " ")} {quantity(value, None, DECLARABLE[key][0])}'
        for key, value in values.items()
    )
    if len(values) > 1:
        return words, '-'
    (key, value), *_ = values.items()
    factor, unit = readable_unit(DECLARABLE[key][0], value)
    return words, f'{1e6 * part / (factor * value):.3g} per {unit}'


def _quantity_table(lines: Sequence[BudgetLine]) -> Table:
    names = [n for n in lines[-1].parts if any(line.parts[n] for line in lines)]
    rows = tuple(
        (
            'volume' if line.name == GRID else line.name,
            'um' if line.unit == 'm' else 'urad',
            micro(line.k * line.u, 3),
            micro(line.u, 3),
            f'{line.k:.2f}',
            dof_words(line.dof),
            *(micro(line.parts[n], 3) for n in names),
        )
        for line in lines
    )
    head = ('', 'Unit', 'U, 95 %', 'u, k = 1', 'k', 'dof', *names)
    return Table(head, rows, numbers=tuple(range(2, len(head))), folded='All numbers',
                 title='By quantity and source')  # fmt: skip


def _budget_pictures(lines: Sequence[BudgetLine]) -> Sequence[Picture]:
    names = [n for n in lines[-1].parts if any(line.parts[n] for line in lines)]
    parts = []
    for unit, label in (('m', 'µm'), ('rad', 'µrad')):
        rows = [_quantity_bar(line, names, label) for line in lines if line.unit == unit]
        if rows:
            parts.append(bars(rows, f'uncertainty in {label}', names=52.0))
    key = ''.join(
        f'<span class="s{k}"><span class="key"></span>{text(n)}</span> '
        for k, n in enumerate(names)
    )
    caption = 'Standard uncertainty, k = 1: left in micrometres, right in microradians.'
    legend = f'<p class="soft keys">{key}</p>'
    return [Picture(tuple(parts), caption, columns=2, key=legend)]


def _quantity_bar(line: BudgetLine, names: Sequence[str], label: str) -> Bar:
    shares = tuple(
        (1e6 * line.parts[n] ** 2 / max(line.u, 1e-300), f'share s{k}')
        for k, n in enumerate(names)
    )
    name = 'volume' if line.name == GRID else line.name
    return Bar(name, shares, f'{micro(line.u, 3)} {label}')


def correlations_section(facts: CalibrationFacts) -> Section:
    """Correlations between the tables of a calibration."""
    result = facts.result
    return section_of_correlations(facts.tables, result.covariance, result.not_identifiable)


def section_of_correlations(
    tables: ErrorTables, covariance: Array, hidden: Collection[str]
) -> Section:
    """Correlations between tables: pairs, a picture of all of them, the worst combination.

    Parameters
    ----------
    covariance : ndarray, shape (m, m), m and rad
        Of scalars and nodes.
    hidden : collection of str
        What the data do not determine.
    """
    strong = correlations(tables, covariance)
    strongest = [c for c in strong if abs(c.r) > VERY_STRONG]
    share, members = worst_combination(tables, covariance)
    listed_members = join_names(f'{name} ({100 * part:.0f} %)' for name, part in members)
    words = (
        f'The least certain combination: {listed_members}; it accounts for {100 * share:.0f} % '
        f'of the total variance of the tables (um and urad weighted equally).',
        f'{len(strong)} pairs of tables are correlated by at least {LISTED_CORRELATION}, '
        f'{len(strongest)} by '
        f'more than {VERY_STRONG}; of two tables the pair of nodes with the strongest correlation '
        f'counts. Predictions use the full covariance, so correlations are not lost.',
    )
    rows = tuple((*c.between, f'{c.r:.2f}') for c in strong[:LISTED_PAIRS])
    head = ('Between', 'and', 'r')
    listed = [Table(head, rows[:UNFOLDED_PAIRS], numbers=(2,), title='Strongest')] if rows else []
    if len(rows) > UNFOLDED_PAIRS:
        more = f'The next ones, up to {LISTED_PAIRS}'
        listed.append(Table(head, rows[UNFOLDED_PAIRS:], numbers=(2,), folded=more))
    data = {'pairs': len(strong), 'worst': {'share': share, 'members': dict(members)}}
    return Section('correlations', 'Correlations', words, data, tuple(listed),
                   draw=lambda: _correlation_pictures(tables, covariance, hidden))  # fmt: skip


def worst_combination(
    tables: ErrorTables, covariance: Array
) -> tuple[float, list[tuple[str, float]]]:
    """Share of the variance of the combination known worst, and of its largest members."""
    vector = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not vector.any():
        return 0.0, []
    for _ in range(POWER_ITERATIONS):
        vector = covariance @ vector
        vector = vector / np.linalg.norm(vector)
    largest = float(vector @ covariance @ vector)
    parts = {n: float(np.sum(vector[p] ** 2)) for n, p in table_places(tables).items()}
    members = sorted(parts.items(), key=lambda pair: -pair[1])[:4]
    return largest / float(np.trace(covariance)), [m for m in members if m[1] > 0.02]


def _largest_correlations(tables: ErrorTables, covariance: Array) -> Array:
    """Largest correlation in size between every two tables, shape (n, n)."""
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    size = np.abs(covariance) / np.outer(*[np.where(u > 1e-6 * u.max(initial=0.0), u, np.inf)] * 2)
    starts = [p.start for p in table_places(tables).values()]
    rows = np.maximum.reduceat(size, starts, axis=0)
    return np.asarray(np.maximum.reduceat(rows, starts, axis=1))


def _correlation_pictures(
    tables: ErrorTables, covariance: Array, hidden: Collection[str]
) -> Sequence[Picture]:
    r, unknown = _largest_correlations(tables, covariance), set(hidden)
    names, marks = list(table_places(tables)), list[str]()
    for i, name in enumerate(names):
        y = NAME_WIDTH + i * CELL_SIZE
        marks.append(svg_words(NAME_WIDTH - 4.0, y + 12.0, name, 'end'))
        marks.append(
            svg_words(NAME_WIDTH + i * CELL_SIZE + 12.0, NAME_WIDTH - 4.0, name, '', turned=True)
        )
        for j in range(i):
            if {name, names[j]} & unknown:
                continue
            level = int(min(r[i, j], 0.999) * 5)
            marks.append(
                f'<rect class="area heat h{level}" x="{NAME_WIDTH + j * CELL_SIZE:.0f}" '
                f'y="{y:.0f}" width="{CELL_SIZE - 1:.0f}" height="{CELL_SIZE - 1:.0f}"/>'
            )
    size = NAME_WIDTH + len(names) * CELL_SIZE + 6.0
    keys = ''.join(
        f'<span class="h{k}"><span class="key"></span>{0.2 * k:.1f} to {0.2 * k + 0.2:.1f}</span> '
        for k in range(5)
    )
    picture = svg(size, size, marks, 'largest correlation between tables')
    key = f'<p class="soft keys">{keys}</p>'
    caption = 'Largest correlation in size between the nodes of every two tables.'
    if unknown:
        caption += ' No colour: a motion that the data do not determine.'
    return [Picture((picture + key,), caption)]
