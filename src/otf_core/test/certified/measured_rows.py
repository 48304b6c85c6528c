# SPDX-License-Identifier: Apache-2.0
"""From the samples of the run to rows, docs/formulation.md sections 4 to 6.

The leg of every sample is data (the column ``leg``): nothing is matched here.
"""

import json
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from certified.exact_chain import AXES, influences

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Pieces:
    """Means over path pieces; SI units.

    ``xyz`` (p, 3) in the frame of the tracker, on the line of ``direction`` through ``origin``;
    samples ``count``, mean ``time``, ``duration``; ``spread``, the standard deviation of the
    samples along the line.
    """

    xyz: np.ndarray
    leg: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    count: np.ndarray
    time: np.ndarray
    duration: np.ndarray
    spread: np.ndarray


@dataclass(frozen=True)
class Rows:
    """Deviations across the path: a2 of all pieces, then a3 of all.

    ``axes`` (r, 3), ``deviation`` (r,) in m and ``piece`` (r,) of each. A row is the mean of the
    rows at two points ``q`` (2, r, 3) of its piece, where ``influence`` (2, r, 21) are the
    derivatives by MOTIONS and SQUARENESS; ``pose`` (r, 6) are those by the pose.
    """

    axes: np.ndarray
    deviation: np.ndarray
    piece: np.ndarray
    q: np.ndarray
    influence: np.ndarray
    pose: np.ndarray


def read_run(folder=HERE):
    """Description of the run."""
    return json.loads((folder / 'run.json').read_text(encoding='utf-8'))


def read_samples(name, folder=HERE):
    """Stamps (n,) in ns, legs (n,) and points (n, 3) in m of a CSV file."""
    kinds = [('stamp_ns', 'i8'), ('leg', 'i8'), ('x', 'f8'), ('y', 'f8'), ('z', 'f8')]
    table = np.loadtxt(folder / name, dtype=kinds, delimiter=',', skiprows=1)
    return table['stamp_ns'], table['leg'], np.stack([table[a] for a in 'xyz'], axis=1)


