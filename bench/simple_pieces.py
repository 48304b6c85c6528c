# SPDX-License-Identifier: Apache-2.0
"""The least that turns samples into path pieces, as one would write it from the paper.

The path stops at every corner: the stops give the pose of the tracker, and what lies between two
of them lies on one leg. Samples are averaged between table nodes over about 8 mm; the same length
is left out at the corners. It needs a stop at every corner and finds no outliers.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

STILL = 5e-3
"""m/s; a stop is slower."""
WINDOW = 0.04
"""s over which the speed is taken."""
SHORTEST = 0.1
"""s; a shorter stop is none."""
SIZE = 8e-3
"""m, of a piece, and left out at either end of a leg."""


@dataclass(frozen=True)
class Pieces:
    """Means over path pieces: what ``linear_estimators`` needs of them."""

    xyz: np.ndarray
    leg: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    count: np.ndarray
    time: np.ndarray
    duration: np.ndarray


@dataclass(frozen=True)
class Pose:
    """Tracker to machine: machine point = rotation @ tracker point + translation."""

    rotation: np.ndarray
    translation: np.ndarray


@dataclass(frozen=True)
class Run:
    """Pieces and the pose that the stops give."""

    pieces: Pieces
    T_machine_tracker: Pose


def stops(time, xyz):
    """First and last sample of every stop, (s, 2)."""
    half = max(1, round(0.5 * WINDOW / float(np.median(np.diff(time)))))
    way = np.linalg.norm(xyz[2 * half :] - xyz[: -2 * half], axis=1)
    speed = np.pad(way / (time[2 * half :] - time[: -2 * half]), half, mode='edge')
    edge = np.flatnonzero(np.diff(np.concatenate([[0], speed < STILL, [0]])))
    found = edge.reshape(-1, 2) - [0, 1]
    return found[time[found[:, 1]] - time[found[:, 0]] >= SHORTEST]


def rigid_fit(points, corners):
    """Pose that takes points (n, 3) to corners (n, 3) best (Kabsch)."""
    middle, there = points.mean(axis=0), corners.mean(axis=0)
    left, _, right = np.linalg.svd((corners - there).T @ (points - middle))
    sign = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    rotation = left @ sign @ right
    return Pose(rotation, there - rotation @ middle)


def marks(start, step, nodes):
    """Boundaries of the pieces of one leg, m from its start."""
    length = np.linalg.norm(step)
    cuts = [(n - s) / d * length for n, s, d in zip(nodes, start, step, strict=True) if d != 0]
    cuts = np.unique(np.concatenate([[SIZE, length - SIZE], *cuts]).round(9))
    cuts = cuts[(cuts >= SIZE - 1e-9) & (cuts <= length - SIZE + 1e-9)]
    parts = [
        np.linspace(a, b, int(np.ceil((b - a) / SIZE)), endpoint=False) for a, b in pairwise(cuts)
    ]
    return np.concatenate([*parts, cuts[-1:]])


def reduce_run(stamp, xyz, corners, nodes):
    """Path pieces and pose of a run: stamps (n,), ns, points (n, 3), m, of X, Y, Z the nodes."""
    time = (stamp - stamp[0]) * 1e-9
    still = stops(time, xyz)
    if len(still) != len(corners):
        raise SystemExit(f'{len(still)} stops found, the path has {len(corners)} corners')
    pose = rigid_fit(np.array([xyz[a : b + 1].mean(axis=0) for a, b in still]), corners)
    leg = np.searchsorted(still.mean(axis=1), np.arange(len(xyz))) - 1
    leg = np.clip(leg, 0, len(corners) - 2)
    step = np.diff(corners, axis=0)
    unit = step / np.linalg.norm(step, axis=1)[:, None]
    points = xyz @ pose.rotation.T + pose.translation
    along = np.einsum('ij,ij->i', points - corners[leg], unit[leg])
    piece, number = np.full(len(xyz), -1), 0
    bounds = np.searchsorted(leg, np.arange(len(step) + 1))
    for k, (a, b) in enumerate(pairwise(bounds)):
        cuts = marks(corners[k], step[k], nodes)
        own = np.searchsorted(cuts, along[a:b], side='right') - 1
        inside = (own >= 0) & (own < len(cuts) - 1)
        piece[a:b][inside] = number + own[inside]
        number += len(cuts)
    use = np.flatnonzero(piece >= 0)
    _, first, of = np.unique(piece[use], return_index=True, return_inverse=True)
    count = np.bincount(of)
    means = np.stack([np.bincount(of, v) for v in (*xyz[use].T, time[use])], axis=1)
    means /= count[:, None]
    own = leg[use[first]]
    duration = count * float(np.median(np.diff(time)))
    pieces = Pieces(means[:, :3], own, corners[own], unit[own], count, means[:, 3], duration)
    return Run(pieces, pose)
