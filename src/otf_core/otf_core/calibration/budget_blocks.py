# SPDX-License-Identifier: Apache-2.0
"""Budget and correlations of a calibration as blocks of error_tables.json."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import Budget
from otf_core.files.writing import tidy
from otf_core.model.expanded import COVERAGE_PROBABILITY
from otf_core.model.motions import unit_of
from otf_core.model.tables import ErrorTables, LocationError, Squareness
from otf_core.prediction.volumetric import table_places, volume_rows
from otf_core.threads import one_thread

GRID = 'grid'
LISTED_CORRELATION = 0.5
"""Correlations at least as large are listed."""
LISTED_PAIRS = 20
INFINITE_DOF = 1e6
"""Degrees of freedom that are given as infinite."""


@dataclass(frozen=True)
class BudgetLine:
    """One quantity of the budget.

    Attributes
    ----------
    name : str
        Squareness error, motion, or 'grid': length of the error vector on a regular grid over
        the driven volume, the best rigid motion removed.
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


def whole_dof(dof: float) -> int | None:
    """Effective degrees of freedom, cut to the next lower integer (GUM G.4.1); None: infinite."""
    return int(dof) if dof < INFINITE_DOF else None


def _line(
    budget: Budget, name: str, unit: str, variances: Array, components: int = 1
) -> BudgetLine:
    known = variances[:, variances.sum(axis=0) > 0]
    mean = np.sqrt(components * known.mean(axis=1)) if known.size else np.zeros(len(variances))
    parts = {n: float(v) for n, v in zip(budget.names, mean, strict=True)}
    return BudgetLine(name, unit, float(np.sqrt(np.sum(mean**2))), parts, *budget.expansion(known))


def budget_lines(
    tables: ErrorTables, budget: Budget, hidden: Collection[str] = ()
) -> list[BudgetLine]:
    """Lines for everything that is identifiable, and for the grid.

    Parameters
    ----------
    budget : Budget
        Of the same nodes.
    hidden : collection of str
        What is left out beside those without any uncertainty.
    """
    variances, lines = budget.variances(), []
    for name, part in table_places(tables).items():
        if variances[:, part].any() and name not in hidden:
            lines.append(_line(budget, name, unit_of(name), variances[:, part]))
    with one_thread():
        free = volume_rows(tables)
        return [*lines, _line(budget, GRID, 'm', budget.variances(free), components=3)]


def expanded_uncertainties(
    tables: ErrorTables, lines: list[BudgetLine]
) -> dict[str, dict[str, Any]]:
    """U, k and dof of every scalar and motion, as they stand in error_tables.json."""
    values: dict[str, dict[str, Any]] = {}
    by_name = {line.name: line for line in lines}
    scalars: dict[str, Squareness | LocationError] = {**tables.squareness, **tables.location}
    for name in table_places(tables):
        line = by_name.get(name)
        k = line.k if line else 0.0
        if name in scalars:
            wide: Any = k * scalars[name].u
        else:
            wide = (k * tables.motions[name].u).tolist()
        values[name] = {
            'U': wide,
            'k': k if line else None,
            'dof': whole_dof(line.dof) if line else None,
        }
    return values


@dataclass(frozen=True)
class Correlation:
    """Strongest correlation between two tables: where, and the coefficient."""

    between: tuple[str, str]
    r: float


def correlations(tables: ErrorTables, covariance: Array) -> list[Correlation]:
    """Correlations of at least ``LISTED_CORRELATION`` between squareness errors and motions.

    Of two motions the pair of nodes with the strongest correlation counts.

    Returns
    -------
    list of Correlation
        Strongest first.
    """
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(u > 1e-6 * u.max(initial=0.0), u, np.inf)
    r = covariance / np.outer(unit, unit)
    places, pairs = table_places(tables), []
    for one, other in combinations(places, 2):
        part = r[places[one], places[other]]
        at = np.unravel_index(int(np.argmax(np.abs(part))), part.shape)
        if abs(part[at]) >= LISTED_CORRELATION:
            names = [_at_node(tables, n, int(i)) for n, i in zip((one, other), at, strict=True)]
            pairs.append(Correlation((names[0], names[1]), float(part[at])))
    return sorted(pairs, key=lambda c: -abs(c.r))


def _at_node(tables: ErrorTables, name: str, node: int) -> str:
    if name in tables.machine.scalars:
        return name
    factor, unit = tables.machine.axes[name[2]].shown
    return f'{name} at {tidy(factor * float(tables.motions[name].position[node])):.6g} {unit}'


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
            'u_rms': {
                n.name: {
                    'unit': n.unit,
                    'u': n.u,
                    'k': n.k,
                    'dof': whole_dof(n.dof),
                    'sources': n.parts,
                }
                for n in lines
            },
        },
        'correlations': {
            'at_least': LISTED_CORRELATION,
            'strongest': [{'between': list(c.between), 'r': c.r} for c in strong[:LISTED_PAIRS]],
            'more': max(0, len(strong) - LISTED_PAIRS),
        },
    }
