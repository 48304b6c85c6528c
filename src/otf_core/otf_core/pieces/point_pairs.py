# SPDX-License-Identifier: Apache-2.0
"""Pairs of nominal and measured positions as a run: every measured component is a row.

Where a machine should have been, and where it was found: holes that it drilled and a coordinate
measuring machine measured, points that a tracker or a probe took one by one. Nothing is to be
matched. The rows of a pair are the components of the deviation in the measured frame, so that
one which was not measured is left out and no other needs it; any rigid motion between both
frames is the pose, solved for like that of a tracker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from otf_core.arrays import Array, Flags, Index
from otf_core.config import POINTS
from otf_core.errors import InputError
from otf_core.files.text_table import SkippedLines
from otf_core.model.axis_path import AxisPath
from otf_core.model.chain import Sight
from otf_core.model.frames import RigidTransform, rigid_fit
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.noise.noise_model import NoiseComponent, NoiseModel
from otf_core.pieces.pieces import MIN_OUTLIER, Pieces
from otf_core.pieces.runs import Run, check_same_machine, common_nodes, errors_of
from otf_core.tracking.alignment import Alignment, Part

FEWEST_PAIRS = 6
"""Fewer determine nothing beside the rigid motion."""
LINES, MOST_IN_LINE = 48, 30
"""Groups of pairs whose components are weighted, left out and held out together."""
APART = 100.0
"""s; pairs share no slow noise."""
FEWEST_REPEATS = 10
"""Degrees of freedom from which on repeated points state the noise."""
SAME_POSITION = 1e-6
"""m and rad; nominal positions that differ by less are one that was measured repeatedly."""
GROSS = 10.0
"""Deviation, in medians of all, beyond which a pair is a gross error and left out at once."""
TOE = 1e-6
"""Size of a triad beside that of all points: it decides turns that points on a line leave free."""


@dataclass(frozen=True)
class PointPairs:
    """Pairs of one run.

    Attributes
    ----------
    q : ndarray, shape (n, k), m and rad
        Nominal axis positions.
    measured : ndarray, shape (n, 3), m
        In a frame of its own; NaN where a component was not measured.
    target : tuple of str
        Target of every pair.
    name : str
        Where they come from, for messages and reports.
    remarks : tuple of str
        What was left out or taken for what.
    left_out : tuple of SkippedLines
        Lines of the text that are no pairs, by reason.

    Raises
    ------
    InputError
        If there are too few, or positions or targets are not of the machine.

    Examples
    --------
    >>> q = np.random.default_rng(1).uniform(-0.1, 0.0, (50, 3))
    >>> otf_core.PointPairs(machine, q, q + 1e-5, ('tool',) * 50).q.shape
    (50, 3)
    """

    machine: Machine
    q: Array
    measured: Array
    target: tuple[str, ...]
    name: str = ''
    remarks: tuple[str, ...] = ()
    left_out: tuple[SkippedLines, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what determines nothing."""
        if len(self.measured) < FEWEST_PAIRS:
            raise InputError(
                f'{self.name}: {len(self.measured)} pairs of points; at least {FEWEST_PAIRS} are '
                f'needed, and many more for tables'
            )
        with errors_of(self.name):
            for path in self.paths:
                path.of(self.machine)

    @cached_property
    def paths(self) -> tuple[AxisPath, ...]:
        """Nominal positions of every target."""
        targets = np.array(self.target)
        return tuple(
            AxisPath(self.machine.axis_names, self.q[targets == name], name)
            for name in dict.fromkeys(self.target)
        )


def pose_of_pairs(measured: Array, nominal: Array) -> RigidTransform:
    """Rigid motion that takes measured points (n, 3) to nominal ones, m.

    Components that were not measured (NaN) are filled from the pose, again and again; turns that
    the points leave free are none.
    """
    there, pose = np.isfinite(measured), RigidTransform(np.eye(3), np.zeros(3))
    centre, size = nominal.mean(axis=0), float(np.ptp(nominal, axis=0).max())
    triad = np.vstack([np.zeros(3), TOE * size * np.eye(3)])
    for _ in range(50):
        filled = np.where(there, measured, pose.back(nominal))
        ends = filled.mean(axis=0) + triad
        moved = rigid_fit(np.vstack([filled, ends]), np.vstack([nominal, centre + triad]))
        change = np.abs(moved.apply(filled) - pose.apply(filled)).max()
        pose = moved
        if change < 1e-9:
            break
    return pose


