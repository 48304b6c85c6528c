# SPDX-License-Identifier: Apache-2.0
"""The budget as data and as text: expanded uncertainties, sources, correlations."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import NAMES, TYPICAL_SOURCE, Budget
from otf_core.files.csv_points import tidy
from otf_core.model.evaluation import driven_grid, free_rows
from otf_core.model.expanded import COVERAGE_PROBABILITY
from otf_core.model.motions import MOTIONS, SQUARENESS, unit_of
from otf_core.model.tables import ErrorTables
from otf_core.prediction.uncertainty import prediction_rows
from otf_core.prediction.volumetric import table_places
from otf_core.reports.wording import dof_words, whole_dof
from otf_core.threads import one_thread

GRID = 'grid'
STRONG = 0.5
"""Correlations at least as large are listed."""
LISTED_PAIRS = 20
SHORT = {
    'smoothness': 'smooth',
    'straight lines': 'lines',
    'tracker scale': 'scale',
    'tracker range offset': 'offset',
    'tracker angles': 'angles',
    'machine temperature': 'machine',
    'target offset': 'target',
    TYPICAL_SOURCE: 'typical',
}
"""Names of sources as heads of columns."""


@dataclass(frozen=True)
class BudgetLine:
    """One quantity of the budget.

    Attributes
    ----------
    name : str
        Squareness error, motion, or 'grid': length of the error vector on a regular grid over
        the driven volume, the best rigid motion taken out.
    unit : str
        m or rad.
    u : float
        Standard uncertainty, root mean square over nodes (those that the gauge fixes left out)
        or grid points.
    parts : mapping of source to float
        The same by source; their squares add up.
    k, dof : float
        Coverage factor for 95 % and effective degrees of freedom; infinite ones are possible.
    """

    name: str
    unit: str
    u: float
    parts: dict[str, float]
    k: float
    dof: float


def _line(
    budget: Budget, name: str, unit: str, variances: Array, components: int = 1
) -> BudgetLine:
    known = variances[:, variances.sum(axis=0) > 0]
    mean = np.sqrt(components * known.mean(axis=1)) if known.size else np.zeros(len(variances))
    parts = {n: float(v) for n, v in zip(budget.names, mean, strict=True)}
    return BudgetLine(name, unit, float(np.sqrt(np.sum(mean**2))), parts, *budget.expansion(known))


def budget_lines(tables: ErrorTables, budget: Budget) -> list[BudgetLine]:
    """Lines for everything that is identifiable, and for the grid.

    Parameters
    ----------
    tables : ErrorTables
    budget : Budget
        Of the same nodes.
    """
    variances, lines = budget.variances(), []
    for name, place in table_places(tables).items():
        if variances[:, place].any():
            unit = 'rad' if name in SQUARENESS else unit_of(name)
            lines.append(_line(budget, name, unit, variances[:, place]))
    grid = driven_grid(tables)
    rows = prediction_rows(tables.machine, {m: tables.motions[m].position for m in MOTIONS}, grid)
    with one_thread():
        free = free_rows(rows.reshape(-1, rows.shape[2]), grid)
        return [*lines, _line(budget, GRID, 'm', budget.variances(free), components=3)]


def expanded(tables: ErrorTables, lines: list[BudgetLine]) -> dict[str, dict[str, Any]]:
    """U, k and dof of every squareness error and motion, as they stand in error_tables.json."""
    found: dict[str, dict[str, Any]] = {}
    by_name = {line.name: line for line in lines}
    for name in NAMES:
        line = by_name.get(name)
        k = line.k if line else 0.0
        if name in SQUARENESS:
            wide: Any = k * tables.squareness[name].u
        else:
            wide = (k * tables.motions[name].u).tolist()
        found[name] = {
            'U': wide,
            'k': k if line else None,
            'dof': whole_dof(line.dof) if line else None,
        }
    return found


@dataclass(frozen=True)
class Correlation:
    """Strongest correlation between two tables: where, and the coefficient."""

    between: tuple[str, str]
    r: float


def correlations(tables: ErrorTables, covariance: Array) -> list[Correlation]:
    """Correlations of at least ``STRONG`` between squareness errors and motions.

    Of two motions the pair of nodes with the strongest correlation counts.

    Returns
    -------
    list of Correlation
        Strongest first.
    """
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(u > 1e-6 * u.max(initial=0.0), u, np.inf)
    r = covariance / np.outer(unit, unit)
    places, found = table_places(tables), []
    for one, other in combinations(NAMES, 2):
        part = r[places[one], places[other]]
        at = np.unravel_index(int(np.argmax(np.abs(part))), part.shape)
        if abs(part[at]) >= STRONG:
            names = [_at_node(tables, n, int(i)) for n, i in zip((one, other), at, strict=True)]
            found.append(Correlation((names[0], names[1]), float(part[at])))
    return sorted(found, key=lambda c: -abs(c.r))


def _at_node(tables: ErrorTables, name: str, node: int) -> str:
    if name in SQUARENESS:
        return name
    return f'{name} at {tidy(1e3 * float(tables.motions[name].position[node])):g} mm'


def budget_to_dict(tables: ErrorTables, budget: Budget, lines: list[BudgetLine]) -> dict[str, Any]:
    """Budget and correlations as plain data; see docs/uncertainty.md."""
    strong = correlations(tables, budget.covariance)
    freedoms = dict(zip(budget.names, budget.freedoms.tolist(), strict=True))
    names = lines[-1].parts
    return {
        'budget': {
            'coverage_probability': COVERAGE_PROBABILITY,
            'dof': {n: whole_dof(freedoms.get(n, np.inf)) for n in names},
            'not_stated': list(budget.not_stated),
            'u_rms': {n.name: {'unit': n.unit, 'u': n.u, 'sources': n.parts} for n in lines},
        },
        'correlations': {
            'at_least': STRONG,
            'strongest': [{'between': list(c.between), 'r': c.r} for c in strong[:LISTED_PAIRS]],
            'more': max(0, len(strong) - LISTED_PAIRS),
        },
    }


def format_budget(tables: ErrorTables, budget: Budget, lines: list[BudgetLine]) -> str:
    """Return the budget as text."""
    sources = [name for name in lines[-1].parts if any(n.parts[name] for n in lines)]
    head = ''.join(f'{SHORT.get(name, name):>9}' for name in sources)
    text = [f'budget, um and urad, rms of nodes{"U (95 %)":>10}{"u, k = 1":>10}{head}']
    for line in lines:
        parts = ''.join(f'{1e6 * line.parts[name]:>9.3f}' for name in sources)
        text.append(
            f'{line.name:<6}{"um" if line.unit == "m" else "urad":<6}k = {line.k:<6.2f}'
            f'dof {dof_words(line.dof):<7}'
            f'{1e6 * line.k * line.u:>10.3f}{1e6 * line.u:>10.3f}{parts}'
        )
    if budget.not_stated:
        text.append(f'Not declared in machine.yaml, typical values stand for them: '
                    f'{", ".join(budget.not_stated)}.')  # fmt: skip
    strong = correlations(tables, budget.covariance)
    if strong:
        named = [f'{a}, {b}: {c.r:.2f}' for c in strong[:3] for a, b in [c.between]]
        listed = '; '.join(named)
        text.append(f'Correlations of at least {STRONG}: {len(strong)} pairs, strongest {listed}.')
    return '\n'.join(text)
