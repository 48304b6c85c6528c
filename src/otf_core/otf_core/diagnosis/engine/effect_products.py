# SPDX-License-Identifier: Apache-2.0
"""Effects that are tried, by the products of their columns alone.

With E the whitened columns of one shape of an effect, A those of tables and poses, y what they
leave, L L' = N the normal matrix of A with its tie-breaker R, X = A'E and Z = L^-1 X, the columns
P = E - A N^-1 X that remain have the products

    P'P = E'E - Z'(1 + L^-1 R L^-T) Z,    P'y = (W'y)' D - (N^-1 A'y)' X

(D: E before whitening by W). Columns are made, reduced to these and forgotten, some shapes at a
time; those of the causes found are made again.

Candidates beside causes: what is left of them, and of the residual, for any of the causes.

Q is an orthonormal basis of the columns of all causes ever tried together. What is left of the
columns P of a candidate beside them has the products P'P - (Q'P)'(Q'P) and P'y - (Q'P)'(Q'y): no
columns are written again. Causes that span less than Q give the rest of it back: with B an
orthonormal basis of that rest, (B'Q'P)'(B'Q'P) and (B'Q'P)'(B'Q'y) are added again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, groupby
from typing import Protocol

import numpy as np
from scipy import linalg

from otf_core.arrays import Array, Index
from otf_core.aside import share_out
from otf_core.diagnosis.engine.evidence import (
    Estimate,
    Option,
    axis_subsets,
    estimate_of,
    likeliest_width,
    log_evidence,
    motion_subsets,
)
from otf_core.diagnosis.engine.residual_rows import (
    Rows,
    TimeFunctions,
    WhitenedColumns,
    add_products,
)
from otf_core.effects import Effect, Shape, Terms
from otf_core.effects.free_form import FreeForm
from otf_core.solving.sensitivity import column_size

NO_TRACE = 1e-9
"""m per unit; terms that move the target less across the path have no trace at all."""
FAINT = 1e-6
"""Share of the squares below which products are differences of rounding errors: such columns are
projected themselves."""
ADDED = 9.0
"""Evidence that an input without which a free form would be another effect has to add."""
MEMORY = 16e6
"""Bytes of columns that are whitened at once; more if one shape alone needs it."""


class Source(Protocol):
    """Where the columns of one shape of an effect come from."""

    def option(self, take: Index) -> Option:
        """Make the columns of some terms."""

    def trace(self, take: Index, value: Array) -> Array:
        """Sum up what some terms with values (k,) add, shape (r,)."""

    def shared(self, pulled: WhitenedColumns) -> Array:
        """Return the products (q, k) of whitened columns with what the effect adds."""


@dataclass(frozen=True, eq=False)
class ShapeProducts:
    """One shape of an effect.

    Attributes
    ----------
    size : ndarray, shape (k,), m
        Root mean square of the columns where they act.
    whole : ndarray, shape (k,)
        Squares of the whitened columns.
    normal, right : ndarray, shape (k, k) and (k,)
        P'P and P'y, less what the causes found so far can follow.
    takes : tuple of ndarray of int
        Terms of every option: all that act, those of each axis, of a few motions.
    shared : ndarray, shape (q, k)
        Products with the orthonormal columns that were left out.
    price : float
        Logarithm of the number of shapes that it was chosen from.
    """

    effect: Effect
    shape: Shape
    terms: Terms
    size: Array
    whole: Array
    normal: Array
    right: Array
    takes: tuple[Index, ...]
    source: Source
    shared: Array = field(default_factory=lambda: np.zeros((0, 0)))
    price: float = 0.0
    _odds: dict[tuple[bytes, float], float] = field(default_factory=dict, init=False, repr=False)

    def axes(self, take: Index) -> tuple[str, ...]:
        """Machine axes of some terms."""
        return tuple(sorted({self.terms.axes[i] for i in take} - {''}))

    def odds(self, take: Index, variance: float) -> float:
        """Evidence of an option, see ``log_evidence``, less its price.

        Of a free form that needs an input to be this effect, only what that adds, if it is little.
        """
        asked = take.tobytes(), variance
        if asked not in self._odds:
            self._odds[asked] = self._worked_out(take, variance)
        return self._odds[asked]

    def _worked_out(self, take: Index, variance: float) -> float:
        """Odds of an option, which are asked for again and again."""
        evidence = log_evidence(*self._products(take), variance, self.orders(take)) - self.price
        rest = self._without_essential(take)
        if len(rest) in (0, len(take)):
            return evidence
        other = log_evidence(*self._products(rest), variance, self.orders(rest))
        return evidence if evidence - other > ADDED else evidence - other

    def _without_essential(self, take: Index) -> Index:
        """Terms that do not depend on the input that a free form needs."""
        effect = self.effect
        if not isinstance(effect, FreeForm) or effect.form.essential is None:
            return take
        numbers = np.array(effect.form.numbers)[:, effect.form.essential]
        return np.asarray(take[numbers[take % len(numbers)] == 0])

    def orders(self, take: Index) -> Array:
        """Orders of some terms as functions; empty for a formula."""
        orders = np.array(self.terms.orders)
        return orders[take] if len(orders) else orders

    def made(self, take: Index, variance: float) -> Option:
        """Make the columns of some terms, see ``estimate``."""
        return replace(self.source.option(take), width=self._width(take, variance))

    def estimate(self, take: Index, variance: float) -> Estimate:
        """Coefficients of some terms; of a free form, or many alike, at their likeliest width."""
        width = self._width(take, variance)
        return estimate_of(*self._products(take), width if len(width) else None)

    def trace(self, take: Index, variance: float) -> Array:
        """What is left of the best fit of some terms beside tables and poses, shape (r,)."""
        return self.source.trace(take, self.estimate(take, variance).value)

    def gain(self, take: Index, pulled: WhitenedColumns) -> float:
        """Fall of the sum of squares by some terms of a formula, fitted to one column."""
        right = self.source.shared(pulled)[0, take]
        return estimate_of(self.normal[np.ix_(take, take)], right, self.size[take]).gain

    def _products(self, take: Index) -> tuple[Array, Array, Array]:
        return self.normal[np.ix_(take, take)], self.right[take], self.size[take]

    def _width(self, take: Index, variance: float) -> Array:
        orders = np.zeros(len(take)) if self.effect.many_alike else self.orders(take)
        return likeliest_width(*self._products(take), variance, orders) if len(orders) else orders

    def without(self, shared: Array, amount: Array) -> ShapeProducts:
        """Leave out what orthonormal columns can follow.

        Parameters
        ----------
        shared : ndarray, shape (q, k)
            Products with these columns, see ``Source``.
        amount : ndarray, shape (q,)
            Of y along them.
        """
        return replace(
            self,
            normal=self.normal - shared.T @ shared,
            right=self.right - shared.T @ amount,
            shared=np.concatenate([self.shared.reshape(-1, len(self.size)), shared]),
        )

    def beside(self, back: Array, amount: Array) -> ShapeProducts:
        """Let combinations ``back`` (q, n) of what was left out count again.

        Parameters
        ----------
        back : ndarray, shape (q, n)
            Orthonormal.
        amount : ndarray, shape (n,)
            Of y along them.
        """
        shared = back.T @ self.shared
        return replace(
            self, normal=self.normal + shared.T @ shared, right=self.right + shared.T @ amount
        )

    def only(self, takes: Sequence[Index]) -> ShapeProducts:
        """Keep some of the options."""
        return replace(self, takes=tuple(takes))


@dataclass(frozen=True, eq=False)
class MeasuredColumns:
    """Columns made from the rows of runs; ``cross`` (b, k) is A'E."""

    rows: Rows
    effect: Effect
    shape: Shape
    terms: Terms
    cross: Array

    def option(self, take: Index) -> Option:
        """Make the columns of some terms."""
        plain = self.rows.plain_columns(self.effect, self.shape)[:, take]
        own = self.rows.less(self.rows.whiten(plain), self.cross[:, take])
        size = column_size(plain)
        return Option(self.effect, self.shape, self.terms, take, own, size, own, plain)

    def own(self, take: Index) -> Array:
        """Whitened columns of some terms less what tables and poses can follow, shape (r, k)."""
        whole = np.zeros((len(self.terms.names), len(take)))
        whole[take, np.arange(len(take))] = 1.0
        plain = self.rows.displacement(self.effect, self.shape, whole)
        return self.rows.less(self.rows.whiten(plain), self.cross[:, take])

    def trace(self, take: Index, value: Array) -> Array:
        """Sum up what some terms with values (k,) add."""
        whole = np.zeros((len(self.terms.names), 1))
        whole[take, 0] = value
        moved = self.rows.displacement(self.effect, self.shape, whole)
        return self.rows.project(self.rows.whiten(moved))[:, 0]

    def shared(self, pulled: WhitenedColumns) -> Array:
        """Products of whitened columns with what the effect adds."""
        return _shared([self], pulled)[0]