def rotation_of(vector):
    """Rotation matrix of a rotation vector (3,), by Rodrigues' formula."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turns = np.linalg.norm(vector) / np.pi
    return np.eye(3) + np.sinc(turns) * cross + 0.5 * np.sinc(0.5 * turns) ** 2 * cross @ cross


def moved(pose, motion):
    """Pose (rotation, translation) after a further shift and rotation vector, (6,)."""
    turn = rotation_of(motion[3:])
    return turn @ pose[0], turn @ pose[1] + motion[:3]


def pose_columns(points):
    """Displacement of points (n, 3) by three shifts and three small turns, (n, 3, 6)."""
    shifts = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    turns = np.stack([np.cross(axis, points) for axis in np.eye(3)], axis=2)
    return np.concatenate([shifts, turns], axis=2)


def corner_pose(corners, leg, xyz):
    """Pose by the first samples of all legs, which are taken at their corners (Kabsch)."""
    first = np.array([np.flatnonzero(leg == j)[0] for j in range(len(corners) - 1)])
    here, there = xyz[first], corners[:-1]
    left, _, right = np.linalg.svd((there - there.mean(0)).T @ (here - here.mean(0)))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return rotation, there.mean(0) - rotation @ here.mean(0)


def rigid_pose(pieces, pose):
    """Pose of the least squares of the distances from the lines, every sample counting alike."""
    across = np.eye(3) - pieces.direction[:, :, None] * pieces.direction[:, None, :]
    across = across * np.sqrt(pieces.count)[:, None, None]
    for _ in range(10):
        points = pieces.xyz @ pose[0].T + pose[1]
        distance = np.einsum('nij,nj->ni', across, points - pieces.origin)
        columns = np.einsum('nij,njk->nik', across, pose_columns(points))
        pose = moved(
            pose, np.linalg.lstsq(columns.reshape(-1, 6), -distance.ravel(), rcond=None)[0]
        )
    return pose


def table_nodes(run, fraction=1):
    """Nodes of X, Y, Z, m, table_pitch / fraction apart."""
    nodes = []
    for spec in (run['machine']['axes'][axis] for axis in AXES):
        count = fraction * round((spec['max'] - spec['min']) / spec['table_pitch'])
        nodes.append(np.linspace(spec['min'], spec['max'], count + 1))
    return nodes


def piece_ends(start, end, nodes, size):
    """Ends of the pieces of a leg, m from its start: at all nodes, and ``size`` apart at most."""
    cuts = [(n - a) / (b - a) for n, a, b in zip(nodes, start, end, strict=True) if a != b]
    cuts = np.concatenate([*cuts, [0.0, 1.0]])
    cuts = np.unique(cuts[(cuts >= 0) & (cuts <= 1)].round(12)) * np.linalg.norm(end - start)
    parts = [
        np.linspace(a, b, int(np.ceil((b - a) / size)), endpoint=False) for a, b in pairwise(cuts)
    ]
    return np.append(np.concatenate(parts), cuts[-1])


def pieces_of(run, name):
    """Average the samples of a CSV file over path pieces; the pieces and their rigid pose."""
    stamp_ns, leg, xyz = read_samples(name)
    corners, config = np.array(run['corners']), run['config']
    step = np.diff(corners, axis=0)
    length = np.linalg.norm(step, axis=1)
    unit = step / length[:, None]
    rotation, translation = corner_pose(corners, leg, xyz)
    points = xyz @ rotation.T + translation
    along = np.einsum('ij,ij->i', points - corners[leg], unit[leg])
    margin = config['corner_exclusion']
    used = (along > margin) & (along < length[leg] - margin)
    time, found = (stamp_ns - stamp_ns[0]) * 1e-9, []
    for j in range(len(step)):
        ends = piece_ends(corners[j], corners[j + 1], table_nodes(run), config['piece_length'])
        place = np.searchsorted(ends, along)
        for k in range(1, len(ends)):
            own = np.flatnonzero(used & (leg == j) & (place == k))
            if len(own):
                scatter = np.cov(xyz[own].T, bias=True)
                found.append((xyz[own].mean(0), j, len(own), time[own].mean(), scatter))
    mean, number, count, middle, scatter = (np.array(v) for v in zip(*found, strict=True))
    duration = count * np.median(np.diff(stamp_ns)) * 1e-9
    origin, direction = corners[number], unit[number]
    pieces = Pieces(mean, number, origin, direction, count, middle, duration, 0.0 * middle)
    pose = rigid_pose(pieces, (rotation, translation))
    line = direction @ pose[0]
    spread = np.sqrt(np.einsum('ni,nij,nj->n', line, scatter, line))
    return replace(pieces, spread=spread), pose


def rows_of(machine, pieces, pose, error=None):
    """Rows at a pose, at those points of the path that ``error`` (n, 3) leads from, m."""
    points = pieces.xyz @ pose[0].T + pose[1]
    q = points
    for k in range(4 if error else 1):
        way = points - (error(q) if k else 0.0) - pieces.origin
        along = np.einsum('ij,ij->i', way, pieces.direction)
        q = pieces.origin + along[:, None] * pieces.direction
    seen = pieces.origin - pose[1]  # a line and the tracker lie in one plane
    first = seen - np.sum(seen * pieces.direction, axis=1)[:, None] * pieces.direction
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.concatenate([first, np.cross(pieces.direction, first)])
    piece = np.tile(np.arange(len(q)), 2)
    shift = pieces.spread[:, None] * pieces.direction
    ends = np.stack([q + shift, q - shift])
    chain, offset = machine['chain'], np.array(machine['target_offset'])
    influence = np.stack([influences(chain, offset, end)[piece] for end in ends])
    return Rows(
        axes,
        np.einsum('ri,ri->r', axes, (points - q)[piece]),
        piece,
        ends[:, piece],
        np.einsum('ri,erik->erk', axes, influence),
        -np.einsum('ri,rik->rk', axes, pose_columns(points)[piece]),
    )
