# SPDX-License-Identifier: Apache-2.0
"""Uncertainty budget: covariance of squareness errors and nodes as a sum over sources.

*Noise.* The weights W treat lines, and the rows of a line, as independent and hold, besides the
noise of the tracker, the misfit. With the covariance C of the estimates and S of any part of the
noise, that part contributes

    C  A^T W S W A  C

to C. Slow noise does not stop at a corner: pieces i, j of different legs share
cov_ij = s exp(-|t_i - t_j| / tau) for each of range and two angles. The exponential is a product
of one factor per piece, so the sum over all pairs of legs is one pass over the legs.

*Effective degrees of freedom* (GUM annex G). The level of the noise rests on the residuals and on
the standstills. Residuals with covariance S have (tr S)^2 / tr S^2 degrees of freedom
(Welch-Satterthwaite for their mean square), less one for every estimated quantity; correlation
beyond the assumed one divides them. A standstill of length T with correlation time tau has T /
tau.

*Systematic contributions* are shared parameters: effects of the catalogue with the same
coefficients in the whole calibration. Their columns are those of the effect (``Effect.terms``);
the effect states from which keys of machine.yaml their uncertainty comes
(``Effect.contributions``).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from itertools import combinations
from operator import add, attrgetter

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.aside import share_out
from otf_core.config import POINTS
from otf_core.effects import REGISTRY, Effect, State, Terms
from otf_core.effects.base import Contribution
from otf_core.model.expanded import coverage_factor
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.sections import DECLARABLE, OF_BEAM, DeclaredUncertainty, declarable_keys
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import (
    MISFIT_TIME,
    NoiseModel,
    add_to_diagonal,
    misfit_covariance,
    noise_covariance,
)
from otf_core.noise.standstill import MIN_TOTAL, find_standstills
from otf_core.pieces.runs import Observed
from otf_core.solving.joint import JointSolution, SolvedRun, place_equations
from otf_core.solving.normal import (
    NormalEquations,
    of_free,
    pieces_of,
    shares_of,
    transpose_times,
    white_rows,
)
from otf_core.solving.residuals import ResidualCheck, check_residuals, leg_numbers
from otf_core.solving.sensitivity import components_across, piece_state, project_columns
from otf_core.solving.unknowns import free_values

LINES_PER_BLOCK = 256
"""Lines that are chained at a time."""


@dataclass(frozen=True)
class NoiseParts:
    """Parts of A^T W S W A of all runs; zero for motions that are not solved for.

    Attributes
    ----------
    normal : NormalEquations
        Of the rows of all passes, which the parts are made of: A^T W A.
    misfit : ndarray, shape (full, full)
        Of the misfit within lines.
    between : ndarray, shape (full, full)
        Of the covariance of tracker noise between the rows of one line.
    corners, misfit_corners : ndarray, shape (full, full)
        Of the covariance between different lines: noise of the tracker, lasting misfit.
    """

    normal: NormalEquations
    misfit: Array
    between: Array
    corners: Array
    misfit_corners: Array


def slow_amplitudes(run: Observed, solved: SolvedRun) -> Array:
    """Slow noise of range and two angles in every row, shape (c, p, 3), m."""
    noise = run.noise_and_misfit[0]
    level = np.array([c.slow for c in noise])
    smoothed = _smoothed(run.pieces.duration, _times(noise))
    return np.asarray(np.moveaxis(solved.system.shares, 0, 2) * level * smoothed)


def _times(noise: NoiseModel) -> Array:
    """Correlation times, shape (3,), s; where there is none any will do."""
    return np.array([c.correlation_time or MISFIT_TIME for c in noise])


def _smoothed(duration: Array, time: Array) -> Array:
    """Weight of slow noise in means over windows (p,), s, in covariances between them, (p, k)."""
    x = np.maximum(duration[:, None] / time, 1e-6)
    return np.asarray(np.sinh(np.minimum(0.5 * x, 50.0)) / (0.5 * x))


@dataclass(frozen=True)
class _Line:
    """Slow noise of a line at its begin and its end: ``vectors`` (k, 6) of ``use`` (k,)."""

    use: Index
    vectors: Array
    begin: float
    end: float


def _line(rows: Array, use: Index, slow: Array, time: Array, tau: Array) -> _Line:
    """For W A (c, m, k), its columns (k,), slow amplitudes (c, m, 3), times (m,) in s."""
    early = np.exp((time[0] - time)[:, None] / tau)
    late = np.exp((time - time[-1])[:, None] / tau)
    both = np.concatenate([slow * early, slow * late], axis=2).reshape(-1, 6)
    vectors = rows.reshape(-1, rows.shape[2]).T @ both
    return _Line(use, vectors, float(time[0]), float(time[-1]))


def _chained(lines: Sequence[_Line], size: int, tau: Array) -> Array:
    """Sum over pairs of lines of tail and head vectors, decaying with the time between."""
    tail, end, half = np.zeros((size, 3)), -np.inf, np.zeros((size, size))
    for low in range(0, len(lines), LINES_PER_BLOCK):
        some = lines[low : low + LINES_PER_BLOCK]
        tails, heads = (np.zeros((size, 3 * len(some))) for _ in range(2))
        for k, line in enumerate(some):
            own = slice(3 * k, 3 * k + 3)
            heads[line.use, own] = line.vectors[:, :3]
            tails[:, own] = np.exp(np.minimum(0.0, (end - line.begin) / tau)) * tail
            tail *= np.exp(np.minimum(0.0, (end - line.end) / tau))
            tail[line.use] += line.vectors[:, 3:]
            end = line.end
        half += tails @ heads.T
    return np.asarray(half + half.T)


@dataclass(frozen=True)
class _Sums:
    """Sums over some lines of a run, and the lines themselves by their number."""

    product: Array
    within: Array
    between: Array
    noise: dict[int, _Line]
    misfit: dict[int, _Line]


def _summed(
    run: Observed, solved: SolvedRun, blocks: Collection[str], batches: Sequence[list[int]]
) -> _Sums:
    """Sum over the lines of some batches, for some blocks of the unknowns."""
    size, pieces = solved.system.rows.unknowns.full, run.pieces
    noise, misfit = run.noise_and_misfit
    slow, lasts = slow_amplitudes(run, solved), np.array([MISFIT_TIME])
    shared = solved.system.axes * misfit.slow * _smoothed(pieces.duration, lasts)
    square = np.zeros((size, size))
    sums = _Sums(np.zeros((size + 1, size + 1)), square, square.copy(), {}, {})
    for legs in batches:
        inverses = [solved.whitener.inverses[leg] for leg in legs]
        parts = pieces_of(solved.whitener, legs)
        deviation = solved.system.deviation[:, :, None]
        columns, white = white_rows(solved.system, inverses, parts, deviation, blocks)
        sums.product[np.ix_(columns, columns)] += white.T @ white
        use, rows = columns[:-1], white.reshape(len(slow), -1, len(columns))[:, :, :-1]
        pairs = list(combinations(range(len(rows)), 2))
        odd, tied, start = np.empty_like(rows), np.empty((len(pairs), *rows.shape[1:])), 0
        for leg, inverse, part in zip(legs, inverses, parts, strict=True):
            own = slice(start, start + inverse.shape[1])
            start = own.stop
            transpose_times(inverse, rows[:, own])
            windows = (pieces.time[part], pieces.duration[part], pieces.count[part])
            shares, here = solved.system.shares[:, :, part], rows[:, own]
            odd[:, own] = here
            own_misfit, lasting = misfit_covariance(misfit, windows)
            root = np.asarray(np.linalg.cholesky(add_to_diagonal(lasting, own_misfit)))
            transpose_times(root[None], odd[:, own])
            for k, (a, b) in enumerate(pairs):
                white_noise, slow_noise = noise_covariance(
                    noise, shares[:, a], shares[:, b], windows
                )
                tied[k, own] = add_to_diagonal(slow_noise, white_noise) @ here[b]
            time = windows[0]
            sums.noise[leg] = _line(here, use, slow[:, part], time, _times(noise))
            sums.misfit[leg] = _line(here, use, shared[:, part], time, lasts)
        place, flat = np.ix_(use, use), odd.reshape(-1, len(use))
        sums.within[place] += flat.T @ flat
        half = sum(rows[a].T @ own for (a, _), own in zip(pairs, tied, strict=True))
        sums.between[place] += half + np.transpose(half)
    return sums


def noise_parts(runs: Sequence[Observed], joint: JointSolution) -> NoiseParts:
    """Sum up the misfit and the covariance that the weights leave out.

    Parameters
    ----------
    joint : JointSolution
        Of the same runs.
    """
    size, normals, solved_for = joint.unknowns.full, [], joint.solution.accepted
    within, between, corners, lasting = (np.zeros((size, size)) for _ in range(4))
    for run, solved in zip(runs, joint.runs, strict=True):
        shares = shares_of(solved.system, solved.whitener)
        parts = share_out(partial(_summed, run, solved, solved_for), shares)
        product = reduce(np.add, (sums.product for sums in parts))
        normals.append(of_free(product, joint.unknowns, solved.residual.size))
        for sums in parts:
            within += sums.within
            between += sums.between
        order = range(len(solved.whitener.bounds))
        noise, misfit = (
            {k: v for p in parts for k, v in parts_of(p).items()} for parts_of in _LINES
        )
        corners += _chained([noise[k] for k in order], size, _times(run.noise_and_misfit[0]))
        lasting += _chained([misfit[k] for k in order], size, np.array([MISFIT_TIME]))
    return NoiseParts(reduce(add, normals), within, between, corners, lasting)


_LINES = (attrgetter('noise'), attrgetter('misfit'))


def residual_freedom(joint: JointSolution, correlation_factor: float) -> float:
    """Degrees of freedom of the noise level from the residuals; at least 1."""
    moments = [alike.moments for solved in joint.runs for alike in solved.whitener.alike]
    trace = sum(float(np.sum(m.variance)) for m in moments)
    square = sum(float(np.sum(m.square)) for m in moments)
    return max(1.0, (trace**2 / square - joint.solution.rank) / correlation_factor)


def standstill_freedom(
    recorded: Sequence[Samples], runs: Sequence[Observed], speed: float
) -> float:
    """Degrees of freedom of the noise level from the standstills; zero if too short.

    Parameters
    ----------
    recorded : sequence of Samples
        Of every run.
    speed : float
        m/s; slower counts as standstill.
    """
    total = 0.0
    for samples, run in zip(recorded, runs, strict=True):
        if len(samples) < 2:
            continue
        standstills = find_standstills(samples, speed)
        length = float(np.diff(standstills, axis=1).sum()) * samples.step
        slowest = max(c.correlation_time for c in run.noise)
        total += length / slowest if length >= MIN_TOTAL else 0.0
    return total


def welch_satterthwaite(variances: Array, freedoms: Array) -> Array:
    """Effective degrees of freedom of sums of variances (GUM G.4.1).

    Parameters
    ----------
    variances : ndarray, shape (sources, n)
    freedoms : ndarray, shape (sources,)
        Infinite for contributions taken from specifications.

    Returns
    -------
    ndarray, shape (n,)
        Infinite where nothing is uncertain.
    """
    share = variances / np.maximum(variances.sum(axis=0), 1e-300)
    slack = np.sum(share**2 / freedoms[:, None], axis=0)
    return np.asarray(1.0 / np.maximum(slack, 1e-300))


MAX_PIECES_OF_SHARING = 50_000
"""Pieces over which an uncertainty declared for the whole path is shared out; of longer runs
every n-th."""


@dataclass(frozen=True)
class Systematic:
    """One contribution.

    Attributes
    ----------
    effect : Effect
        What it acts as.
    """

    effect: Effect
    acts: Contribution

    @property
    def source(self) -> str:
        """As the budget calls it."""
        return self.acts.source

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of machine.yaml, any of which declares it."""
        return self.acts.keys

    def uncertainty(self, terms: Terms, state: State, declared: DeclaredUncertainty) -> Array:
        """Standard uncertainty of every coefficient, shape (k,)."""
        return self.acts.size(terms, state, declared.get(*self.keys))


