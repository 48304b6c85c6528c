# SPDX-License-Identifier: Apache-2.0
"""Shape of a gap that no known effect explains, in words.

Shapes are fitted to the residual, freed of the correlation of the noise; the one that explains
most, less the price of its coefficients and of having looked at many, is taken, then the next on
what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.place.shape_families import all_shapes
from otf_core.diagnosis.place.shapes import GapShape
from otf_core.diagnosis.place.views import RunView
from otf_core.solving.normal import rows_by_run
from otf_core.solving.residuals import check_residuals

Projection = Callable[[Array], Array]
_Family = tuple[list['_Candidate'], int]
"""Candidates, and how many shapes were looked at."""

MAX_STRUCTURES, NEEDED_SCORE = 3, 9.0
"""Shapes named; logarithm of the odds that each needs."""
NEEDED_SHARE = 0.1
"""Share of the excess that a shape must explain to be worth a word."""
SEVERAL = ('sense', 'product')
"""Families that may be found more than once."""
REFINEMENTS = 3
KEPT = 8
"""Of many shapes of a family so many are fitted exactly."""
TOGETHER = 8
"""Shapes whose columns are made at once; bounds the memory."""
EXACT = 24
"""Families of more shapes are screened."""


@dataclass(frozen=True)
class GapStructure:
    """One shape found in the residual.

    Attributes
    ----------
    share : float
        Of the squared residual beyond noise that it explains, 0 to 1.
    score : float
        Logarithm of the odds against noise.
    """

    family: str
    words: str
    share: float
    score: float


@dataclass(frozen=True, eq=False)
class _Candidate:
    shape: GapShape
    white: Array


def _candidates(
    views: Sequence[RunView], shapes: Sequence[GapShape], project: Projection
) -> list[_Candidate]:
    """Shapes of equal numbers of scales with their whitened columns, less what tables follow."""
    found = (
        _candidates_of(views, shapes[k : k + TOGETHER], project)
        for k in range(0, len(shapes), TOGETHER)
    )
    return [candidate for some in found for candidate in some]


def _candidates_of(
    views: Sequence[RunView], shapes: Sequence[GapShape], project: Projection
) -> list[_Candidate]:
    """Some of these, at once."""
    wide = []
    for view in views:
        scales = np.concatenate([s.scales(view) for s in shapes], axis=1)
        columns = scales[None, :, :, None] * view.axes[:, :, None, :]
        wide.append(view.whiten(columns.reshape(*view.axes.shape[:2], -1)))
    joined = project(np.concatenate(wide))
    parts = np.split(joined, len(shapes), axis=1)
    return [_Candidate(s, w) for s, w in zip(shapes, parts, strict=True)]


def _screened(
    views: Sequence[RunView], shapes: Sequence[GapShape], residual: Array, project: Projection
) -> list[_Candidate]:
    """Most promising of many shapes: exact products with the residual, sizes interpolated."""
    if len(shapes) <= EXACT:
        return _candidates(views, shapes, project)
    pull = [v.vectors(v.whitener.whiten_transposed(part)) for v, part in _parts(views, residual)]
    sample = np.unique(np.linspace(0, len(shapes) - 1, EXACT // 2).round().astype(int))
    exact = _candidates(views, [shapes[k] for k in sample], project)
    known = np.array([(c.white.T @ c.white).diagonal() for c in exact]).T
    numbers, gains = np.arange(len(shapes)), []
    diagonals = np.stack([np.interp(numbers, sample, own) for own in known], axis=1)
    for shape, diagonal in zip(shapes, diagonals, strict=True):
        products = sum(shape.scales(v).T @ p for v, p in zip(views, pull, strict=True))
        right = np.asarray(products).ravel()
        gains.append(float((right**2 / np.maximum(diagonal, 1e-300)).sum()))
    best = np.argsort(gains)[::-1][:KEPT]
    return _candidates(views, [shapes[k] for k in np.sort(best)], project)


def _fit(white: Array, residual: Array) -> tuple[Array, float]:
    """Coefficients and fall of the sum of squares; blind directions stay at rest."""
    normal = white.T @ white
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    value, vectors = np.linalg.eigh(normal / np.outer(size, size))
    use = value > 1e-6
    scaled = vectors[:, use] / value[use] @ (vectors[:, use].T @ ((white.T @ residual) / size))
    coefficients = scaled / size
    return coefficients, float(residual @ (white @ coefficients))


def _parts(views: Sequence[RunView], white: Array) -> Iterator[tuple[RunView, Array]]:
    """Whitened values (r,) run by run, shape (c, p)."""
    return zip(views, rows_by_run(white, [v.expected.shape for v in views]), strict=True)


def _inflation(views: Sequence[RunView], residual: Array) -> float:
    """Variance of what counts as noise in a whitened residual, correlation included."""
    parts = _parts(views, residual)
    return float(np.mean([check_residuals(p, v.leg, 0).inflation for v, p in parts]))


def _squares(views: Sequence[RunView], white: Array) -> float:
    """Sum of squares of whitened values turned back, m^2."""
    return sum(float((v.whitener.unwhiten(p) ** 2).sum()) for v, p in _parts(views, white))


def _best(
    families: Sequence[_Family],
    views: Sequence[RunView],
    residual: Array,
    project: Projection,
) -> tuple[_Candidate, Array, float]:
    """Best shape: candidate, coefficients, logarithm of the odds."""
    legs = sum(len(v.bounds) for v in views)
    ranked = []
    for family, looked in families:
        fits = [_fit(c.white, residual) for c in family]
        best = int(np.argmax([gain for _, gain in fits]))
        price = 0.5 * family[best].white.shape[1] * np.log(legs) + np.log(looked)
        ranked.append((family[best], *fits[best], float(price)))
    candidate, _, _, price = max(ranked, key=lambda r: 0.5 * r[2] - r[3])
    candidate = _refined(candidate, views, residual, project)
    value, gain = _fit(candidate.white, residual)
    variance = _inflation(views, residual - candidate.white @ value)
    return candidate, value, 0.5 * gain / variance - price


def _refined(
    candidate: _Candidate, views: Sequence[RunView], residual: Array, project: Projection
) -> _Candidate:
    """Best shape near a shape with a moment, a period or a time constant."""
    for _ in range(REFINEMENTS):
        if candidate.shape.finer is None:
            break
        near = _candidates(views, candidate.shape.finer(), project)
        candidate = max(near, key=lambda c: _fit(c.white, residual)[1])
    return candidate


def _removal(taken: Array) -> Projection:
    """Projection that takes out what a shape that was found can follow."""
    basis, size, _ = np.linalg.svd(taken, full_matrices=False)
    basis = basis[:, size > 1e-3 * size.max(initial=1e-300)]
    return lambda wide: np.asarray(wide - basis @ (basis.T @ wide))


def _chained(first: Projection, then: Projection) -> Projection:
    return lambda wide: then(first(wide))


def _without_means(views: Sequence[RunView]) -> Projection:
    """Projection that takes out a constant displacement of every run."""
    columns = [np.zeros((v.expected.size, 3)) for v in views]
    blocks = []
    for k, view in enumerate(views):
        own = view.whiten(view.axes)
        blocks.append(np.concatenate([*columns[:k], own, *columns[k + 1 :]]))
    basis = np.linalg.qr(np.concatenate(blocks, axis=1))[0]
    return lambda wide: np.asarray(wide - basis @ (basis.T @ wide))


def _joint_words(
    views: Sequence[RunView], shapes: Sequence[GapShape], residual: Array, project: Projection
) -> list[str]:
    """Words with the sizes that shapes have when all are fitted together."""
    if not shapes:
        return []
    white = [_candidates(views, [shape], project)[0].white for shape in shapes]
    value, _ = _fit(np.concatenate(white, axis=1), residual)
    ends = np.cumsum([w.shape[1] for w in white])
    parts = np.split(value, ends[:-1])
    return [shape.words(part) for shape, part in zip(shapes, parts, strict=True)]


def find_structures(
    views: Sequence[RunView],
    residuals: Sequence[Array] | None = None,
    project: Projection | None = None,
) -> list[GapStructure]:
    """Find plain shapes in the residual, the one that explains most first.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (c, p), m, optional
        ``residual_before`` where not given.
    project : callable(columns (r, k)) -> columns, optional
        Takes out of whitened columns what tables and poses can follow, ``Rows.project``; without
        it only a constant displacement of every run is taken out, and sizes are those that
        tables and poses leave.
    """
    project = project or _without_means(views)
    given = residuals if residuals is not None else [v.residual_before for v in views]
    residual = project(
        np.concatenate([v.whiten(r[:, :, None]) for v, r in zip(views, given, strict=True)])
    )[:, 0]
    noise = sum(float((v.expected**2).sum()) for v in views)
    first = _squares(views, residual)
    families = [
        (_screened(views, family, residual, project), len(family))
        for family in all_shapes(views)
        if family
    ]
    found: list[GapStructure] = []
    chosen: list[GapShape] = []
    plain, whole = project, residual
    while families and len(found) < MAX_STRUCTURES:
        candidate, value, score = _best(families, views, residual, project)
        before = _squares(views, residual)
        residual = residual - candidate.white @ value
        gain = before - _squares(views, residual)
        share = gain / max(first - noise, 0.1 * noise)
        if score < NEEDED_SCORE or share < NEEDED_SHARE:
            break
        chosen.append(candidate.shape)
        found.append(GapStructure(candidate.shape.family, '', min(share, 1.0), score))
        # axes may each have their own sense of travel; a second step or wave is a refinement
        family, removal = candidate.shape.family, _removal(candidate.white)
        families = [
            ([_Candidate(c.shape, removal(c.white)) for c in part], looked)
            for part, looked in families
            if family in SEVERAL or part[0].shape.family != family
        ]
        project = _chained(project, removal)
    words = _joint_words(views, chosen, whole, plain)
    found = [replace(s, words=w) for s, w in zip(found, words, strict=True)]
    return sorted(found, key=lambda s: -s.share)
