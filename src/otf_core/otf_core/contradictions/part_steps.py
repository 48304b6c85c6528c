# SPDX-License-Identifier: Apache-2.0
"""Finds what moved between two parts of a run, the tracker or a reflector, and wrong places.

A step is a pose of the tracker of its own from a part on, or a place of its own of a target in a
part that names it again, or of one whose place is stated without uncertainty. With its columns c
beside the rows A of all unknowns, residuals e and weights W,

    M = c^T W (c - A S),    M d = c^T W e,    S = (A^T W A)^-1 A^T W c,    gain = d^T M d

M holds what tables, lines and places follow of a step: what they follow entirely, no data show. A
drift of the tracker, quadratic in time, is estimated beside every step, so that it is not taken
for one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.model.machine import TABLE, TOOL
from otf_core.solving.joint import JointSolution, SolvedRun, station_numbers
from otf_core.solving.sensitivity import BesideTables, beside_tables
from otf_core.solving.unknowns import place_block, pose_block

SIGNIFICANT = 6.0
"""Standard uncertainties of a step that count."""
LEAST = 4e-6
"""m; smaller steps do not matter beside the places of reflectors themselves."""
LEAST_OF_TRACKER = 4e-5
"""m; errors that no functions follow, and places of reflectors that count as exact, look like
smaller ones between parts that other axes drive: 14 um where errors of 100 um have kinks."""
VAGUE = 1e-4
"""m and rad; combinations of a step that the data show no better are left out."""
DRIFT = 2
"""Order of the drift that is estimated beside steps."""
MOST = 3
"""Steps of one run that are named."""
SIMPLER = 0.8
"""Share of the gain of the best step that another one of fewer numbers needs to be preferred."""


@dataclass(frozen=True)
class _Step:
    """A step that is tried: from, or in, a part; of a target, or of the tracker.

    Attributes
    ----------
    stated : bool
        The target is displaced in all parts from its place in machine.yaml.
    """

    run: SolvedRun
    part: int
    target: str
    columns: Array
    stated: bool = False

    def size(self, d: Array) -> float:
        """Root mean square displacement of what moves, m."""
        if not len(d):
            return 0.0
        moved = self.columns @ d
        acts = np.any(self.columns != 0.0, axis=(0, 2))
        return float(np.sqrt(np.mean(np.sum(moved[:, acts] ** 2, axis=0))))

    def matters(self, d: Array, least_of_tracker: float) -> bool:
        """Tell whether the step is larger than what else looks like one."""
        return self.size(d) > (LEAST if self.target else least_of_tracker)

    def words(self, d: Array) -> str:
        """What moved, how far, and what to do."""
        name = f'{Path(self.run.run.name).name}: ' if self.run.run.name else ''
        shift = ', '.join(f'{1e6 * v:.1f}' for v in d[:3])
        if self.stated:
            size = float(np.linalg.norm(d))
            return (
                f"{name}target '{self.target}': machine.yaml states its place without uncertainty "
                f'(u: 0), but it lies {1e6 * size:.1f} um from there ({shift} um). Measure its '
                f'place again, or state how well it is known: targets: {self.target}: '
                f'u: {size:.1g}'
            )
        if self.target:
            return (
                f"{name}target '{self.target}': in part {self.part + 1} it lies "
                f'{1e6 * np.linalg.norm(d):.1f} um from where it was before ({shift} um): it was '
                f're-seated or has moved. Name it differently in that part, in bag and '
                f'machine.yaml'
            )
        return (
            f'{name}from part {self.part + 1} on all points lie at least {1e6 * self.size(d):.1f} '
            f'um elsewhere: the tracker has moved. Check how it stands and record again, '
            f'or record the parts of each place as a bag of its own'
        )


def find_steps(joint: JointSolution, least_of_tracker: float = LEAST_OF_TRACKER) -> list[str]:
    """Words on what moved between parts of every run, the clearest of a run first.

    Parameters
    ----------
    least_of_tracker : float, m
        Smaller steps of the tracker are left out.
    """
    messages = []
    stations = station_numbers([solved.run for solved in joint.runs])
    for number, (solved, station) in enumerate(zip(joint.runs, stations, strict=True)):
        pose = solved.system.rows.fixed[pose_block(station)]
        steps = list(_steps_of(solved, pose))
        if steps:
            messages += _found(joint, number, steps, pose, least_of_tracker)
    return messages


def _steps_of(solved: SolvedRun, pose: Array) -> Iterator[_Step]:
    """Steps of a run that are tried: places stated, targets named before, the tracker."""
    run, part, fixed = solved.run, solved.run.pieces.part, solved.system.rows.fixed
    for name, own in run.by_target().items():
        if name != TOOL and run.machine.targets[name].u == 0.0:
            inner = run.sight(name).at(solved.system.q[own]).inner
            axes, columns = solved.system.axes, np.zeros_like(solved.system.axes)
            turned = (
                axes[:, own] if inner is None else np.einsum('cni,nij->cnj', axes[:, own], inner)
            )
            columns[:, own] = turned
            yield _Step(solved, 0, name, columns, stated=True)
    present = np.unique(part).tolist()
    for name in dict.fromkeys(run.targets):
        if run.machine.targets[name].link != TABLE or place_block(name) not in fixed:
            continue
        parts = [k for k in present if run.targets[k] == name]
        for k in parts[1:]:
            own = (part == k)[None, :, None]
            yield _Step(solved, k, name, fixed[place_block(name)] * own)
    for k in present[1:]:
        yield _Step(solved, k, '', pose * (part >= k)[None, :, None])


def _found(
    joint: JointSolution,
    number: int,
    steps: Sequence[_Step],
    pose: Array,
    least_of_tracker: float,
) -> list[str]:
    """Words on the steps of one run, the clearest first."""
    solved = joint.runs[number]
    time = 2.0 * solved.run.pieces.time / max(float(solved.run.pieces.time.max()), 1e-9) - 1.0
    drift = [pose * time[None, :, None] ** k for k in range(1, DRIFT + 1)]
    columns = np.concatenate([*drift, *(s.columns for s in steps)], axis=2)
    count = columns.shape[2]
    every = [
        columns if k == number else np.zeros((*s.residual.shape, 0))
        for k, s in enumerate(joint.runs)
    ]
    sums = beside_tables(joint, every, [np.arange(c.shape[2]) for c in every], count)
    white = solved.whitener.whiten(solved.residual)
    ratio = max(1.0, float(np.mean(white**2)))
    ends = np.cumsum([DRIFT * pose.shape[2], *(s.columns.shape[2] for s in steps)])
    places = [np.arange(a, b) for a, b in pairwise(ends.tolist())]
    beside, words = np.arange(ends[0]), []
    for _ in range(MOST):
        fitted = [_fit(sums, own, beside) for own in places]
        clear = [
            gain / ratio
            if gain / ratio > SIGNIFICANT**2 + len(d) and s.matters(d, least_of_tracker)
            else 0.0
            for s, (d, gain) in zip(steps, fitted, strict=True)
        ]
        if not any(clear):
            break
        good = [k for k, gain in enumerate(clear) if gain >= SIMPLER * max(clear)]
        best = min(good, key=lambda k: (len(places[k]), -clear[k]))
        words.append(steps[best].words(fitted[best][0]))
        beside = np.concatenate([beside, places[best]])
        places[best] = places[best][:0]
    return words


def _fit(sums: BesideTables, own: Array, beside: Array) -> tuple[Array, float]:
    """Step and its gain, what is estimated beside it taken off."""
    if not len(own):
        return np.zeros(0), 0.0
    normal, right = sums.normal, sums.right
    inverse = np.linalg.pinv(normal[np.ix_(beside, beside)], rcond=1e-9, hermitian=True)
    cross = normal[np.ix_(own, beside)] @ inverse
    left = normal[np.ix_(own, own)] - cross @ normal[np.ix_(beside, own)]
    pull = right[own] - cross @ right[beside]
    size, vectors = np.linalg.eigh(left)
    seen = size > VAGUE**-2
    along = vectors[:, seen].T @ pull
    return vectors[:, seen] @ (along / size[seen]), float(np.sum(along**2 / size[seen]))
