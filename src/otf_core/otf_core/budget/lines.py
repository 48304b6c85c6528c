# SPDX-License-Identifier: Apache-2.0
"""The budget as numbers to state: lines by quantity and source, correlations."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import Budget
from otf_core.files.writing import tidy
from otf_core.model.motions import unit_of
from otf_core.model.tables import ErrorTables
from otf_core.prediction.calibration_document import Correlation
from otf_core.prediction.volumetric import table_places, volume_rows
from otf_core.threads import one_thread

GRID = 'grid'
INFINITE_DOF = 1e6
"""Degrees of freedom that are given as infinite."""
LISTED_CORRELATION = 0.5
"""Correlations at least as large are listed."""


@dataclass(frozen=True)
class BudgetLine:
    """One quantity of the budget.

    Attributes
    ----------
    name : str
        Squareness or location error, motion, or 'grid': length of the error vector on a regular
        grid over the driven volume, the best rigid motion removed.
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
