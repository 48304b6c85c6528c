# SPDX-License-Identifier: Apache-2.0
"""Which effects and shapes to try in given runs, and which leave no trace in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.aside import shared_out
from otf_core.diagnosis.engine.decoys import DECOYS
from otf_core.diagnosis.engine.effect_products import NO_TRACE, Tried, tried_shapes
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import Cause, search
from otf_core.diagnosis.engine.spectral import LINE_SCORE, SpectralLine, strongest_lines
from otf_core.diagnosis.engine.time_courses import courses_tried
from otf_core.effects import REGISTRY, BelongsTo, Effect, Shape
from otf_core.effects.free_form import free_forms

DETECTABLE = 25.0
"""Rise of the sum of squares at which an effect is found."""
INVISIBLE_SHARE = 0.1
"""Largest share of its amplitude that an effect leaves and still counts as not visible."""
PLAUSIBLE = 5e-6
"""m; an effect that would have to be larger to be found counts as not visible."""


@dataclass(frozen=True)
class Visibility:
    """How well the data see an effect.

    Attributes
    ----------
    share : float
        Amplitude left by tables and poses, median over the terms.
    smallest : float
        m; smallest root mean square displacement that would be found, median over the terms.
    """

    share: float
    smallest: float

    @property
    def visible(self) -> bool:
        """False if the effect leaves no trace that could be told."""
        return self.share > INVISIBLE_SHARE and self.smallest < PLAUSIBLE


def sight_of(tried: Tried) -> Visibility:
    """How well the data see one shape of an effect."""
    acts = tried.size > NO_TRACE
    if not acts.any():
        return Visibility(0.0, np.inf)
    whole, left = tried.whole[acts], tried.normal.diagonal()[acts]
    ratio = np.sqrt(left / np.maximum(whole, 1e-300))
    found = np.sqrt(DETECTABLE / np.maximum(left, 1e-300)) * tried.size[acts]
    return Visibility(float(np.median(ratio)), float(np.median(found)))


def shapes_from_lines(lines: Sequence[SpectralLine]) -> dict[str, list[Shape]]:
    """Frequencies and periods of spectral lines as shapes of the effects that make them."""
    shapes: dict[str, list[Shape]] = {}
    for line in lines:
        if line.score > LINE_SCORE:
            shape = REGISTRY[line.effect].complete_shape({line.wave.parameter: line.place})
            shapes.setdefault(line.effect, []).append(shape)
    return shapes


def spectral_lines(rows: Rows) -> list[SpectralLine]:
    """Spectral lines of all runs, strongest first."""
    lines: list[SpectralLine] = []
    for residuals in rows.sample_residuals():
        lines += strongest_lines(residuals, list(REGISTRY.values()))
    return sorted(lines, key=lambda line: -line.score)


def effects_without(names: Sequence[str]) -> list[Effect]:
    """Effects of the catalogue that displace, less the named ones."""
    left = [e for e in REGISTRY.values() if e.name not in names]
    return [e for e in left if e.belongs_to is not BelongsTo.NOISE]


@dataclass(frozen=True)
class Found:
    """What a search of the catalogue found.

    Attributes
    ----------
    causes : tuple of Cause
        In the order found, decoys among them.
    considered : tuple of (effect, log odds)
        The ranking of the last round.
    visible : mapping of effect to Visibility
    """

    causes: tuple[Cause, ...]
    considered: tuple[tuple[str, float], ...]
    visible: dict[str, Visibility]


def search_catalogue(
    rows: Rows,
    exclude: Sequence[str],
    own: Sequence[Effect] = (),
    lines: Sequence[SpectralLine] | None = None,
) -> Found:
    """Search rows for effects of the catalogue less the excluded ones, for ``own``, and decoys.

    ``lines`` are spectral lines of the runs; those of the rows where they are not given.
    """
    shapes = shapes_from_lines(spectral_lines(rows) if lines is None else lines)
    tried, visible = tried_effects(rows, [*effects_without(exclude), *own, *DECOYS], shapes)
    switching = courses_tried(rows, [*effects_without(exclude), *DECOYS])
    causes, considered = search(rows, {**tried, **switching})
    sight = {name: v for name, v in visible.items() if name in REGISTRY}
    return Found(tuple(causes), tuple(considered), sight)


def tried_effects(
    rows: Rows, effects: Sequence[Effect], shapes: Mapping[str, Sequence[Shape]]
) -> tuple[dict[str, list[Tried]], dict[str, Visibility]]:
    """Reduce the columns of all effects to their products, effect by effect.

    Parameters
    ----------
    shapes : mapping of effect name to shapes
        Where not given, those of the effect itself.

    Returns
    -------
    tried : mapping of effect name to list of Tried
    visible : mapping of effect name to Visibility
    """

    def one(effect: Effect) -> tuple[list[Tried], Visibility]:
        chosen, stand_in = shapes_of(rows, effect, shapes)
        found = tried_shapes(rows, effect, chosen or stand_in)
        tried = found if chosen else []
        for form in free_forms(effect, rows.states):
            own = (chosen or ()) if form.form.shaped else ({},)
            tried += tried_shapes(rows, form, own)
        return tried, best_sight([sight_of(t) for t in found])

    rows.prepare()
    made = shared_out(one, effects, (rows, *effects))
    found = dict(zip((e.name for e in effects), made, strict=True))
    return {n: tried for n, (tried, _) in found.items()}, {n: s for n, (_, s) in found.items()}


def best_sight(seen: Sequence[Visibility]) -> Visibility:
    """How well the data see an effect in the shape that they see best."""
    return Visibility(
        max((v.share for v in seen), default=0.0),
        min((v.smallest for v in seen), default=np.inf),
    )


def shapes_of(
    rows: Rows, effect: Effect, found: Mapping[str, Sequence[Shape]]
) -> tuple[Sequence[Shape], Sequence[Shape]]:
    """Shapes to try, and what stands for them where there are none."""
    wave = effect.wave
    if wave is None:
        return found.get(effect.name, effect.shapes(rows.states[0])), ()
    return found.get(effect.name, ()), (effect.complete_shape({wave.parameter: wave.probe}),)