SYSTEMATIC = tuple(
    sorted(
        (Systematic(e, c) for e in REGISTRY.values() for c in e.contributions),
        key=lambda one: list(DECLARABLE).index(one.keys[0]),
    )
)
"""In the order of their keys."""


def possible_sources(machine: Machine) -> tuple[Systematic, ...]:
    """Contributions that machine.yaml of a machine may declare."""
    keys = {*declarable_keys(bool(machine.rotary_names))}
    return tuple(s for s in SYSTEMATIC if keys & set(s.keys))


def possible_keys(runs: Sequence[Observed]) -> tuple[str, ...]:
    """Keys of what may act on runs; where pairs were measured there is no beam."""
    keys = declarable_keys(bool(runs[0].machine.rotary_names))
    pairs = all(run.pieces.method == POINTS for run in runs)
    return tuple(key for key in keys if not (pairs and key in OF_BEAM))


def declared_sources(runs: Sequence[Observed]) -> tuple[Systematic, ...]:
    """Contributions that any run declares."""
    given = {k for r in runs if r.machine.uncertainty for k in r.machine.uncertainty.values}
    given &= {*possible_keys(runs)}
    return tuple(s for s in SYSTEMATIC if given & set(s.keys))


def piece_states(
    runs: Sequence[Observed], joint: JointSolution, tables: ErrorTables
) -> list[State]:
    """State of the pieces of every run, with what its machine declares."""
    nodes = joint.unknowns.knots
    return [piece_state(r, s, nodes, tables) for r, s in zip(runs, joint.runs, strict=True)]