def find_gross_errors(measured: Array, nominal: Array) -> tuple[RigidTransform, Flags]:
    """Pose of pairs (n, 3), m, and which of them (n,) are far: typed or swapped wrongly.

    What is far is left out of the pose, again and again: one gross error would bend all others.
    """
    far = np.zeros(len(measured), dtype=bool)
    for _ in range(20):
        pose = pose_of_pairs(measured[~far], nominal[~far])
        away = np.sqrt(np.nansum((measured - pose.back(nominal)) ** 2, axis=1))
        before, far = far, away > GROSS * float(np.median(away)) + MIN_OUTLIER
        if np.array_equal(far, before):
            break
    return pose, far


def repeated_noise(rest: Array, position: Index) -> float | None:
    """Standard deviation of a measured component, m, from points that were measured repeatedly.

    Parameters
    ----------
    rest : ndarray, shape (n, 3), m
        Deviations; NaN where nothing was measured.
    position : ndarray of int64, shape (n,)
        Number of the nominal position.

    Returns
    -------
    float or None
        None where fewer than ``FEWEST_REPEATS`` degrees of freedom show it.
    """
    square = freedom = 0.0
    for own in rest.T:
        values, at = own[np.isfinite(own)], position[np.isfinite(own)]
        count = np.bincount(at)
        mean = np.bincount(at, values) / np.maximum(count, 1)
        square += float(np.sum((values - mean[at]) ** 2))
        freedom += float(np.sum(np.maximum(count - 1, 0)))
    return float(np.sqrt(square / freedom)) if freedom >= FEWEST_REPEATS else None


def reduce_pairs(pairs: PointPairs) -> Run:
    """Make a run of pairs: a piece for every component that was measured."""
    machine, q, n = pairs.machine, pairs.q, len(pairs.q)
    targets = tuple(path.target for path in pairs.paths)
    part = np.array([targets.index(name) for name in pairs.target])
    nominal = np.empty((n, 3))
    for k, path in enumerate(pairs.paths):
        nominal[part == k] = Sight.of_target(machine, path.target).nominal(path.positions)
    pose, far = find_gross_errors(pairs.measured, nominal)
    expected, there = pose.back(nominal), np.isfinite(pairs.measured) & ~far[:, None]
    kept, filled = int(np.sum(~far)), np.where(there, pairs.measured, expected)
    positions = np.column_stack([part, np.rint(q / SAME_POSITION)])
    position = np.unique(positions, axis=0, return_inverse=True)[1].ravel()
    repeated = repeated_noise(np.where(there, pairs.measured - expected, np.nan), position)
    level, none = repeated or machine.tracker.u_range, NoiseComponent(0.0, 0.0)
    point, component = np.nonzero(there)
    count, still = len(point), np.zeros((len(point), q.shape[1]))
    pieces = Pieces(
        q=q[point],
        step=still,
        spread=np.zeros(count),
        xyz=filled[point],
        nominal=nominal[point],
        direction=np.eye(3)[component],
        origin=nominal[point],
        part=part[point],
        leg=point // min(max(1, n // LINES), MOST_IN_LINE),
        stretch=point,
        side=still,
        rate=still,
        speed=np.zeros(count),
        count=np.ones(count, dtype=np.int64),
        time=np.asarray(APART * point, dtype=np.float64),
        duration=np.zeros(count),
        used=kept,
        outliers=n - kept,
        end=APART * n,
        method=POINTS,
        stamps=(0, n - 1),
    )
    places = {name: np.array(machine.targets[name].place) for name in targets
              if machine.targets[name].u > 0.0}  # fmt: skip
    ends = np.cumsum([0, *(len(path.positions) for path in pairs.paths)]).tolist()
    parts = tuple(
        Part(path, *span) for path, span in zip(pairs.paths, pairwise(ends), strict=True)
    )
    return Run(
        machine=machine,
        pieces=pieces,
        pose=pose,
        noise=NoiseModel(NoiseComponent(level, level, 0.0), none, none),
        name=pairs.name,
        targets=targets,
        places=places,
        base=places,
        samples=Samples(np.arange(n), filled),
        path=NominalPath(nominal),
        alignment=Alignment(pose, nominal, np.arange(n, dtype=np.int32), 1.0, True, parts=parts),
        read=pairs.remarks,
        left_out=pairs.left_out,
    )


def prepare_pairs(every: Sequence[PointPairs]) -> tuple[list[Run], dict[str, Array]]:
    """Runs of pairs, and table nodes over what they cover together."""
    runs = [reduce_pairs(pairs) for pairs in every]
    check_same_machine(every)
    machine, ranges = every[0].machine, []
    for pairs in every:
        q = machine.wrapped(pairs.q)
        ranges.append((q.min(axis=0), q.max(axis=0)))
    return runs, common_nodes(machine, ranges)
