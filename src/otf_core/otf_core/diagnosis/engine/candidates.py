# SPDX-License-Identifier: Apache-2.0
"""Candidates beside causes: what is left of them, and of the residual, for any of the causes.

Q is an orthonormal basis of the columns of all causes ever tried together. What is left of the
columns P of a candidate beside them has the products P'P - (Q'P)'(Q'P) and P'y - (Q'P)'(Q'y): no
columns are written again. Causes that span less than Q give the rest of it back: with B an
orthonormal basis of that rest, (B'Q'P)'(B'Q'P) and (B'Q'P)'(B'Q'y) are added again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, groupby

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.aside import shared_out
from otf_core.diagnosis.engine.effect_products import Tried, family, shared_with
from otf_core.diagnosis.engine.evidence import Option
from otf_core.diagnosis.engine.residual_rows import Pulled, Rows

Candidates = Mapping[str, Sequence[Tried]]

NEXT_TO_NOTHING = 1e-9
"""Share of the largest squared singular value."""


@dataclass(frozen=True, eq=False)
class Beside:
    """What is left beside some causes.

    Attributes
    ----------
    candidates : mapping of effect name to sequence of Tried
        Those that may be named beside the causes.
    basis : ndarray, shape (r, q)
        Orthonormal, of the columns of the causes.
    residual : ndarray, shape (r,)
    """

    rows: Rows
    candidates: Candidates
    basis: Array
    residual: Array

    def trace(self, tried: Tried, take: Index, variance: float) -> Array:
        """Best fit of one of the candidates, less what the causes can follow, shape (r,)."""
        trace = tried.trace(take, variance)
        return np.asarray(trace - self.basis @ (self.basis.T @ trace))

    @cached_property
    def taken(self) -> tuple[Pulled, Array] | None:
        """What the causes can follow, and the amount of the residual along it."""
        if not self.basis.shape[1]:
            return None
        return self.rows.pulled(self.basis), self.basis.T @ self.rows.residual

    def less(self, tried: Tried) -> Tried:
        """A further candidate, less what the causes can follow."""
        if self.taken is None:
            return tried
        pulled, amount = self.taken
        return tried.without(tried.source.shared(pulled), amount)


@dataclass(frozen=True, eq=False)
class Pool:
    """All candidates, less what ``basis`` can follow.

    Attributes
    ----------
    groups : mapping of effect name to sequence of Tried
    basis : ndarray, shape (r, q)
        Orthonormal.
    amount : ndarray, shape (q,)
        Of the residual along it.
    """

    rows: Rows
    groups: Candidates
    basis: Array
    amount: Array

    @classmethod
    def of(cls, rows: Rows, groups: Candidates) -> Pool:
        """Candidates beside nothing."""
        return cls(rows, groups, np.zeros((len(rows.residual), 0)), np.zeros(0))

    def joined(self, option: Option) -> Pool:
        """Take the columns of an option into the basis."""
        own = option.own
        rest = own - self.basis @ (self.basis.T @ own)
        taken = orthonormal(rest, own)
        if not taken.shape[1]:
            return self
        amount, pulled = taken.T @ self.rows.residual, self.rows.pulled(taken)
        return Pool(
            self.rows,
            _without(self.groups, pulled, amount),
            np.concatenate([self.basis, taken], axis=1),
            np.concatenate([self.amount, amount]),
        )

    def beside(self, options: Sequence[Option]) -> Beside:
        """What is left beside options, all of which are in the basis."""
        left = {n: list(g) for n, g in self.groups.items()}
        for option in options:
            group = left.pop(option.effect.name, [])
            if option.effect.wave is not None:  # each axis has a period of its own
                left[option.effect.name] = [_other_axes(t, option.axes) for t in group]
        size = len(self.amount)
        columns = [self.basis.T @ (o.own / np.linalg.norm(o.own, axis=0).max()) for o in options]
        whole, values, _ = np.linalg.svd(np.concatenate([np.zeros((size, 0)), *columns], axis=1))
        rank = int(np.sum(values**2 > NEXT_TO_NOTHING * values[:1].sum() ** 2))
        kept, back = whole[:, :rank], whole[:, rank:]
        if back.shape[1]:
            again = back.T @ self.amount
            left = {n: [t.beside(back, again) for t in g] for n, g in left.items()}
        basis = self.basis @ kept
        return Beside(self.rows, left, basis, self.rows.residual - basis @ (kept.T @ self.amount))


def _without(groups: Candidates, pulled: Pulled, amount: Array) -> Candidates:
    every = [t for g in groups.values() for t in g]
    families = [list(alike) for _, alike in groupby(every, family)]
    found = shared_out(lambda alike: shared_with(alike, pulled), families)
    shared = chain.from_iterable(found)
    return {n: [t.without(next(shared), amount) for t in g] for n, g in groups.items()}


def _other_axes(tried: Tried, axes: Sequence[str]) -> Tried:
    """Keep the options of single axes that are not among these."""
    takes = [take for take in tried.takes if tried.axes(take)]
    return tried.only([take for take in takes if not set(tried.axes(take)) & set(axes)])


def orthonormal(columns: Array, whole: Array) -> Array:
    """Orthonormal basis of columns (r, k).

    Combinations that are next to nothing beside ``whole``, the columns before something was taken
    off, are left out.
    """
    values, vectors = np.linalg.eigh(columns.T @ columns)
    kept = values > NEXT_TO_NOTHING * np.linalg.eigvalsh(whole.T @ whole)[-1]
    return np.asarray(columns @ (vectors[:, kept] / np.sqrt(values[kept])))
