# SPDX-License-Identifier: Apache-2.0
"""Whitened rows of all runs: tables and poses, effects, deviations.

Functions of time times a way to act: many shapes, which share what they act with.

Lines that touch the same unknowns, and the whitened columns of these on them.

A line touches the splines along it: on a run of three axes half of the unknowns, mean over its
pieces. Products with the columns of effects leave out the rest.

With W the inverse Cholesky factor of the noise covariance (``normal.Whitener``): A holds the
columns of poses and tables, E those of an effect, y the deviations, all multiplied by W, so that
independent noise of unit variance is left in y. What an effect adds beyond the tables is what
remains of E once A is projected out. Columns of effects are made where they are asked for and not
kept: all of them together are many times as large as A.

Products of whitened columns of effects, with each other and with those of tables and poses.

What happens for some time only has columns that are zero on most lines: there they are left out,
as are unknowns that a line does not touch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from otf_core.arrays import Array, Index
from otf_core.effects import Effect, Shape, State, Terms
from otf_core.effects.action import Acting
from otf_core.effects.base import no_terms
from otf_core.effects.free_form import FreeForm
from otf_core.model.motions import ErrorMotion, is_motion
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Observed, Run
from otf_core.solving.joint import (
    JointSolution,
    settle_covariance,
    sum_normal_equations,
    tables_of,
)
from otf_core.solving.normal import rows_by_run
from otf_core.solving.residuals import (
    SampleResiduals,
    fold_of,
    leg_numbers,
    sample_residuals,
    sample_state,
)
from otf_core.solving.roughness import precision_like_others
from otf_core.solving.sensitivity import (
    PLACES_PER_BLOCK,
    Places,
    name_in_run,
    piece_state,
)
from otf_core.solving.solution import TIE_BREAK, free_columns, identifiable_blocks, smoothness
from otf_core.solving.whitener import Whitener


def no_course(state: State, shape: Shape) -> Array:
    """No function of time, shape (n, 0)."""
    return np.zeros((len(state), 0))


@dataclass(frozen=True, eq=False)
class TimeFunctions(Effect):
    """Functions of time times a way to act; each run has its own.

    Attributes
    ----------
    course : callable(state, shape) -> ndarray, shape (n, m)
        The functions of time.
    heads : tuple of str
        Of the names of the coefficients, one for every function.
    drivers : tuple of Effect
        Effects that may act so.
    """

    formula: Callable[[State, Shape], Terms] = no_terms
    own_per_run: bool = True
    course: Callable[[State, Shape], Array] = no_course
    heads: tuple[str, ...] = ()
    drivers: tuple[Effect, ...] = ()

    @property
    def acts(self) -> Acting:
        """What the functions are multiplied with: the first of those in which it may switch."""
        return self.switches[0]

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return every term of the way to act times every function, one after the other."""
        base, course = self.acts(state, {}), self.course(state, shape)
        names = tuple(f'{head}_{name}' for name in base.names for head in self.heads)
        units = tuple(unit for unit in base.units for _ in self.heads)
        columns = base.columns[:, :, :, None] * course[:, None, None, :]
        return Terms(names, units, ('',) * len(names), columns.reshape(len(state), 3, -1))

    def products(self, state: State, shapes: Sequence[Shape], other: Array) -> Array:
        """Products of displacements with others (n, 3, q), shape (s, q, k) for k terms."""
        acts = np.moveaxis(self.acts(state, {}).columns, 2, 0)
        courses = np.concatenate([self.course(state, shape) for shape in shapes], axis=1)
        sums = np.stack([np.einsum('ni,niq->qn', one, other) @ courses for one in acts])
        parts = sums.reshape(*sums.shape[:2], len(shapes), -1)
        return parts.transpose(2, 1, 0, 3).reshape(len(shapes), other.shape[2], -1)


@dataclass(frozen=True, eq=False)
class LinesByUnknowns:
    """Lines of a run that touch the same unknowns.

    Attributes
    ----------
    rows : ndarray of int64, shape (c m,)
        Rows of the m pieces of the lines among those of all runs, component by component.
    unknowns : ndarray of int64, shape (b,)
        Those that the lines touch.
    base : ndarray, shape (c m, b)
        Their whitened columns in these rows.
    """

    lines: list[int]
    rows: Index
    unknowns: Index
    base: Array


