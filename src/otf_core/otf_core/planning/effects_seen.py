# SPDX-License-Identifier: Apache-2.0
"""Before measuring: which effects a plan would show, from which size on, and which not apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.aside import shared_out
from otf_core.diagnosis.engine.catalogue import (
    Visibility,
    best_sight,
    effects_without,
    shapes_of,
    sight_of,
)
from otf_core.diagnosis.engine.effect_products import Tried, tried_shapes
from otf_core.diagnosis.engine.residual_rows import Rows, rows_of
from otf_core.effects import REGISTRY, Effect
from otf_core.planning.planned_budget import Planned

SAME = 0.97
"""Share of the squared trace that another effect can leave as well: not told apart."""


def forecast_rows(planned: Planned, limit: float) -> Rows:
    """Rows of the pieces that a recording of a plan would give, with zero deviations."""
    observed, done, _ = planned
    return rows_of([observed], done, limit)


@dataclass(frozen=True)
class Trace:
    """What an effect leaves in the rows beyond tables and poses.

    An effect is told from another if it acts in its simplest form, the first of its shapes, and
    the other takes up what it can in its richest, the last.

    Attributes
    ----------
    simple : ndarray, shape (r, k)
        Columns of the first shape with all terms, each of unit size where it acts.
    rich : ndarray, shape (r, m)
        Orthonormal columns that span those of the last shape.
    """

    simple: Array
    rich: Array

    @classmethod
    def of(cls, first: Tried, last: Tried) -> Trace:
        """For the first and the last shape of an effect."""
        simple = _columns(first)
        rich = simple if last is first else _columns(last)
        values, vectors = np.linalg.eigh(rich.T @ rich)
        seen = values > 1e-9 * values[-1]
        return cls(simple, rich @ (vectors[:, seen] / np.sqrt(values[seen])))

    def imitated_by(self, other: Trace) -> bool:
        """Tell whether another effect can leave every trace of this one."""
        shared = other.rich.T @ self.simple
        return float(np.sum(shared**2)) > SAME * self.square

    @cached_property
    def square(self) -> float:
        """Sum of the squared columns of the first shape."""
        return float(np.vdot(self.simple, self.simple))


def not_told_apart(traces: Mapping[str, Trace]) -> dict[str, tuple[str, ...]]:
    """Effects that could be taken for each effect."""

    def others(name: str) -> tuple[str, ...]:
        own = traces[name]
        return tuple(n for n, other in traces.items() if n != name and own.imitated_by(other))

    return dict(zip(traces, shared_out(others, list(traces)), strict=True))


def _columns(tried: Tried) -> Array:
    """What an effect with all terms adds beyond the tables, each of unit size where it acts."""
    option = tried.source.option(tried.takes[0])
    return np.asarray(option.own / option.size)


def _seen(rows: Rows, effect: Effect) -> tuple[Visibility, Trace | None]:
    """How well an effect is seen, and its trace."""
    chosen, stand_in = shapes_of(rows, effect, {})
    tried = tried_shapes(rows, effect, chosen or stand_in)
    sight = best_sight([sight_of(t) for t in tried])
    most = max((t.takes[0].size for t in tried if t.takes), default=0)
    whole = [t for t in tried if t.takes and t.takes[0].size == most]
    if not chosen or not whole:
        return sight, None
    return sight, Trace.of(whole[0], whole[-1])


def forecast_effects(rows: Rows) -> list[dict[str, Any]]:
    """Judge every effect of the catalogue for a plan.

    Parameters
    ----------
    rows : Rows
        See ``forecast_rows``.

    Returns
    -------
    list of mapping
        effect, visible, smallest_um (root mean square displacement that would be found),
        not_told_from, needs, words.
    """
    visible, traces = {}, {}
    rows.factor, rows.residual  # noqa: B018  made once, before threads need them
    effects = effects_without(())
    longest = sorted(effects, key=lambda e: not e.many_alike)  # begun first, and not sent
    judged = dict(
        zip(longest, shared_out(partial(_seen, rows), longest, (rows, *longest)), strict=True)
    )
    for effect in effects:
        sight, trace = judged[effect]
        visible[effect.name] = sight
        if sight.visible and trace is not None:
            traces[effect.name] = trace
    apart = not_told_apart(traces)
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
