# SPDX-License-Identifier: Apache-2.0
"""Which effects and shapes to try in given runs, and which leave no trace in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.engine.decoys import DECOY_NAMES, DECOYS
from otf_core.diagnosis.engine.evidence import Option, axis_subsets
from otf_core.diagnosis.engine.rows import Rows
from otf_core.diagnosis.engine.search import Cause, search
from otf_core.diagnosis.engine.spectral import Line, strongest_lines
from otf_core.effects import REGISTRY, BelongsTo, Effect, Shape, Terms
from otf_core.solving.columns import column_size
from otf_core.solving.sample_states import sample_residuals

Array = NDArray[np.float64]

DETECTABLE = 25.0
"""Rise of the sum of squares at which an effect is found."""
INVISIBLE_SHARE = 0.1
"""Largest share of its amplitude that an effect leaves and still counts as not visible."""
PLAUSIBLE = 5e-6
"""m; an effect that would have to be larger to be found counts as not visible."""
NO_TRACE = 1e-9
"""m per unit; terms that move the target less across the path have no trace at all."""
LINE_SCORE = 8.0
"""Least score of a spectral line to be tried as a shape."""


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


def shapes_from_lines(lines: Sequence[Line]) -> dict[str, list[Shape]]:
    """Frequencies and periods of spectral lines as shapes of the effects that make them."""
    shapes: dict[str, list[Shape]] = {}
    for line in lines:
        if line.score > LINE_SCORE:
            shape = REGISTRY[line.effect].complete_shape({line.wave.parameter: line.place})
            shapes.setdefault(line.effect, []).append(shape)
    return shapes


def spectral_lines(rows: Rows) -> list[Line]:
    """Spectral lines of all runs, strongest first."""
    nodes = rows.done.unknowns.knots
    lines: list[Line] = []
    for run, solved in zip(rows.runs, rows.done.runs, strict=True):
        if len(run.pieces.samples):
            residuals = sample_residuals(run, solved.pose, rows.tables, nodes)
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


def search_catalogue(rows: Rows, exclude: Sequence[str]) -> Found:
    """Search rows for the effects of the catalogue, less the excluded ones, and for decoys."""
    shapes = shapes_from_lines(spectral_lines(rows))
    options, visible = collect_options(rows, [*effects_without(exclude), *DECOYS], shapes)
    causes, considered = search(rows, options)
    sight = {name: v for name, v in visible.items() if name not in DECOY_NAMES}
    return Found(tuple(causes), tuple(considered), sight)


def collect_options(
    rows: Rows, effects: Sequence[Effect], shapes: Mapping[str, Sequence[Shape]]
) -> tuple[dict[str, list[Option]], dict[str, Visibility]]:
    """Project all columns of all effects.

    Parameters
    ----------
    rows : Rows
    effects : sequence of Effect
    shapes : mapping of effect name to shapes
        Where not given, those of the effect itself.

    Returns
    -------
    options : mapping of effect name to list of Option
    visible : mapping of effect name to Visibility
    """
    options: dict[str, list[Option]] = {}
    visible: dict[str, Visibility] = {}
    for effect in effects:
        chosen, stand_in = shapes_of(rows, effect, shapes)
        tried = try_shapes(rows, effect, chosen or stand_in)
        options[effect.name] = [o for t in tried for o in t.options()] if chosen else []
        visible[effect.name] = best_sight([t.visibility() for t in tried])
    return options, visible


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


@dataclass(frozen=True)
class Tried:
    """Columns of one shape of an effect: ``plain``, whitened, and with the tables taken off."""

    effect: Effect
    shape: Shape
    terms: Terms
    plain: Array
    whole: Array
    white: Array

    @cached_property
    def size(self) -> Array:
        """Root mean square of the columns where they act, shape (k,), m."""
        return column_size(self.plain)

    @property
    def acts(self) -> NDArray[np.bool_]:
        """Terms that move the target across the path, shape (k,)."""
        return self.size > NO_TRACE

    def options(self) -> list[Option]:
        """Options for all terms that act, and for those of each axis."""
        size = self.size
        found = []
        for subset in axis_subsets(self.terms):
            take = subset[self.acts[subset]]
            if take.size:
                own = self.white[:, take]
                found.append(
                    Option(
                        self.effect, self.shape, self.terms, take, own, size[take], own,
                        self.plain[:, take],
                    )
                )  # fmt: skip
        return found

    def visibility(self) -> Visibility:
        """How well the data see this shape."""
        size = self.size
        acts = self.acts
        if not acts.any():
            return Visibility(0.0, np.inf)
        whole = np.einsum('ij,ij->j', self.whole, self.whole)[acts]
        left = np.einsum('ij,ij->j', self.white, self.white)[acts]
        ratio = np.sqrt(left / np.maximum(whole, 1e-300))
        found = np.sqrt(DETECTABLE / np.maximum(left, 1e-300)) * size[acts]
        return Visibility(float(np.median(ratio)), float(np.median(found)))


def try_shapes(rows: Rows, effect: Effect, shapes: Sequence[Shape]) -> list[Tried]:
    """Columns of all shapes, whitened and projected at once."""
    terms = [rows.terms(effect, shape) for shape in shapes]
    kept = [(s, t) for s, t in zip(shapes, terms, strict=True) if t.names]
    if not kept:
        return []
    plain = np.concatenate([rows.plain_columns(effect, s) for s, _ in kept], axis=1)
    whole = rows.whiten(plain)
    white = rows.project(whole)
    found, start = [], 0
    for shape, term in kept:
        part = slice(start, start + len(term.names))
        start = part.stop
        found.append(Tried(effect, shape, term, plain[:, part], whole[:, part], white[:, part]))
    return found