def sort_by_unknowns(
    columns: sparse.csr_array, whitener: Whitener, components: int, first: int
) -> list[LinesByUnknowns]:
    """Whiten the columns of unknowns line by line, and sort lines by the unknowns they touch.

    Parameters
    ----------
    columns : sparse array, shape (c p, b)
        Of all unknowns on the pieces of a run, component by component.
    components : int
        Number c of components of a piece.
    first : int
        Number of the first row of the run.
    """
    pieces = columns.shape[0] // components
    alike: dict[bytes, list[int]] = {}
    parts: dict[bytes, list[Array]] = {}
    for line, (bounds, inverse) in enumerate(zip(whitener.bounds, whitener.inverses, strict=True)):
        rows = _rows_of(np.arange(*bounds), components, pieces)
        own = inverse @ columns[rows].toarray().reshape(components, len(rows) // components, -1)
        touches = (own != 0.0).any(axis=(0, 1))
        alike.setdefault(touches.tobytes(), []).append(line)
        parts.setdefault(touches.tobytes(), []).append(own[:, :, touches])
    touched_parts = []
    for touches, lines in alike.items():
        unknowns = np.flatnonzero(np.frombuffer(touches, np.bool_))
        own = np.concatenate(parts.pop(touches), axis=1).reshape(-1, len(unknowns))
        every = np.concatenate([np.arange(*whitener.bounds[line]) for line in lines])
        rows = first + _rows_of(every, components, pieces)
        touched_parts.append(LinesByUnknowns(lines, rows, unknowns, own))
    return touched_parts


def _rows_of(some: Index, components: int, pieces: int) -> Index:
    """Rows of some pieces of a run, component by component."""
    return np.concatenate([k * pieces + some for k in range(components)])


def acts_on_lines(values: Array, bounds: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Determine which columns (c, p, k) are not zero on a line, shape (lines, k)."""
    starts = [low for low, _ in bounds]
    return np.logical_or.reduceat((values != 0.0).any(axis=0), starts, axis=0)


ROWS = 4_000
"""Rows that are projected at once; bounds the memory."""


@dataclass(frozen=True)
class WhitenedColumns:
    """Whitened columns Q, set up for their products with what effects add beyond the tables.

    With E = W D the columns of an effect, N the normal matrix of A: Q' (E - A N^-1 A' E) is
    (W' Q)' D - (N^-1 A' Q)' (A' E), so E need not be whitened again.

    Attributes
    ----------
    white : ndarray, shape (r, q)
        Q.
    turned : tuple of ndarray, shape (p, 3, q)
        W' Q of every run along X, Y and Z, for displacements as they are.
    inner : ndarray, shape (b, q)
        N^-1 A' Q.
    """

    white: Array
    turned: tuple[Array, ...]
    inner: Array


OF_THE_PATH = ('touched', 'factor', 'slack', 'ridge', 'sample_states')
"""What rows hold of the path and the functions of the motions, whatever the deviations."""


NOISE_RANGE = (0.7, 1.4)
"""``Rows.noise_range`` where standstills are long."""


@dataclass(frozen=True)
class Rows:
    """Rows of all runs, one run after the other, component by component.

    Attributes
    ----------
    done : JointSolution
        Of the calibration, without reversal: its residuals are the gap.
    whiteners : tuple of Whitener
        One per run, noise alone: what the calibration takes for misfit may be the gap.
    tables : ErrorTables
        As solved.
    states : tuple of State
        One per run, one entry per piece.
    plain_deviation : ndarray, shape (r,), m
        ``deviation`` before whitening.
    fold : ndarray of int, shape (r,)
        Group of legs each row belongs to, for judging on rows that were not fitted.
    limit : float
        m or rad per unit of the columns of ``use``.
    use : ndarray of int, shape (b,)
        Free unknowns that are projected out: those that are solved for, and rotations that only
        what a spline times the travel is off a spline tells from translations. They are of no use
        as tables, but their trace must not be taken for something else.
    runs : tuple of Run
        What was observed, with its samples; empty for a plan. Effects that differ from sample to
        sample are then taken at the pieces.
    noise_range : tuple of two floats
        Variances over those of the standstills that a residual without structure has by noise.
    """

    observed: tuple[Observed, ...]
    done: JointSolution
    whiteners: tuple[Whitener, ...]
    tables: ErrorTables
    states: tuple[State, ...]
    plain_deviation: Array
    fold: Index
    limit: float
    use: Index
    runs: tuple[Run, ...] = ()
    noise_range: tuple[float, float] = NOISE_RANGE

    def without(self, moved: Array) -> Rows:
        """The same with displacements across the path (r,), m, taken off the deviations."""
        rows = replace(self, plain_deviation=self.plain_deviation - moved)
        known = vars(self)
        vars(rows).update({name: known[name] for name in OF_THE_PATH if name in known})
        return rows

    @cached_property
    def sample_states(self) -> tuple[State, ...]:
        """States of the samples in the pieces, one per run."""
        nodes = self.done.unknowns.knots
        return tuple(
            sample_state(r, s.pose, self.tables, nodes)
            for r, s in zip(self.runs, self.done.runs, strict=True)
        )

    def sample_residuals(self) -> Iterator[SampleResiduals]:
        """Residuals of the samples of every run that has some; made anew, they are large."""
        if not self.runs:
            return
        nodes = self.done.unknowns.knots
        for run, solved in zip(self.runs, self.done.runs, strict=True):
            if len(run.pieces.samples):
                yield sample_residuals(run, solved.pose, self.tables, nodes)

    def columns_in_run(
        self, effect: Effect, shape: Shape, run: int, count: int, *, of_samples: bool = False
    ) -> Array:
        """Displacements of one run across the path per unit of its k terms, shape (r of it, k)."""
        axes = self.done.runs[run].system.axes
        products = np.empty((*axes.shape[:2], count))
        factors = self._factors(effect, shape, run, count, of_samples=of_samples)
        for part, columns, functions in factors:
            turned = np.swapaxes(np.swapaxes(axes[:, part], 0, 1) @ columns, 0, 1)
            if functions is None:
                products[:, part] = turned
                continue
            for j, (own, place) in enumerate(zip(functions, _places(functions), strict=True)):
                np.multiply(turned[:, :, j, None], own, out=products[:, part, place])
        return products.reshape(-1, count)

    def displacement(self, effect: Effect, shape: Shape, value: Array) -> Array:
        """Displacements across the path by all terms with values (k, n), shape (r, n)."""
        runs = len(self.states)
        values = np.split(value, runs) if effect.own_per_run else [value] * runs
        parts = []
        for run, own in enumerate(values):
            axes, moved = self.done.runs[run].system.axes, []
            for _, columns, functions in self._factors(effect, shape, run, len(own)):
                if functions is None:
                    moved.append(columns @ own)
                    continue
                pairs = zip(functions, _places(functions), strict=True)
                sizes = np.stack([f @ own[place] for f, place in pairs], axis=1)
                moved.append(columns @ sizes)
            across = np.einsum('cpi,pin->cpn', axes, np.concatenate(moved))
            parts.append(across.reshape(-1, value.shape[1]))
        return np.concatenate(parts)

    def products_in_run(
        self, turned: Array, effect: Effect, shapes: Sequence[Shape], run: int, count: int
    ) -> Array:
        """Products (s, q, k) of ``WhitenedColumns.turned`` of a run with displacements."""
        if isinstance(effect, TimeFunctions):
            return effect.products(self.states[run], shapes, turned)
        products = np.zeros((len(shapes), turned.shape[2], count))
        for whole, shape in zip(products, shapes, strict=True):
            for part, columns, functions in self._factors(effect, shape, run, count):
                if functions is None:
                    flat = turned[part].reshape(-1, turned.shape[2])
                    whole += flat.T @ columns.reshape(len(flat), -1)
                    continue
                for j, (own, place) in enumerate(zip(functions, _places(functions), strict=True)):
                    moved = np.einsum('piq,pi->qp', turned[part], columns[:, :, j])
                    whole[:, place] += moved @ own
        return products

    def _factors(
        self, effect: Effect, shape: Shape, run: int, count: int, *, of_samples: bool = False
    ) -> Iterator[tuple[slice, Array, list[Array] | None]]:
        """Displacements (n, 3, k) per unit of each term, of some pieces of a run at a time.

        Of a free form those of what it acts with, and the functions (n, m) that each is times.
        """
        state = self.states[run]
        if (of_samples or effect.changes_within_pieces) and self.runs:
            places = Places(self.runs[run].pieces, state, self.sample_states[run])
            columns = places.means(lambda s: effect.terms(s, shape).columns, count)
            yield slice(0, len(state)), columns, None
            return
        step = max(1, PLACES_PER_BLOCK // max(count, 1))
        for start in range(0, len(state), step):
            part = slice(start, start + step)
            if isinstance(effect, FreeForm):
                acts, functions = effect.factors(state.part(part), shape)
                yield part, acts.columns, functions
            else:
                yield part, effect.terms(state.part(part), shape).columns, None

    def plain_columns(self, effect: Effect, shape: Shape, *, of_samples: bool = False) -> Array:
        """Displacements across the path per unit of each term, shape (r, k).

        ``of_samples``: means over the samples of the pieces, of whatever effect.
        """
        count = len(effect.terms(self.states[0].part(slice(0, 1)), shape).names)
        runs = range(len(self.done.runs))
        parts = [self.columns_in_run(effect, shape, k, count, of_samples=of_samples) for k in runs]
        if len(parts) == 1:
            return parts[0]
        return linalg.block_diag(*parts) if effect.own_per_run else np.concatenate(parts)

    def terms(self, effect: Effect, shape: Shape) -> Terms:
        """Terms of the columns, those of one point; each run's own where they differ."""
        first = effect.terms(self.states[0].part(slice(0, 1)), shape)
        runs = range(len(self.states)) if effect.own_per_run else range(1)
        return Terms(
            tuple(name_in_run(name, k) for k in runs for name in first.names),
            first.units * len(runs),
            first.axes * len(runs),
            first.columns,
            first.orders * len(runs),
        )

    def by_run(self, values: Array) -> list[Array]:
        """Values (r, ...) of the rows of every run, each of shape (c, p, ...)."""
        return rows_by_run(values, [s.system.deviation.shape for s in self.done.runs])

    def whiten(self, columns: Array) -> Array:
        """Whiten columns (r, ...) of all runs."""
        parts = zip(self.whiteners, self.by_run(columns), strict=True)
        return np.concatenate([
            whitener.whiten(part).reshape(-1, *columns.shape[1:]) for whitener, part in parts
        ])  # fmt: skip

    def pulled(self, white: Array) -> WhitenedColumns:
        """Set up products of whitened columns (r, q) with what effects add beyond the tables."""
        parts = zip(self.whiteners, self.by_run(white), self.done.runs, strict=True)
        turned = tuple(
            np.einsum('cpi,cpq->piq', solved.system.axes, whitener.whiten_transposed(part))
            for whitener, part, solved in parts
        )
        inner = linalg.cho_solve((self.factor, True), self.pull(white))
        return WhitenedColumns(white, turned, inner)

    @cached_property
    def pulled_residual(self) -> WhitenedColumns:
        """The residual, set up for such products."""
        return self.pulled(self.residual[:, None])

    @cached_property
    def unwhitened_residual(self) -> list[Array]:
        """W' times the residual, shape (c, p) of every run."""
        parts = zip(self.whiteners, self.by_run(self.residual), strict=True)
        return [whitener.whiten_transposed(part) for whitener, part in parts]

    def prepare(self) -> None:
        """Make what columns are compared with; afterwards several threads may do so."""
        self.pulled_residual, self.unwhitened_residual, self.slack, self.touched  # noqa: B018
        if self.runs:
            self.sample_states  # noqa: B018

    def left(self, plain: Array) -> Array:
        """Deviations (r, ...) less tables and poses fitted with the weights of the noise alone, m.

        The solution of the calibration has a noise that what is not modelled makes louder and
        slower: its weights leave some of a large effect on lines that the effect does not act on.
        """
        cross = self.pull(self.whiten(plain.reshape(len(plain), -1)))
        scale = self.done.unknowns.gauge[:, self.use] * self.limit
        fitted = scale @ linalg.cho_solve((self.factor, True), cross)
        parts = [s.system.rows.times(column) for column in fitted.T for s in self.done.runs]
        followed = np.concatenate([part.reshape(-1) for part in parts])
        return np.asarray(plain - followed.reshape(len(fitted.T), -1).T.reshape(plain.shape))

    @cached_property
    def touched(self) -> list[list[LinesByUnknowns]]:
        """Whitened columns of the unknowns in ``use``, in units of ``limit``, without zeros.

        Those of every run, lines that touch the same unknowns together.
        """
        gauge = self.done.unknowns.gauge[:, self.use] * self.limit
        shapes = [s.system.deviation.shape for s in self.done.runs]
        first = np.cumsum([0, *(math.prod(shape) for shape in shapes)]).tolist()
        return [
            sort_by_unknowns(
                sparse.csr_array(solved.system.design @ gauge), whitener, shape[0], start
            )
            for solved, whitener, shape, start in zip(
                self.done.runs, self.whiteners, shapes, first[:-1], strict=True
            )
        ]

    def pull(self, columns: Array) -> Array:
        """Products (b, k) of the whitened columns of unknowns with columns (r, k)."""
        pulled = np.zeros((len(self.use), columns.shape[1]))
        for some in chain.from_iterable(self.touched):
            pulled[some.unknowns] += some.base.T @ columns[some.rows]
        return pulled

    @cached_property
    def deviation(self) -> Array:
        """Whitened deviations, shape (r,)."""
        return self.whiten(self.plain_deviation)

    @cached_property
    def factor(self) -> Array:
        """Lower Cholesky factor of the normal matrix of the unknowns with the tie-breaker."""
        normal = self.ridge.copy()
        for some in chain.from_iterable(self.touched):
            normal[np.ix_(some.unknowns, some.unknowns)] += some.base.T @ some.base
        return np.asarray(linalg.cholesky(normal, lower=True))

    @cached_property
    def slack(self) -> Array:
        """Tie-breaker in units of the normal matrix, L^-1 R L^-T, shape (b, b)."""
        half = linalg.solve_triangular(self.factor, self.ridge, lower=True)
        return np.asarray(linalg.solve_triangular(self.factor, half.T, lower=True))

    @cached_property
    def ridge(self) -> Array:
        """What is known before the data of what they do not determine, shape (b, b).

        A tie-breaker; and rotations that the calibration does not solve for are as rough as those
        that it does. Left free, they turn by some 0.1 mrad to and fro from node to node, where
        waves between the nodes of a translation would explain the same.
        """
        unknowns, logs = self.done.unknowns, self.done.roughness.logs
        known = TIE_BREAK * smoothness(unknowns)
        accepted, blocks = self.done.solution.accepted, unknowns.free_blocks
        for motion in [ErrorMotion.of(n) for n in blocks if is_motion(n) and n not in accepted]:
            block = unknowns.free_blocks[motion]
            like = precision_like_others(motion, unknowns.bases[motion.axis], logs)
            if like is not None and block.stop > block.start:
                known[block, block] += like
        return np.asarray(known[np.ix_(self.use, self.use)])

    def project(self, columns: Array) -> Array:
        """Columns (r, k) less what tables and poses can follow of them."""
        return self.less(np.array(columns), self.pull(columns))

    def less(self, columns: Array, cross: Array) -> Array:
        """Do the same in place, for known products (b, k), see ``pull``."""
        inner = linalg.cho_solve((self.factor, True), cross)
        for some in chain.from_iterable(self.touched):
            for start in range(0, len(some.rows), ROWS):
                part = slice(start, start + ROWS)
                columns[some.rows[part]] -= some.base[part] @ inner[some.unknowns]
        return columns

    @cached_property
    def residual(self) -> Array:
        """Whitened deviations less tables and poses, shape (r,)."""
        return self.project(self.deviation[:, None])[:, 0]


def _places(functions: Sequence[Array]) -> list[slice]:
    """Where the columns of every term of a free form lie."""
    ends = np.cumsum([0, *(f.shape[1] for f in functions)]).tolist()
    return [slice(low, high) for low, high in pairwise(ends)]


def build_rows(runs: Sequence[Run], joint: JointSolution, limit: float) -> Rows:
    """Set up the rows of solved runs of recordings; see ``rows_of``."""
    return replace(rows_of(runs, settle_covariance(joint, limit), limit), runs=tuple(runs))


def rows_of(observed: Sequence[Observed], joint: JointSolution, limit: float) -> Rows:
    """Set up the rows of solved runs, of recordings or of a plan.

    Parameters
    ----------
    joint : JointSolution
        Of the same runs, without reversal.
    limit : float
        ``CalibrationConfig.unidentifiable_above``.
    """
    systems = [s.system for s in joint.runs]
    whiteners = [
        Whitener.of(s, run.pieces, run.noise) for s, run in zip(systems, observed, strict=True)
    ]
    seen = identifiable_blocks(
        sum_normal_equations(systems, joint.unknowns, whiteners), joint.unknowns, limit
    )
    use = free_columns(joint.unknowns, seen)
    tables = tables_of(observed[0].machine, joint.unknowns, joint.solution)
    deviation, fold, states = [], [], []
    for run, solved, number in zip(observed, joint.runs, leg_numbers(joint), strict=True):
        states.append(piece_state(run, solved, joint.unknowns.knots, tables))
        deviation.append(solved.system.deviation.reshape(-1))
        fold.append(np.tile(fold_of(number), len(solved.system.axes)))
    return Rows(
        observed=tuple(observed),
        done=joint,
        whiteners=tuple(whiteners),
        tables=tables,
        states=tuple(states),
        plain_deviation=np.concatenate(deviation),
        fold=np.concatenate(fold),
        limit=limit,
        use=use,
    )


MOST = 0.6
"""Share of the columns, mean over the lines, from which all of them are taken everywhere."""


def add_products(rows: Rows, run: int, values: Array, cross: Array, square: Array) -> None:
    """Add the products of columns of one run to those of other runs.

    Parameters
    ----------
    values : ndarray, shape (c, p, k)
        The columns, not yet whitened.
    cross : ndarray, shape (b, k)
        A'E.
    square : ndarray, shape (k, k)
        E'E.
    """
    whitener = rows.whiteners[run]
    for some, acting in _acting(rows, run, values):
        white = _whitened(whitener, values, some.lines, acting)
        cross[np.ix_(some.unknowns, acting)] += (white.T @ some.base).T  # faster than reversed
        square[np.ix_(acting, acting)] += white.T @ white


def _acting(rows: Rows, run: int, values: Array) -> Iterator[tuple[LinesByUnknowns, Index]]:
    """Yield lines, and the columns of values (c, p, k) that are not zero on all of them."""
    acts = acts_on_lines(values, rows.whiteners[run].bounds)
    acts |= acts.mean() > MOST
    for some in rows.touched[run]:
        acting = np.flatnonzero(acts[some.lines].any(axis=0))
        if acting.size:
            yield some, acting


def _whitened(whitener: Whitener, values: Array, lines: Sequence[int], take: Index) -> Array:
    """Whiten some of the columns (c, p, k) on the m pieces of some lines, shape (c m, k)."""
    parts = [values[:, slice(*whitener.bounds[line])] for line in lines]
    if len(take) < values.shape[2]:
        parts = [part[:, :, take] for part in parts]
    whitened = np.empty((len(values), sum(part.shape[1] for part in parts), len(take)))
    start = 0
    for line, part in zip(lines, parts, strict=True):
        np.matmul(whitener.inverses[line], part, out=whitened[:, start : start + part.shape[1]])
        start += part.shape[1]
    return whitened.reshape(-1, len(take))
