# SPDX-License-Identifier: Apache-2.0
"""Before measuring: which effects a plan would show, from which size on, and which not apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.engine.catalogue import Visibility, collect_options, effects_without
from otf_core.diagnosis.engine.evidence import Option
from otf_core.diagnosis.engine.rows import Rows, rows_of
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


def _whole(options: Sequence[Option]) -> list[Option]:
    """Options with all terms, one per shape."""
    most = max((o.take.size for o in options), default=0)
    return [o for o in options if o.take.size == most]


def _imitates(own: Option, other: Option) -> bool:
    """Tell whether another effect can leave every trace of this one."""
    mine, theirs = own.own / own.size, other.own / other.size
    values, vectors = np.linalg.eigh(theirs.T @ theirs)
    seen = values > 1e-9 * values[-1]
    shared = (mine.T @ theirs) @ vectors[:, seen] / np.sqrt(values[seen])
    return float(np.sum(shared**2)) > SAME * float(np.sum(mine**2))


def not_told_apart(
    options: Mapping[str, Sequence[Option]], visible: Mapping[str, Visibility]
) -> dict[str, tuple[str, ...]]:
    """Effects that could be taken for each effect."""
    seen = [n for n, v in visible.items() if v.visible and options[n]]
    found = {}
    for name in seen:
        others = []
        for other in seen:
            if other == name:
                continue
            pairs = [
                (a, b) for a in _whole(options[name])[:1] for b in _whole(options[other])[-1:]
            ]
            if any(_imitates(a, b) for a, b in pairs):
                others.append(other)
        found[name] = tuple(others)
    return found


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
    options, visible = collect_options(rows, effects_without(()), {})
    apart = not_told_apart(options, visible)
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
