# SPDX-License-Identifier: Apache-2.0
"""Tracker or target moved in mid-run: a rigid step of all points at one moment.

Six numbers before and after a moment explain what tables, reversal and a drift of third order in
time leave. A step at moment t is the sum of the columns of all time blocks after t, so sums over
blocks give the normal matrix, its product with the model and the score of every candidate. A step
shows as a peak over time; other misfit explains little, or at no moment more than at others.

A smooth change of the machine is a rigid motion, a strain of the volume and a reversal of the
axes, each a polynomial of time. A step in time is a kink that no polynomial of low order follows;
an axis that expands, or play that grows, is followed to the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import Legendre
from numpy.typing import NDArray
from scipy import linalg, sparse

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig
from otf_core.contradictions.quick_model import (
    Fit,
    Model,
    Rows,
    gain,
    pose_columns,
    reversal_columns,
)
from otf_core.errors import InputError
from otf_core.model.frames import XYZ
from otf_core.pieces.finding import GATE, WARNING, Finding
from otf_core.pieces.pieces import reduce_to_pieces
from otf_core.pieces.runs import Run, rigid_pose


@dataclass(frozen=True)
class Profile:
    """What a step explains, moment by moment.

    Attributes
    ----------
    start : ndarray of int64, shape (m,)
        First piece, in order of time, that lies after each moment.
    gain : ndarray, shape (m,)
        Drop of the weighted sum of squares.
    value : ndarray, shape (m, k)
        Size of the step.
    """

    start: Index
    gain: Array
    value: Array


def step_profile(rows: Rows, fit: Fit, columns: Array, order: Index, starts: Index) -> Profile:
    """Try a step at every moment.

    Parameters
    ----------
    columns : ndarray, shape (c p, k)
        What steps; zero for pieces of other runs.
    order : ndarray of int64, shape (n,)
        Pieces of the run in order of time.
    starts : ndarray of int64, shape (m,), ascending
        Moments: places in ``order`` from which on the step is there; the first above 0.
    """
    components, width = len(rows.axes), columns.shape[1]
    block = np.full(len(rows), -1)
    block[order] = np.searchsorted(starts, np.arange(len(order)), side='right') - 1
    row_block = np.tile(block, components)
    use = np.flatnonzero(row_block >= 0)
    place = row_block[use, None] * width + np.arange(width)
    values = columns[use] * fit.weight[use, None]
    entries = values.ravel(), (place.ravel(), np.repeat(use, width))
    blocks = sparse.csr_array(entries, shape=(len(starts) * width, len(row_block)))

    def after(sums: Array) -> Array:
        turned = sums.reshape(len(starts), -1)[::-1]
        np.cumsum(turned, axis=0, out=turned)
        return sums

    cross = after(fit.design.sums(blocks))
    score = after(blocks @ fit.residual).reshape(-1, width)
    own = after(blocks @ columns).reshape(-1, width, width)
    half = linalg.solve_triangular(
        fit.factor[0], cross.T, lower=True, overwrite_b=True, check_finite=False
    ).reshape(-1, len(starts), width)
    information = own - np.einsum('amk,aml->mkl', half, half)
    return Profile(starts, *gain(information, score, 1.0))


MAX_ORDER, ORDER_OF_DRIFT = 6, 3
"""Highest order of the polynomials, and that of the rigid motions in the usual model."""


def sharp_share(rows: Rows, fit: Fit, run: int, time: float) -> float:
    """Share of what a step explains that a smooth change does not explain as well.

    Parameters
    ----------
    fit : Fit
        Of the usual model.
    time : float
        s; first piece after the step.
    """
    mine = rows.run == run
    pose = pose_columns(rows)
    step = pose * _per_row(rows, mine & (rows.time >= time))
    smooth = np.concatenate(_smooth(rows, mine, pose), axis=1)
    information, score = fit.left(np.hstack([step, smooth])), fit.score(np.hstack([step, smooth]))
    both, _ = gain(information, score)
    width = step.shape[1]
    alone, _ = gain(information[:width, :width], score[:width])
    followed, _ = gain(information[width:, width:], score[width:])
    return float((both - followed) / alone)


def _smooth(rows: Rows, mine: NDArray[np.bool_], pose: Array) -> list[Array]:
    """Columns of a smooth change of one run beyond the usual model, in blocks (r, k)."""
    time = rows.time[mine]
    x = 2.0 * (rows.time - time.min()) / max(float(np.ptp(time)), 1e-9) - 1.0
    unit = np.eye(3)
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    strain = np.stack([
        rows.component(rows.q[:, [j]] * unit[i] + (i != j) * rows.q[:, [i]] * unit[j])
        for i, j in pairs
    ], axis=1)  # fmt: skip
    other = np.hstack([strain, reversal_columns(rows)])
    columns = []
    for order in range(1, MAX_ORDER + 1):
        course = _per_row(rows, np.where(mine, Legendre.basis(order)(x), 0.0))
        columns.append(other * course)
        if order > ORDER_OF_DRIFT:
            columns.append(pose * course)
    return columns


def _per_row(rows: Rows, values: Array | NDArray[np.bool_]) -> Array:
    """Values of pieces (p,) at all rows, shape (c p, 1)."""
    return np.tile(np.asarray(values, dtype=np.float64), len(rows.axes))[:, None]


MOMENTS = 200
"""Moments that are tried at first."""
MIN_EXPLAINED_SHARE = 0.06
"""Share of the sum of squares that a step must explain; other misfit gave up to 0.03."""
MIN_GAIN, MIN_GAIN_OF_SEVERAL = 45.0, 100.0
"""Drop of the sum of squares for each of the six numbers, in residual variances: at least; where
there may be several steps."""
MIN_SIZE = 2.0
"""Standard deviations of a sample that a step must exceed; drifting noise stays below."""
NEAR_PEAK, AWAY_FROM_PEAK = (0.03, 0.06), 0.1
"""Distances from a peak, as shares of the run."""
MAX_SHARE_AWAY = 0.5
"""What a step away from the peak explains of it where one step is all there is."""
MAX_SHARE_NEAR, MIN_SIZE_OF_SEVERAL = 0.8, 5.0
"""What a step near the peak explains of it at most, and how many standard deviations of a sample
it measures, where there may be several; noise that wanders gives small and broad peaks."""
MIN_SHARP_SHARE = 0.03
"""Share of what a step explains that a smooth change must not explain as well; axes that warm up
gave up to 0.011, steps 0.07 and more."""
MAX_STEPS = 5
"""Steps searched for in one run; as many are none: something changes all the time."""
MAX_SHARE_AFTER_STEPS = 1.0 / 3.0
"""Share of the sum of squares beyond noise that several steps may leave: moves leave none. What
changes all the time, as a cycle does, is a step at many moments, and cuts do not end it."""
MIN_PIECES = 60
"""Pieces on either side of a step."""


@dataclass(frozen=True)
class Step:
    """A step of one run.

    Attributes
    ----------
    time : float
        s since the first sample.
    place : ndarray, shape (3,), m
        On the path, machine frame.
    shift : float
        m; mean length of the displacement over the run.
    turn : float
        rad.
    share : float
        Of the sum of squares that it explains.
    """

    run: int
    time: float
    place: Array
    shift: float
    turn: float
    share: float

    @property
    def words(self) -> str:
        """When, where and how much."""
        place = ', '.join(f'{a} {1e3 * v:.0f}' for a, v in zip(XYZ, self.place, strict=True))
        return (
            f'{self.time:.1f} s after the start, near {place} mm, by {_um(self.shift)}'
            f'{f" and {1e6 * self.turn:.0f} urad" if self.turn > 1e-5 else ""}'
        )


def _um(value: float) -> str:
    return f'{1e3 * value:.2f} mm' if value >= 1e-4 else f'{1e6 * value:.1f} um'


def find_step(model: Model, run: int) -> Step | None:
    """Find the largest step of one of the runs; None if nothing looks like one."""
    rows, fit = model.rows, model.fit
    mine = np.flatnonzero(rows.run == run)
    order = mine[np.argsort(rows.time[mine], kind='stable')]
    if len(order) < 3 * MIN_PIECES:
        return None
    used = fit.weight.reshape(len(rows.axes), -1).sum(axis=0) > 0
    order = order[used[order]]
    columns = pose_columns(rows) * np.tile(rows.run == run, len(rows.axes))[:, None]
    starts = np.linspace(MIN_PIECES, len(order) - MIN_PIECES, MOMENTS).astype(np.int64)
    profile = step_profile(rows, fit, columns, order, np.unique(starts))
    best = int(np.argmax(profile.gain))
    share = float(profile.gain[best]) / fit.square
    drop = float(profile.gain[best]) / 6.0 / fit.ratio**2
    if share < MIN_EXPLAINED_SHARE or drop < MIN_GAIN:
        return None
    low, high = (profile.start[np.clip(best + k, 0, len(profile.start) - 1)] for k in (-1, 1))
    fine = step_profile(rows, fit, columns, order, np.unique(np.arange(low, high + 1)))
    top = int(np.argmax(fine.gain))
    first, value = order[fine.start[top]], fine.value[top]
    moved = value[:3] + np.cross(value[3:], rows.points[order])
    step = Step(
        run,
        float(rows.time[first]),
        rows.q[first],
        float(np.mean(np.linalg.norm(moved, axis=1))),
        float(np.linalg.norm(value[3:])),
        float(fine.gain[top]) / fit.square,
    )
    level = _level(model.runs[run])
    if step.shift < MIN_SIZE * level:
        return None
    clear = drop > MIN_GAIN_OF_SEVERAL and step.shift > MIN_SIZE_OF_SEVERAL * level
    if not _is_peak(profile, best, len(order), clear=clear):
        return None
    return step if sharp_share(rows, fit, run, step.time) > MIN_SHARP_SHARE else None


def _level(run: Run) -> float:
    """Noise of a single sample, as specified or as measured if that is more, m."""
    spec, measured = run.machine.tracker, run.noise.level
    distance = float(np.median(np.linalg.norm(run.pieces.xyz, axis=1)))
    u_angle = max(spec.u_angle, *measured[1:])
    return float(np.hypot(max(spec.u_range, measured[0]), u_angle * distance))


def _is_peak(profile: Profile, best: int, pieces: int, *, clear: bool) -> bool:
    away = np.abs(profile.start - profile.start[best]) / pieces
    share = profile.gain / profile.gain[best]
    near = (away > NEAR_PEAK[0]) & (away < NEAR_PEAK[1])
    lonely = bool(share[away > AWAY_FROM_PEAK].max(initial=0.0) < MAX_SHARE_AWAY)
    return lonely or (clear and bool(share[near].max(initial=0.0) < MAX_SHARE_NEAR))


def part_of(run: Run, first: int, last: int, nodes: Sequence[Array], config: CalibrationConfig
            ) -> Run:  # fmt: skip
    """Samples ``first`` to ``last - 1`` of a run as a run of its own, with a pose of its own.

    Raises
    ------
    InputError
        If they do not fix the pose.
    """
    samples = run.samples.part(first, last)
    alignment = replace(run.alignment, leg=run.alignment.leg[first:last])
    pieces = reduce_to_pieces(samples, alignment, tuple(nodes), config)
    pose = rigid_pose(pieces, alignment.T_machine_tracker, config)
    return replace(run, samples=samples, alignment=alignment, pieces=pieces, pose=pose)


def split(
    run: Run, step: Step, nodes: Sequence[Array], config: CalibrationConfig
) -> tuple[Run, Run] | None:
    """Cut a run at a step; None if a part does not fix its pose."""
    time = run.recording.samples.time
    cut = int(np.searchsorted(time, step.time))
    name = run.recording.name or 'run'
    try:
        parts = (
            part_of(run, 0, cut, nodes, config),
            part_of(run, cut, len(time), nodes, config),
        )
    except InputError:
        return None
    seconds = run.late + step.time
    words = (f'{name} before {seconds:.1f} s', f'{name} after {seconds:.1f} s')
    starts = (run.late, run.late + float(time[cut]))
    before, after = (
        replace(part, name=text, late=start)
        for part, text, start in zip(parts, words, starts, strict=True)
    )
    return before, replace(after, same_station=False)


def settle_steps(
    model: Model, nodes: Sequence[Array], config: CalibrationConfig, *, repair: bool
) -> tuple[Model, list[Finding]]:
    """Find steps, cut the runs there and solve anew, until no step is left.

    Parameters
    ----------
    model : Model
        Of one recording.
    nodes : three arrays, m
        Table nodes of X, Y, Z.
    repair : bool
        Cut the runs; else only report.

    Returns
    -------
    model : Model
        Of the parts.
    """
    findings: list[Finding] = []
    whole = model
    name = model.runs[0].recording.name
    for _ in range(MAX_STEPS):
        steps = [s for k in range(len(model.runs)) if (s := find_step(model, k)) is not None]
        if not steps:
            break
        step = max(steps, key=lambda s: s.share)
        run = model.runs[step.run]
        parts = split(run, step, nodes, config) if repair else None
        stated = replace(step, time=run.late + step.time)
        findings.append(_finding(name, stated, parts is not None, repair=repair))
        if parts is None:
            break
        runs = [*model.runs[: step.run], *parts, *model.runs[step.run + 1 :]]
        model = Model.of(runs)
    if len(findings) == MAX_STEPS or (len(findings) > 1 and _leaves_much(model, whole)):
        return whole, [_restless(name, len(findings))]
    return model, findings


def _leaves_much(parts: Model, whole: Model) -> bool:
    after, before = (max(m.fit.ratio**2 - 1.0, 0.0) for m in (parts, whole))
    return after > MAX_SHARE_AFTER_STEPS * before


def _restless(name: str, count: int) -> Finding:
    """Finding where steps have no end: no single move explains the run."""
    return Finding('moved', WARNING, (
        f'{name + ": " if name else ""}the residuals change over time, at {count} moments '
        f'or more, unlike any single movement of tracker or target: an effect that the '
        f'model does not contain; ./otf diagnose looks for it'
    ))  # fmt: skip


def _finding(name: str, step: Step, repaired: bool, *, repair: bool) -> Finding:
    text = f'{name + ": " if name else ""}tracker or target moved {step.words}'
    if repaired:
        return Finding('moved', WARNING, (
            f'{text}; the parts before and after are each solved with their own tracker pose. '
            f'Check clamping and target'
        ))  # fmt: skip
    if repair:
        return Finding('moved', GATE, (
            f'{text}; one of the two parts does not determine the tracker pose: clamp '
            f'both and record again, or cut the recording there'
        ))  # fmt: skip
    return Finding('moved', WARNING, f'{text}; check clamping and target')
