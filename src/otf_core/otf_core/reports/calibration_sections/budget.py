# SPDX-License-Identifier: Apache-2.0
"""The uncertainty budget: every quantity as a bar, every source as a row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.budget.budget import (
    EFFECTS,
    MISFIT,
    NOISE,
    SMOOTHNESS,
    STRAIGHT,
    TYPICAL_SOURCE,
)
from otf_core.budget.systematic import SYSTEMATIC
from otf_core.model.declared import KEYS
from otf_core.model.presets import TYPICAL
from otf_core.model.quantities import quantity, scaled
from otf_core.reports.budget import GRID, BudgetLine, format_budget
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.drawing.bars import Bar, bars
from otf_core.reports.drawing.typography import text
from otf_core.reports.quantities import dof_words, listed, micro
from otf_core.reports.section import Picture, Section, Table

TYPE_A = (NOISE, MISFIT, SMOOTHNESS)
"""Evaluated from the observations (GUM 2.3.2); all others are type B."""
SHARED = {NOISE: 'within 1 s', MISFIT: 'along a line', SMOOTHNESS: 'between nodes', STRAIGHT: 'no',
          EFFECTS: 'yes, whole run'}  # fmt: skip
"""Over what a contribution is common to several observations."""


def section(facts: Facts) -> Section:
    """Return the section."""
    result, budget = facts.result, facts.result.budget
    words = [
        'Standard uncertainties (k = 1) by source, root mean square over the nodes of a table '
        '(those that the gauge fixes left out) or over a grid of the driven volume; squares add '
        'up. The share of a colour in a bar is its share of the variance.',
    ]
    if budget.not_stated:
        words.append(
            f'Not declared in machine.yaml: {listed(budget.not_stated)}; typical values stand for '
            f'them as one source (presets {listed(TYPICAL)}).'
        )
    grid = facts.by_name[GRID]
    most = max(grid.parts, key=lambda name: grid.parts[name])
    share = 100.0 * grid.parts[most] ** 2 / max(grid.u**2, 1e-300)
    words.insert(0, f'The largest contribution in the volume is {most}: {share:.0f} % of the '
                    f'variance.')  # fmt: skip
    rows = tuple(_source(facts, name, grid) for name, part in grid.parts.items() if part > 0)
    head = ('Source', 'Type', 'Distribution', 'Standard uncertainty stated',
            'Sensitivity (um per unit)', 'In the volume (um)', 'Share (%)', 'dof',
            'Correlated')  # fmt: skip
    tables = (
        Table(head, rows, numbers=(5, 6, 7), title='Error vector in the volume'),
        _quantities(facts),
    )
    data = {line.name: {'u': line.u, 'k': line.k, 'sources': line.parts} for line in facts.lines}
    return Section('budget', 'Uncertainty budget', tuple(words), data, tables,
                   (format_budget(result.tables, budget, list(facts.lines)),),
                   draw=lambda: _pictures(facts))  # fmt: skip


def _source(facts: Facts, name: str, grid: BudgetLine) -> tuple[str, ...]:
    budget, part = facts.result.budget, grid.parts[name]
    freedoms = dict(zip(budget.names, budget.freedoms.tolist(), strict=True))
    share = 100.0 * part**2 / max(grid.u**2, 1e-300)
    stated, sensitivity = _stated(facts, name, part)
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


def _stated(facts: Facts, name: str, part: float) -> tuple[str, str]:
    """What machine.yaml states for a source, and what the volume gets per unit of it."""
    if name == TYPICAL_SOURCE:
        return f'typical: presets {listed(TYPICAL)}', '-'
    keys = next((s.keys for s in SYSTEMATIC if s.source == name), ())
    declared = facts.machine.uncertainty
    values = {k: declared.values[k] for k in keys if declared and declared.values.get(k)}
    if not values:
        return 'from the data', '-'
    words = ', '.join(
        f'{key.replace("_", " ")} {quantity(value, None, KEYS[key][0])}'
        for key, value in values.items()
    )
    if len(values) > 1:
        return words, '-'
    (key, value), *_ = values.items()
    factor, unit = scaled(KEYS[key][0], value)
    return words, f'{1e6 * part / (factor * value):.3g} per {unit}'


def _quantities(facts: Facts) -> Table:
    names = [n for n in facts.by_name[GRID].parts if any(line.parts[n] for line in facts.lines)]
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
        for line in facts.lines
    )
    head = ('', 'Unit', 'U, 95 %', 'u, k = 1', 'k', 'dof', *names)
    return Table(head, rows, numbers=tuple(range(2, len(head))), folded='All numbers',
                 title='By quantity and source')  # fmt: skip


def _pictures(facts: Facts) -> Sequence[Picture]:
    names = [n for n in facts.by_name[GRID].parts if any(line.parts[n] for line in facts.lines)]
    parts = []
    for unit, label in (('m', 'µm'), ('rad', 'µrad')):
        rows = [_bar(line, names, label) for line in facts.lines if line.unit == unit]
        if rows:
            parts.append(bars(rows, f'uncertainty in {label}', names=52.0))
    key = ''.join(
        f'<span class="s{k}"><span class="key"></span>{text(n)}</span> '
        for k, n in enumerate(names)
    )
    caption = 'Standard uncertainty, k = 1: left in micrometres, right in microradians.'
    legend = f'<p class="soft keys">{key}</p>'
    return [Picture(tuple(parts), caption, columns=2, key=legend)]


def _bar(line: BudgetLine, names: Sequence[str], label: str) -> Bar:
    shares = tuple(
        (1e6 * line.parts[n] ** 2 / max(line.u, 1e-300), f'share s{k}')
        for k, n in enumerate(names)
    )
    name = 'volume' if line.name == GRID else line.name
    return Bar(name, shares, f'{micro(line.u, 3)} {label}')