def systematic_sensitivities(
    sources: Sequence[Systematic], states: Sequence[State], joint: JointSolution
) -> list[Array]:
    """Change of the estimates per standard uncertainty of the coefficients of every source.

    A coefficient is one parameter shared by all runs. The weights of a line are made once for
    all sources.

    Parameters
    ----------
    states : sequence of State
        See ``piece_states``.

    Returns
    -------
    list of ndarray, shape (full, k)
    """
    pulls = systematic_pulls(sources, states, joint)
    return [joint.solution.covariance @ pull for pull in pulls]


def systematic_pulls(
    sources: Sequence[Systematic], states: Sequence[State], joint: JointSolution
) -> list[Array]:
    """A^T W c for the columns c of every source, (full, k): sensitivities less the covariance."""
    if not sources:
        return []
    sizes = [[_uncertainty(source, state) for source in sources] for state in states]
    columns = [
        partial(_columns, sources, state, solved, u)
        for state, solved, u in zip(states, joint.runs, sizes, strict=True)
    ]
    ends = np.cumsum([len(u) for u in sizes[0]])
    return np.split(project_columns(joint, columns), ends[:-1], axis=1)


def _uncertainty(source: Systematic, state: State) -> Array:
    """Standard uncertainty of every coefficient for one run, shape (k,)."""
    some = state.part(slice(None, None, max(1, len(state) // MAX_PIECES_OF_SHARING)))
    declared = state.machine.uncertainty or DeclaredUncertainty({})
    return source.uncertainty(source.effect.terms(some, source.acts.shape), some, declared)


def _columns(
    sources: Sequence[Systematic],
    state: State,
    solved: SolvedRun,
    sizes: Sequence[Array],
    pieces: slice,
) -> Array:
    """Displacements across the path of some pieces of a run, (c, m, k), m, per uncertainty."""
    some = state.part(pieces)
    columns = [
        components_across(solved, source.effect.terms(some, source.acts.shape).columns, pieces) * u
        for source, u in zip(sources, sizes, strict=True)
    ]
    return np.concatenate(columns, axis=2)


NOISE, MISFIT, SMOOTHNESS, EFFECTS = 'noise', 'misfit', 'smoothness', 'effects'
STRAIGHT = 'straight lines'
PLACES = 'places of targets'
TYPICAL_SOURCE = 'typical, not declared'
"""What typical values add for systematic contributions that nobody declared."""
OBSERVED = (NOISE, MISFIT, SMOOTHNESS, EFFECTS, PLACES, STRAIGHT)
"""Sources that the run shows, or that it leaves open; all others are systematic."""


@dataclass(frozen=True)
class Source:
    """One contribution.

    Attributes
    ----------
    covariance : ndarray, shape (full, full), m and rad
        Of all unknowns.
    dof : float
        Degrees of freedom of its size; infinite for declared ones.
    """

    name: str
    covariance: Array
    dof: float


@dataclass(frozen=True)
class Budget:
    """Uncertainty by source.

    Attributes
    ----------
    sources : tuple of Source
        Their covariances add up.
    not_stated : tuple of str
        Systematic contributions that nothing was declared for; not included.
    inflation : float
        Factor on the covariance that the residuals still call for.
    rows : ndarray, shape (m, full)
        Squareness and nodes of the tables from all unknowns, see ``tabulate.Tabulation``.
    straight : ndarray, shape (m,), m^2 and rad^2
        Variance of the nodes that stands for what straight lines between them miss.
    """

    sources: tuple[Source, ...]
    not_stated: tuple[str, ...]
    inflation: float
    rows: Array
    straight: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all sources of the tables."""
        return (*(s.name for s in self.sources), STRAIGHT)

    @property
    def whole(self) -> Array:
        """Combined covariance of all unknowns, poses and reversal included, (full, full)."""
        return np.asarray(sum(s.covariance for s in self.sources))

    @property
    def run(self) -> Array:
        """The part of ``whole`` that the run itself shows: noise and misfit."""
        return np.asarray(sum(s.covariance for s in self.sources if s.name in OBSERVED))

    @cached_property
    def covariance(self) -> Array:
        """Combined covariance of C0Y, B0Z, A0Z and the nodes of EXX ... ECZ, shape (m, m)."""
        return np.asarray(self.rows @ self.whole @ self.rows.T + np.diag(self.straight))

    @property
    def freedoms(self) -> Array:
        """Degrees of freedom of every source, shape (sources,)."""
        return np.array([*(s.dof for s in self.sources), np.inf])

    def variances(self, rows: Array | None = None) -> Array:
        """Variance by source of every value, or of linear combinations ``rows`` (n, m) of them.

        Returns
        -------
        ndarray, shape (sources, n)
        """
        whole = self.rows if rows is None else rows @ self.rows
        parts = [np.einsum('ij,ij->i', whole @ s.covariance, whole) for s in self.sources]
        parts.append(self.straight if rows is None else rows**2 @ self.straight)
        return np.asarray(np.maximum(np.array(parts), 0.0))

    def expansion(self, variances: Array) -> tuple[float, float]:
        """Coverage factor for 95 % and degrees of freedom, smallest over values (sources, n)."""
        known = variances[:, variances.sum(axis=0) > 0]
        freedom = float(welch_satterthwaite(known, self.freedoms).min(initial=np.inf))
        return coverage_factor(freedom), freedom


def whole_check(
    runs: Sequence[Observed], joint: JointSolution, residuals: Sequence[Array]
) -> ResidualCheck:
    """Check residuals (c, p) of all runs together against the noise assumed."""
    white = [s.whitener.whiten(e) for s, e in zip(joint.runs, residuals, strict=True)]
    legs = np.concatenate(leg_numbers(joint))
    return check_residuals(np.concatenate(white, axis=1), legs, joint.solution.rank)


def make_budget(
    runs: Sequence[Observed],
    joint: JointSolution,
    parts: NoiseParts,
    states: Sequence[State],
    still: float,
    check: ResidualCheck,
) -> Budget:
    """Set up the budget of a calibration.

    The data leave a part C K^-1 C of the covariance C to a prior K: smoothness, and what
    machine.yaml states of the places of targets.

    Parameters
    ----------
    joint : JointSolution
        Of the same runs.
    parts : NoiseParts
        Of both.
    states : sequence of State
        Of the pieces of every run, see ``piece_states``.
    still : float
        See ``standstill_freedom``.
    check : ResidualCheck
        Of all residuals.

    Returns
    -------
    Budget
        Of the unknowns themselves; ``rows`` are to be set to those of the tables.
    """
    own = joint.solution.covariance
    gauge, free = joint.unknowns.gauge, free_values(joint.unknowns, own)
    smooth = np.asarray(free.T @ joint.roughness.precision @ free)
    places = place_equations(joint.machine, joint.unknowns, joint.places).matrix
    stated = np.asarray(free.T @ places @ free)
    prior = smooth + stated
    drawn = gauge @ joint.roughness.drawn
    misfit = own @ parts.misfit @ own
    noise = own - misfit - prior + own @ (parts.corners + parts.between) @ own
    misfit += own @ parts.misfit_corners @ own + (check.inflation - 1.0) * (own - prior)
    dof = residual_freedom(joint, check.correlation_factor) + still
    entries = [(NOISE, noise, dof), (MISFIT, misfit, dof)]
    entries.append((SMOOTHNESS, smooth + drawn @ drawn.T, np.inf))
    if stated.any():
        entries.append((PLACES, stated, np.inf))
    declared = declared_sources(runs)
    changes = systematic_sensitivities(declared, states, joint)
    for source, change in zip(declared, changes, strict=True):
        entries.append((source.source, change @ change.T, np.inf))
    return Budget(
        tuple(Source(*entry) for entry in entries),
        tuple(s.source for s in possible_sources(runs[0].machine) if s not in declared),
        check.inflation,
        np.eye(joint.unknowns.full),
        np.zeros(joint.unknowns.full),
    )


def with_source(budget: Budget, name: str, covariance: Array) -> Budget:
    """The budget with one more source after those of the data, (full, full), m and rad."""
    own = len((NOISE, MISFIT, SMOOTHNESS))
    source = Source(name, covariance, np.inf)
    return replace(budget, sources=(*budget.sources[:own], source, *budget.sources[own:]))
