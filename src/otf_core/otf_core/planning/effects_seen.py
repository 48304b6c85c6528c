# SPDX-License-Identifier: Apache-2.0
"""Before measuring: which effects a plan would show, from which size on, and which not apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.engine.catalogue import Visibility, effects_without, tried_effects
from otf_core.diagnosis.engine.rows import Rows, rows_of
from otf_core.diagnosis.engine.tried import Tried
from otf_core.effects import REGISTRY
from otf_core.model.plan import Plan
from otf_core.planning.forecast import Forecast, Setup
from otf_core.planning.planned_budget import planned_solution

Array = NDArray[np.float64]

SAME = 0.97
"""Share of the squared trace that another effect can leave as well: not told apart."""


def forecast_rows(plan: Plan, setup: Setup, found: Forecast) -> Rows:
    """Rows of the pieces that a recording of the plan would give, with zero deviations."""
    observed, done, _ = planned_solution(plan, setup, found)
    return rows_of([observed], done, setup.calibration.unidentifiable_above)


def _whole(tried: Sequence[Tried]) -> list[Tried]:
    """Shapes with all terms."""
    most = max((t.takes[0].size for t in tried if t.takes), default=0)
    return [t for t in tried if t.takes and t.takes[0].size == most]


def _columns(tried: Tried) -> Array:
    """What an effect adds beyond the tables, m of displacement per unit, shape (r, k)."""
    option = tried.source.option(tried.takes[0])
    return np.asarray(option.own / option.size)


def _basis(columns: Array) -> Array:
    """Orthonormal basis of columns."""
    values, vectors = np.linalg.eigh(columns.T @ columns)
    seen = values > 1e-9 * values[-1]
    return np.asarray(columns @ (vectors[:, seen] / np.sqrt(values[seen])))


def not_told_apart(
    tried: Mapping[str, Sequence[Tried]], visible: Mapping[str, Visibility]
) -> dict[str, tuple[str, ...]]:
    """Effects that could be taken for each effect: they can leave every trace of it."""
    seen = [n for n, v in visible.items() if v.visible and _whole(tried[n])]
    own = {n: _columns(_whole(tried[n])[0]) for n in seen}
    found: dict[str, list[str]] = {n: [] for n in seen}
    for other in seen:
        basis = _basis(_columns(_whole(tried[other])[-1]))
        for name in seen:
            shared = np.sum((basis.T @ own[name]) ** 2)
            if name != other and shared > SAME * np.sum(own[name] ** 2):
                found[name].append(other)
    return {name: tuple(others) for name, others in found.items()}


def forecast_effects(plan: Plan, setup: Setup, found: Forecast) -> list[dict[str, Any]]:
    """Judge every effect of the catalogue for a plan.

    Parameters
    ----------
    plan : Plan
    setup : Setup
    found : Forecast

    Returns
    -------
    list of mapping
        effect, visible, smallest_um (root mean square displacement that would be found),
        not_told_from, needs, words.
    """
    rows = forecast_rows(plan, setup, found)
    tried, visible = tried_effects(rows, effects_without(()), {})
    apart = not_told_apart(tried, visible)
    entries = []
    for name, sight in visible.items():
        others = apart.get(name, ())
        size = f'{1e6 * sight.smallest:.2f} um'
        words = (
            f'{name:28} found from {size} on'
            if sight.visible
            else (f'{name:28} not visible; needs {REGISTRY[name].needs}')
        )
        if others:
            words += f', not told from {", ".join(others)}'
        entries.append(
            {
                'effect': name,
                'visible': sight.visible,
                'smallest_um': 1e6 * sight.smallest if np.isfinite(sight.smallest) else None,
                'not_told_from': list(others),
                'needs': REGISTRY[name].needs,
                'words': words,
            }
        )
    return entries