def shared_with(alike: Sequence[ShapeProducts], pulled: WhitenedColumns) -> list[Array]:
    """``Source.shared`` of candidates of one ``family``."""
    sources = [t.source for t in alike if isinstance(t.source, MeasuredColumns)]
    return _shared(sources, pulled) if sources else [t.source.shared(pulled) for t in alike]


def family(tried: ShapeProducts) -> object:
    """Effect of which all shapes are multiplied together; else the candidate itself."""
    together = isinstance(tried.source, MeasuredColumns) and isinstance(
        tried.effect, TimeFunctions
    )
    return tried.effect if together else tried


def _shared(sources: Sequence[MeasuredColumns], pulled: WhitenedColumns) -> list[Array]:
    """Products of whitened columns with what shapes of one effect add."""
    rows, effect, shapes = sources[0].rows, sources[0].effect, [one.shape for one in sources]
    count = sources[0].terms.columns.shape[2]
    parts = [
        rows.products_in_run(turned, effect, shapes, k, count)
        for k, turned in enumerate(pulled.turned)
    ]
    own = effect.own_per_run
    products = np.concatenate(parts, axis=2) if own else np.asarray(sum(parts))
    return [part - pulled.inner.T @ one.cross for part, one in zip(products, sources, strict=True)]


def tried_shapes(rows: Rows, effect: Effect, shapes: Sequence[Shape]) -> list[ShapeProducts]:
    """Reduce the columns of shapes of an effect to their products."""
    return [t for some in _batches(rows, effect, shapes) for t in _reduced(rows, some)]


