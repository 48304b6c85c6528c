# SPDX-License-Identifier: Apache-2.0
"""Normal equations of whitened rows (generalised least squares).

The rows of each leg are whitened and added to the normal equations: the cost grows linearly with
the path, and only the normal matrix is kept. With independent samples this is the paper's
weighting (Eq. 4-6).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TypeVar

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.solving.system import System
from otf_core.solving.unknowns import Unknowns
from otf_core.solving.whitener import Whitener
from otf_core.threads import side_by_side

STRIP = 32
"""Rows of a matrix, about, that are multiplied at a time."""


def _strips(size: int) -> Iterator[slice]:
    ends = np.linspace(0, size, max(1, round(size / STRIP)) + 1).astype(int).tolist()
    return map(slice, ends[:-1], ends[1:])


def lower_times(lower: Array, values: Array, out: Array) -> None:
    """Multiply values (c, m, k) by lower triangular matrices (c, m, m), into another array."""
    for strip in _strips(lower.shape[1]):
        np.matmul(lower[:, strip, : strip.stop], values[:, : strip.stop], out=out[:, strip])


def transpose_times(lower: Array, values: Array) -> None:
    """Multiply values (c, m, k) by the transposes of such matrices, in place."""
    upper = np.swapaxes(lower, 1, 2)
    for strip in _strips(lower.shape[1]):
        values[:, strip] = upper[:, strip, strip.start :] @ values[:, strip.start :]


Batch = TypeVar('Batch')

WORKERS = 2
"""Sums made side by side, always as many: the order of additions decides the last bits."""
PIECES_PER_BLOCK = 400
"""Pieces whose rows are held at a time."""


@dataclass(frozen=True)
class NormalEquations:
    """Sums over rows.

    Attributes
    ----------
    matrix : ndarray, shape (k, k)
    right : ndarray, shape (k,)
    square : float
        Sum of the squared whitened deviations.
    """

    matrix: Array
    right: Array
    square: float
    rows: int

    def __add__(self, other: NormalEquations) -> NormalEquations:
        """Return the sums over the rows of both."""
        return NormalEquations(
            self.matrix + other.matrix,
            self.right + other.right,
            self.square + other.square,
            self.rows + other.rows,
        )

    def less(self, part: NormalEquations) -> NormalEquations:
        """Return the sums over the rows that are not in ``part``."""
        return NormalEquations(
            self.matrix - part.matrix,
            self.right - part.right,
            self.square - part.square,
            self.rows - part.rows,
        )


def normal_equations(
    system: System,
    unknowns: Unknowns,
    whitener: Whitener,
    blocks: Collection[str] | None = None,
) -> NormalEquations:
    """Sum up the whitened rows of all legs for the free unknowns; see ``sum_groups``."""
    group = np.zeros(len(whitener.bounds), dtype=int)
    return sum_groups(system, unknowns, whitener, group, blocks=blocks)[0]


def sum_groups(
    system: System,
    unknowns: Unknowns,
    whitener: Whitener,
    group: Index,
    extra: Array | None = None,
    groups: int = 0,
    blocks: Collection[str] | None = None,
) -> list[NormalEquations]:
    """Sum up whitened rows, group by group of legs.

    Parameters
    ----------
    group : ndarray of int, shape (legs,)
        Group of each entry of ``whitener.bounds``, from 0.
    extra : ndarray, shape (c, p, k), optional
        Further columns, appended to the free unknowns.
    groups : int
        Number of groups, if some may be empty.
    blocks : collection of str, optional
        What is solved for: sums of motions that are not among it stay zero. They cost as much as
        others, and with one target offset a fifth of the motions is not identifiable.
    """
    groups = max(groups, int(group.max()) + 1)
    further = system.deviation[:, :, None]
    if extra is not None:
        further = np.concatenate([extra, further], axis=2)
    size = unknowns.full + further.shape[2]
    batches = list(_batches(system, whitener, group))

    def added(own: Sequence[tuple[int, list[int]]]) -> dict[int, Array]:
        total = {g: np.zeros((size, size)) for g in {g for g, _ in own}}
        for g, legs in own:
            inverses = [whitener.inverses[k] for k in legs]
            parts = pieces_of(whitener, legs)
            columns, white = white_rows(system, inverses, parts, further, blocks)
            total[g][np.ix_(columns, columns)] += white.T @ white
        return total

    shares = _shared(system, whitener, batches)
    if groups > 1:  # every group by one worker: there is one sum of each
        shares = [[b for b in batches if b[0] % WORKERS == k] for k in range(WORKERS)]
    totals, nothing = side_by_side(added, shares), np.zeros((size, size))
    products = [
        reduce(np.add, [t[g] for t in totals if g in t] or [nothing]) for g in range(groups)
    ]
    components, size_of = len(system.deviation), np.array([h - low for low, h in whitener.bounds])
    rows = components * np.bincount(group, size_of, groups).astype(int)
    return [of_free(p, unknowns, int(n)) for p, n in zip(products, rows, strict=True)]


def shares_of(system: System, whitener: Whitener) -> list[list[list[int]]]:
    """Batches of legs for every worker; the same whatever computer it is."""
    group = np.zeros(len(whitener.bounds), dtype=np.int64)
    return _shared(system, whitener, [legs for _, legs in _batches(system, whitener, group)])


def _shared(system: System, whitener: Whitener, batches: list[Batch]) -> list[list[Batch]]:
    """Deal batches to workers; what these share is made before they start."""
    system.rows.prepare()
    whitener.inverses  # noqa: B018
    return [batches[k::WORKERS] for k in range(min(WORKERS, len(batches)))]


def _batches(system: System, whitener: Whitener, group: Index) -> Iterator[tuple[int, list[int]]]:
    """Group and legs of every batch of about ``PIECES_PER_BLOCK`` pieces.

    Legs that run over the same splines, as in every lap, stand side by side: their rows depend on
    few unknowns.
    """
    splines = system.rows.splines
    ends = np.array([splines[[low, high - 1]] for low, high in whitener.bounds])
    alike = np.lexsort(np.sort(ends, axis=1).reshape(len(ends), -1).T)
    for g in np.unique(group).tolist():
        legs: list[int] = []
        held = 0
        for leg in alike[group[alike] == g].tolist():
            low, high = whitener.bounds[leg]
            legs.append(leg)
            held += high - low
            if held >= PIECES_PER_BLOCK:
                yield g, legs
                legs, held = [], 0
        if legs:
            yield g, legs


def pieces_of(whitener: Whitener, legs: Sequence[int]) -> list[slice]:
    """Pieces of some legs, by their places in ``whitener.bounds``."""
    return [slice(*whitener.bounds[k]) for k in legs]


def white_rows(
    system: System,
    inverses: Sequence[Array],
    legs: Sequence[slice],
    further: Array,
    blocks: Collection[str] | None = None,
) -> tuple[Index, Array]:
    """Whitened rows of some legs by the unknowns that they depend on.

    Parameters
    ----------
    inverses : sequence of ndarray, shape (c, m, m), 1/m
        What whitens the rows of every leg, see ``Whitener.inverses``.
    legs : sequence of slice
        Its pieces.
    further : ndarray, shape (c, p, j)
        Further columns, behind the unknowns.
    blocks : collection of str, optional
        Motions that are not among them are left out.

    Returns
    -------
    columns : ndarray of int64, shape (k + j,)
        Places of the unknowns in the full vector; further columns come behind it.
    rows : ndarray, shape (c m, k + j)
        Of the first component of all legs, then of the next.
    """
    own, width = np.concatenate([np.arange(s.start, s.stop) for s in legs]), further.shape[2]
    columns, rows = system.rows.touched(own, width, blocks)
    rows[:, :, len(columns) :] = further[:, own]
    white = np.empty_like(rows)
    start = 0
    for inverse in inverses:
        part = slice(start, start + inverse.shape[1])
        lower_times(inverse, rows[:, part], out=white[:, part])
        start = part.stop
    full = system.rows.unknowns.full
    return np.append(columns, full + np.arange(width)), white.reshape(-1, white.shape[2])


def of_free(product: Array, unknowns: Unknowns, rows: int) -> NormalEquations:
    """Normal equations of the free unknowns from the product of all columns of some rows."""
    own, further = slice(unknowns.full), slice(unknowns.full, len(product) - 1)
    low, side = unknowns.lowered(product[own, own]), unknowns.gauge.T @ product[own, further]
    matrix = np.block([[low, side], [side.T, product[further, further]]])
    right = np.append(unknowns.gauge.T @ product[own, -1], product[further, -1])
    return NormalEquations(matrix, right, float(product[-1, -1]), rows)


def rows_by_run(values: Array, shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Split values (r, ...) of the rows of all runs: one array (c, p, ...) for each of shapes."""
    ends = np.cumsum([np.prod(shape, dtype=int) for shape in shapes])
    parts = zip(np.split(values, ends[:-1]), shapes, strict=True)
    return [part.reshape(*shape, *values.shape[1:]) for part, shape in parts]
