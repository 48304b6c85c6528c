# SPDX-License-Identifier: Apache-2.0
"""Tracker or target moved in mid-run: a rigid step of all points at one moment.

Six numbers before and after a moment explain what tables, reversal and a drift of third order in
time leave. A step shows as a peak over time; other misfit explains little, or at no moment more
than at others, or a smooth change of the machine explains it as well (``smooth_change``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.contradictions.quick_model import Model
from otf_core.contradictions.quick_rows import pose_columns
from otf_core.contradictions.smooth_change import sharp_share
from otf_core.contradictions.steps import Profile, step_profile
from otf_core.errors import InputError
from otf_core.model.frames import XYZ
from otf_core.pieces.finding import GATE, WARNING, Finding
from otf_core.pieces.pieces import reduce_to_pieces
from otf_core.pieces.runs import Run, rigid_pose

MOMENTS = 200
"""Moments that are tried at first."""
SHARE = 0.06
"""Share of the sum of squares that a step must explain; other misfit gave up to 0.03."""
GAIN, LARGE_GAIN = 45.0, 100.0
"""Drop of the sum of squares for each of the six numbers, in residual variances: at least; where
there may be several steps."""
LEAST = 2.0
"""Standard deviations of a sample that a step measures at least: noise that wanders does less."""
NEAR, AWAY = (0.03, 0.06), 0.1
"""Distances from a peak, as shares of the run."""
LONELY = 0.5
"""What a step away from the peak explains of it where one step is all there is."""
STEEP, CLEAR = 0.8, 5.0
"""What a step near the peak explains of it at most, and how many standard deviations of a sample
it measures, where there may be several; noise that wanders gives small and broad peaks."""
SHARP = 0.03
"""Share of what a step explains that a smooth change must not explain as well; axes that warm up
gave up to 0.011, steps 0.07 and more."""
MAX_STEPS = 5
"""Steps that are looked for in one run; as many are none: something changes all the time."""
LEFT = 1.0 / 3.0
"""Share of the sum of squares beyond noise that several steps may leave: moves leave none. What
changes all the time, as a cycle does, is a step at many moments, and cuts do not end it."""
MIN_PIECES = 60
"""Pieces on either side of a step."""


@dataclass(frozen=True)
class Step:
    """A step of one run.

    Attributes
    ----------
    run : int
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
    if share < SHARE or drop < GAIN:
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
    if step.shift < LEAST * level:
        return None
    clear = drop > LARGE_GAIN and step.shift > CLEAR * level
    if not _is_peak(profile, best, len(order), clear=clear):
        return None
    return step if sharp_share(rows, fit, run, step.time) > SHARP else None


def _level(run: Run) -> float:
    """Noise of a single sample, as specified or as measured if that is more, m."""
    spec, measured = run.machine.tracker, run.noise.level
    distance = float(np.median(np.linalg.norm(run.pieces.xyz, axis=1)))
    u_angle = max(spec.u_angle, *measured[1:])
    return float(np.hypot(max(spec.u_range, measured[0]), u_angle * distance))


def _is_peak(profile: Profile, best: int, pieces: int, *, clear: bool) -> bool:
    away = np.abs(profile.start - profile.start[best]) / pieces
    share = profile.gain / profile.gain[best]
    near = (away > NEAR[0]) & (away < NEAR[1])
    lonely = bool(share[away > AWAY].max(initial=0.0) < LONELY)
    return lonely or (clear and bool(share[near].max(initial=0.0) < STEEP))


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
    return before, after


def settle_steps(
    model: Model, nodes: Sequence[Array], config: CalibrationConfig, *, mend: bool
) -> tuple[Model, list[Finding]]:
    """Find steps, cut the runs there and solve anew, until no step is left.

    Parameters
    ----------
    model : Model
        Of one recording.
    nodes : three arrays, m
        Table nodes of X, Y, Z.
    config : CalibrationConfig
    mend : bool
        Cut the runs; else only say what is found.

    Returns
    -------
    model : Model
        Of the parts.
    findings : list of Finding
    """
    found: list[Finding] = []
    whole = model
    name = model.runs[0].recording.name
    for _ in range(MAX_STEPS):
        steps = [s for k in range(len(model.runs)) if (s := find_step(model, k)) is not None]
        if not steps:
            break
        step = max(steps, key=lambda s: s.share)
        run = model.runs[step.run]
        parts = split(run, step, nodes, config) if mend else None
        said = replace(step, time=run.late + step.time)
        found.append(_finding(name, said, parts is not None, mend=mend))
        if parts is None:
            break
        runs = [*model.runs[: step.run], *parts, *model.runs[step.run + 1 :]]
        model = Model.of(runs)
    if len(found) == MAX_STEPS or (len(found) > 1 and _leaves_much(model, whole)):
        return whole, [_restless(name, len(found))]
    return model, found


def _leaves_much(parts: Model, whole: Model) -> bool:
    left, before = (max(m.fit.ratio**2 - 1.0, 0.0) for m in (parts, whole))
    return left > LEFT * before


def _restless(name: str, count: int) -> Finding:
    """What is said where steps have no end: no single move explains the run."""
    return Finding('moved', WARNING, (
        f'{name + ": " if name else ""}what the tables leave changes over time, at {count} '
        f'moments and more, as no single move of tracker or target does: an effect that the model '
        f'lacks; ./otf diagnose looks for it'
    ))  # fmt: skip


def _finding(name: str, step: Step, mended: bool, *, mend: bool) -> Finding:
    text = f'{name + ": " if name else ""}tracker or target moved {step.words}'
    if mended:
        return Finding('moved', WARNING, (
            f'{text}; the parts before and after are solved each with a place of the tracker of '
            f'its own. Check clamping and target'
        ))  # fmt: skip
    if mend:
        return Finding('moved', GATE, (
            f'{text}; what is left on one side does not fix the tracker: clamp both and record '
            f'again, or cut the recording there'
        ))  # fmt: skip
    return Finding('moved', WARNING, f'{text}; check clamping and target')