@dataclass(frozen=True, eq=False)
class _Shape:
    """A shape, its terms, and the place of its columns of one run in those of a batch."""

    effect: Effect
    shape: Shape
    terms: Terms
    place: slice


def _batches(rows: Rows, effect: Effect, shapes: Sequence[Shape]) -> Iterator[list[_Shape]]:
    """Shapes whose columns fit into ``MEMORY`` together."""
    runs = len(rows.states)
    most = MEMORY / 8.0 / len(rows.plain_deviation) * (runs if effect.own_per_run else 1)
    batch: list[_Shape] = []
    start = 0
    for shape in shapes:
        terms = rows.terms(effect, shape)
        width = terms.columns.shape[2]
        if not width:
            continue
        if batch and start + width > most:
            yield batch
            batch, start = [], 0
        batch.append(_Shape(effect, shape, terms, slice(start, start + width)))
        start += width
    if batch:
        yield batch


def _reduced(rows: Rows, batch: Sequence[_Shape]) -> list[ShapeProducts]:
    """Products of the columns of a batch; run by run where each has coefficients of its own."""
    effect, runs = batch[0].effect, range(len(rows.states))
    groups = [[k] for k in runs] if effect.own_per_run else [list(runs)]
    reduced = [_group(rows, batch, group) for group in groups]
    pairs = zip(batch, zip(*reduced, strict=True), strict=True)
    return [_joined(rows, one, parts) for one, parts in pairs]


@dataclass(frozen=True, eq=False)
class _Sums:
    """Of the columns of some runs: ``column_size``, E'E, A'E, E' times the residual."""

    size: Array
    square: Array
    cross: Array
    right: Array


def _group(rows: Rows, batch: Sequence[_Shape], group: Sequence[int]) -> list[_Sums]:
    """Sums over runs that share their coefficients."""
    plain = [_stack_columns([_columns(rows, one, k) for one in batch]) for k in group]
    size = column_size(*plain)
    cross, right = np.zeros((len(rows.use), len(size))), np.zeros(len(size))
    square = np.zeros((len(size), len(size)))
    for k, columns in zip(group, plain, strict=True):
        residual = rows.unwhitened_residual[k]
        values = columns.reshape(*residual.shape, -1)
        right += columns.T @ residual.reshape(-1)
        add_products(rows, k, values, cross, square)
    places = [s.place for s in batch]
    return [_Sums(size[p], square[p, p], cross[:, p], right[p]) for p in places]


def _columns(rows: Rows, one: _Shape, run: int) -> Array:
    return rows.columns_in_run(one.effect, one.shape, run, one.terms.columns.shape[2])


