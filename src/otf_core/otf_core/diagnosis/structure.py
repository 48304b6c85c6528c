# SPDX-License-Identifier: Apache-2.0
"""Shape of a gap that no known effect explains, in words.

Shapes are fitted to the residual, freed of the correlation of the noise; the one that explains
most, less the price of its coefficients and of having looked at many, is taken, then the next on
what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.shapes import Shape, all_shapes
from otf_core.diagnosis.views import RunView
from otf_core.uncertainty import check_residuals

Array = NDArray[np.float64]
Projection = Callable[[Array], Array]

MAX_STRUCTURES = 3
NEEDED_SCORE = 9.0
"""Logarithm of the odds that a shape needs."""
NEEDED_SHARE = 0.1
"""Share of the excess that a shape must explain to be worth a word."""
SEVERAL = ('sense', 'product')
"""Families that may be found more than once."""
KEPT = 8
"""Shapes of a family that are tried again on what the first ones leave."""


@dataclass(frozen=True)
class Structure:
    """One shape found in the residual.

    Attributes
    ----------
    family : str
    words : str
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
    shape: Shape
    white: Array


def _white(views: Sequence[RunView], shapes: Sequence[Shape], project: Projection) -> list[Array]:
    """Whitened columns of shapes less what tables and poses can follow."""
    wide = []
    for view in views:
        columns = np.concatenate([s.columns(view) for s in shapes], axis=2)
        wide.append(view.whiten(np.einsum('cpi,pik->cpk', view.axes, columns)))
    joined = project(np.concatenate(wide))
    width = joined.shape[1] // len(shapes)
    return [joined[:, k * width : (k + 1) * width] for k in range(len(shapes))]


def _families(views: Sequence[RunView], project: Projection) -> list[list[_Candidate]]:
    """All shapes with their columns; shapes of one family have the same number of them."""
    found = []
    for family in all_shapes(views):
        if family:
            columns = _white(views, family, project)
            found.append([_Candidate(s, w) for s, w in zip(family, columns, strict=True)])
    return found


def _fit(white: Array, residual: Array) -> tuple[Array, float]:
    """Coefficients and fall of the sum of squares; blind directions stay at rest."""
    normal = white.T @ white
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    value, vectors = np.linalg.eigh(normal / np.outer(size, size))
    use = value > 1e-6
    scaled = vectors[:, use] / value[use] @ (vectors[:, use].T @ ((white.T @ residual) / size))
    coefficients = scaled / size
    return coefficients, float(residual @ (white @ coefficients))


def _inflation(views: Sequence[RunView], residual: Array) -> float:
    """Variance of what counts as noise in a whitened residual, correlation included."""
    start, found = 0, []
    for view in views:
        shape = view.expected.shape
        part = residual[start : start + shape[0] * shape[1]].reshape(shape)
        found.append(check_residuals(part, view.leg, 0).inflation)
        start += shape[0] * shape[1]
    return float(np.mean(found))


def _best(
    families: Sequence[Sequence[_Candidate]], views: Sequence[RunView], residual: Array
) -> tuple[_Candidate, Array, float, float]:
    """Best shape: candidate, coefficients, gain, logarithm of the odds."""
    legs = sum(len(v.bounds) for v in views)
    ranked = []
    for family in families:
        fits = [_fit(c.white, residual) for c in family]
        best = int(np.argmax([gain for _, gain in fits]))
        price = 0.5 * family[best].white.shape[1] * np.log(legs) + np.log(len(family))
        ranked.append((family[best], *fits[best], float(price)))
    candidate, value, gain, price = max(ranked, key=lambda r: 0.5 * r[2] - r[3])
    variance = _inflation(views, residual - candidate.white @ value)
    return candidate, value, gain, 0.5 * gain / variance - price


def _shortened(family: Sequence[_Candidate], residual: Array) -> list[_Candidate]:
    gains = [-_fit(c.white, residual)[1] for c in family]
    return [family[k] for k in np.argsort(gains)[:KEPT]]


def _take_out(taken: Array, families: Sequence[Sequence[_Candidate]]) -> list[list[_Candidate]]:
    """Candidates less what a shape that was taken can follow of them."""
    basis, size, _ = np.linalg.svd(taken, full_matrices=False)
    basis = basis[:, size > 1e-3 * size.max(initial=1e-300)]
    return [
        [_Candidate(c.shape, c.white - basis @ (basis.T @ c.white)) for c in family]
        for family in families
    ]


def _without_means(views: Sequence[RunView]) -> Projection:
    """Projection that takes out a constant displacement of every run."""
    columns = [np.zeros((v.expected.size, 3)) for v in views]
    blocks = []
    for k, view in enumerate(views):
        own = view.whiten(view.axes)
        blocks.append(np.concatenate([*columns[:k], own, *columns[k + 1 :]]))
    basis = np.linalg.qr(np.concatenate(blocks, axis=1))[0]
    return lambda wide: np.asarray(wide - basis @ (basis.T @ wide))


def find_structures(
    views: Sequence[RunView],
    residuals: Sequence[Array] | None = None,
    project: Projection | None = None,
) -> list[Structure]:
    """Find plain shapes in the residual, the one that explains most first.

    Parameters
    ----------
    views : sequence of RunView
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
    excess = max(float(residual @ residual) - residual.size, 1e-9)
    families = _families(views, project)
    families = [_shortened(f, residual) if f[0].shape.family != 'step' else f for f in families]
    found: list[Structure] = []
    while families and len(found) < MAX_STRUCTURES:
        candidate, value, gain, score = _best(families, views, residual)
        share = gain / excess
        if score < NEEDED_SCORE or share < NEEDED_SHARE:
            break
        words = candidate.shape.words(value)
        found.append(Structure(candidate.shape.family, words, min(share, 1.0), score))
        residual = residual - candidate.white @ value
        # axes may each have their own sense of travel; a second step or wave is a refinement
        families = [f for f in families if f[0].shape.family in SEVERAL or candidate not in f]
        families = _take_out(candidate.white, families)
    return found