def _stack_columns(parts: Sequence[Array]) -> Array:
    """Columns side by side; no copy of one part alone."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)


def _joined(rows: Rows, one: _Shape, parts: Sequence[_Sums]) -> ShapeProducts:
    """Products with what tables and poses can follow left out."""
    size = np.concatenate([p.size for p in parts])
    square = linalg.block_diag(*(p.square for p in parts))
    cross = np.concatenate([p.cross for p in parts], axis=1)
    right = np.concatenate([p.right for p in parts]) - rows.pulled_residual.inner[:, 0] @ cross
    half = linalg.solve_triangular(rows.factor, cross, lower=True)
    normal = square - half.T @ (half + rows.slack @ half)
    whole, source = (
        square.diagonal().copy(),
        MeasuredColumns(rows, one.effect, one.shape, one.terms, cross),
    )
    faint = np.flatnonzero((normal.diagonal() < FAINT * whole) & (size > NO_TRACE))
    if faint.size:
        own = source.own(faint)
        normal[np.ix_(faint, faint)], right[faint] = own.T @ own, own.T @ rows.residual
    subsets = motion_subsets if one.effect.many_alike else axis_subsets
    chosen = subsets(one.terms)
    if one.effect.rigid:  # a motion by each axis is a cause of its own
        chosen = chosen[1:] or chosen
    takes = (s[size[s] > NO_TRACE] for s in chosen)
    return ShapeProducts(
        one.effect,
        one.shape,
        one.terms,
        size,
        whole,
        0.5 * (normal + normal.T),
        right,
        tuple(t for t in takes if t.size),
        source,
    )


Candidates = Mapping[str, Sequence[ShapeProducts]]

NEXT_TO_NOTHING = 1e-9
"""Share of the largest squared singular value."""


@dataclass(frozen=True, eq=False)
class ProductsBeside:
    """What is left beside some causes.

    Attributes
    ----------
    candidates : mapping of effect name to sequence of ShapeProducts
        Those that may be named beside the causes.
    basis : ndarray, shape (r, q)
        Orthonormal, of the columns of the causes.
    residual : ndarray, shape (r,)
    """

    rows: Rows
    candidates: Candidates
    basis: Array
    residual: Array

    def trace(self, tried: ShapeProducts, take: Index, variance: float) -> Array:
        """Best fit of one of the candidates, less what the causes can follow, shape (r,)."""
        trace = tried.trace(take, variance)
        return np.asarray(trace - self.basis @ (self.basis.T @ trace))

    @cached_property
    def taken(self) -> tuple[WhitenedColumns, Array] | None:
        """What the causes can follow, and the amount of the residual along it."""
        if not self.basis.shape[1]:
            return None
        return self.rows.pulled(self.basis), self.basis.T @ self.rows.residual

    def less(self, tried: ShapeProducts) -> ShapeProducts:
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
    groups : mapping of effect name to sequence of ShapeProducts
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
        added = orthonormal(less_basis(self.basis, option.own), option.own)
        if not added.shape[1]:
            return self
        amount, pulled = added.T @ self.rows.residual, self.rows.pulled(added)
        return Pool(
            self.rows,
            _without(self.groups, pulled, amount),
            np.concatenate([self.basis, added], axis=1),
            np.concatenate([self.amount, amount]),
        )

    def beside(self, options: Sequence[Option]) -> ProductsBeside:
        """What is left beside options, all of which are in the basis."""
        remaining = {n: list(g) for n, g in self.groups.items()}
        for option in options:
            group = remaining.pop(option.effect.name, [])
            if option.effect.wave is not None or option.effect.rigid:  # each axis has its own
                remaining[option.effect.name] = [_other_axes(t, option.axes) for t in group]
        size = len(self.amount)
        columns = [self.basis.T @ (o.own / np.linalg.norm(o.own, axis=0).max()) for o in options]
        whole, values, _ = np.linalg.svd(np.concatenate([np.zeros((size, 0)), *columns], axis=1))
        rank = int(np.sum(values**2 > NEXT_TO_NOTHING * values[:1].sum() ** 2))
        turned, back = whole[:, :rank], whole[:, rank:]
        if back.shape[1]:
            again = back.T @ self.amount
            remaining = {n: [t.beside(back, again) for t in g] for n, g in remaining.items()}
        basis, amount = self.basis, self.amount
        if back.shape[1]:
            basis, amount = basis @ turned, turned.T @ amount
        return ProductsBeside(self.rows, remaining, basis, self.rows.residual - basis @ amount)


def _without(groups: Candidates, pulled: WhitenedColumns, amount: Array) -> Candidates:
    every = [t for g in groups.values() for t in g]
    families = [list(alike) for _, alike in groupby(every, family)]
    families_shared = share_out(lambda alike: shared_with(alike, pulled), families)
    shared = chain.from_iterable(families_shared)
    return {n: [t.without(next(shared), amount) for t in g] for n, g in groups.items()}


def _other_axes(tried: ShapeProducts, axes: Sequence[str]) -> ShapeProducts:
    """Keep the options of single axes that are not among these."""
    takes = [take for take in tried.takes if tried.axes(take)]
    return tried.only([take for take in takes if not set(tried.axes(take)) & set(axes)])


def less_basis(basis: Array, columns: Array) -> Array:
    """Columns (r, k) less what an orthonormal basis (r, q) can follow; no copy if it is empty."""
    if not basis.shape[1]:
        return columns
    return np.asarray(columns - basis @ (basis.T @ columns))


def orthonormal(columns: Array, whole: Array) -> Array:
    """Orthonormal basis of columns (r, k).

    Combinations that are next to nothing beside ``whole``, the columns before something was taken
    off, are left out.
    """
    values, vectors = np.linalg.eigh(columns.T @ columns)
    significant = values > NEXT_TO_NOTHING * np.linalg.eigvalsh(whole.T @ whole)[-1]
    return np.asarray(columns @ (vectors[:, significant] / np.sqrt(values[significant])))
