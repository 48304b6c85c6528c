# SPDX-License-Identifier: Apache-2.0
"""Machine programs that differ from the published path, driven by a nature (``nature.Cell``).

A program is a list of corner points. It is driven by blocks: chords that turn gently from one to
the next are driven through at the feed, any sharper corner is a stop, unless corners are rounded.
Nothing of the project's drive or planner is used.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from nature_tracker import Noise

from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.pieces.runs import Recording

STOP_ANGLE = np.radians(35.0)
ACCELERATION = 1.5
AWAY = np.array([0.02, -0.03, 0.07])


def programs(corners):
    """Ways to drive a path of corner points otherwise: name to points."""

    def aborted(stop, back):  # leg 14 is driven to a share of it, back to another, and on
        part = [(1 - s) * corners[14] + s * corners[15] for s in (stop, back)]
        return np.concatenate([corners[:15], part, corners[15:]])

    middle = 0.5 * (corners[24] + corners[25])
    return {
        'twice': np.concatenate([corners, corners[1:]]),
        'three times': np.concatenate([corners, corners[1:], corners[1:]]),
        'twice with a retract': np.concatenate(
            [corners, [corners[-1] + AWAY, corners[0] + 2 * AWAY], corners]
        ),
        'a part again': np.concatenate([corners[:25], corners[10:]]),
        'restarted from an earlier corner': np.concatenate(
            [corners[:25], [middle, middle + AWAY, corners[10] + AWAY], corners[10:]]
        ),
        'forth and back': np.concatenate([corners, corners[::-1][1:]]),
        'only backward': corners[::-1],
        'the last third backward once more': np.concatenate(
            [corners, corners[::-1][1 : len(corners) // 3]]
        ),
        'a corner skipped': np.delete(corners, [12], axis=0),
        'four corners skipped': np.delete(corners, [8, 16, 17, 30], axis=0),
        'legs left out': np.concatenate([corners[:10], corners[16:]]),
        'a leg aborted, driven back and again': aborted(0.6, 0.0),
        'a leg aborted, half driven back': aborted(0.6, 0.3),
        'approach and retract': np.concatenate(
            [[corners[0] + 2 * AWAY, corners[0] + AWAY], corners, corners[-1:] + AWAY]
        ),
    }


def arc(centre, first, second, radius, begin, end, chord=1e-3):
    """Points of an arc in the plane of two unit vectors, chords of about the given length, m."""
    count = max(2, int(np.ceil(radius * abs(end - begin) / chord)))
    angle = np.linspace(begin, end, count + 1)
    first, second = np.asarray(first, float), np.asarray(second, float)
    return (
        np.asarray(centre, float)
        + radius * np.cos(angle)[:, None] * first
        + radius * np.sin(angle)[:, None] * second
    )


def helix(centre, radius, pitch, turns, chord=1e-3):
    """Points of a helix about Z that starts at the height of its centre."""
    flat = arc(centre, (1, 0, 0), (0, 1, 0), radius, 0.0, 2 * np.pi * turns, chord)
    flat[:, 2] += np.linspace(0.0, pitch * turns, len(flat))
    return flat


def rounded(points, reach):
    """Replace corners by arcs that touch both lines ``reach`` m before and after the corner."""
    result = [points[:1]]
    for before, corner, after in zip(points[:-2], points[1:-1], points[2:], strict=True):
        u, v = corner - before, after - corner
        part = min(reach, 0.45 * np.linalg.norm(u), 0.45 * np.linalg.norm(v))
        u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
        half = 0.5 * np.arccos(np.clip(u @ v, -1, 1))
        if half > 1.5:  # there and back: no arc, a stop
            result.append(corner[None])
            continue
        radius = part / np.tan(half)
        normal = (v - (v @ u) * u) / np.linalg.norm(v - (v @ u) * u)
        angle = np.linspace(0.0, 2 * half, max(4, int(np.degrees(2 * half) / 2)))
        start = corner - part * u
        sine, rest = np.sin(angle)[:, None], 1.0 - np.cos(angle)[:, None]
        result.append(start + radius * (sine * u + rest * normal))
    return np.concatenate([*result, points[-1:]])


def blocks(points):
    """Split points where the direction turns by more than STOP_ANGLE."""
    points = points[np.concatenate([[True], np.any(np.diff(points, axis=0) != 0, axis=1)])]
    step = np.diff(points, axis=0)
    unit = step / np.linalg.norm(step, axis=1, keepdims=True)
    turn = np.arccos(np.clip(np.sum(unit[1:] * unit[:-1], axis=1), -1, 1))
    cuts = [0, *(np.flatnonzero(turn > STOP_ANGLE) + 1), len(points) - 1]
    return [points[a : b + 1] for a, b in pairwise(cuts)]


def drive(points, feed=0.15, dwell=0.15, rate=200.0):
    """Programmed positions (n, 3) at the rate: trapezoidal speed over each block, then a stop."""
    parts = [np.repeat(points[:1], int(rate), axis=0)]
    for block in blocks(points):
        done = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(block, axis=0), axis=1))])
        top = min(feed, np.sqrt(ACCELERATION * done[-1]))
        ramp = top / ACCELERATION
        total = done[-1] / top + ramp
        t = np.arange(1, int(total * rate) + 1) / rate
        left = total - t
        way = np.where(
            t < ramp,
            0.5 * ACCELERATION * t**2,
            np.where(left < ramp, done[-1] - 0.5 * ACCELERATION * left**2, top * (t - 0.5 * ramp)),
        )
        parts.append(np.stack([np.interp(way, done, block[:, k]) for k in range(3)], axis=1))
        parts.append(np.repeat(block[-1:], max(1, int(dwell * rate)), axis=0))
    return np.concatenate([*parts, np.repeat(points[-1:], int(rate), axis=0)])


def held(q, rate, *places, seconds=2.0):
    """Feed hold at shares of the run: stand still in no time, then go on."""
    for place in sorted(places, reverse=True):
        k = int(place * len(q))
        still = np.repeat(q[k : k + 1], int(seconds * rate), axis=0)
        q = np.concatenate([q[:k], still, q[k:]])
    return q


def record(cell, q, published=None, rate=200.0, seed=0):
    """Recording of programmed positions by a nature; the path is the cell's unless told."""
    spec = cell.machine.tracker
    rng = np.random.default_rng([31, cell.seed, seed])
    noise = Noise(u_range=spec.u_range, u_angle=spec.u_angle)
    xyz = cell.measured(cell.position(q), noise, 1 / rate, rng)
    stamp = 1_700_000_000_000_000_000 + np.rint(np.arange(len(q)) / rate * 1e9).astype(np.int64)
    path = cell.path if published is None else NominalPath(np.asarray(published, float))
    return Recording(Samples(stamp, xyz), path, cell.machine)


def without(recording, *spans):
    """Recording without the samples between shares of its length."""
    keep = np.ones(len(recording.samples), bool)
    for low, high in spans:
        keep[int(low * len(keep)) : int(high * len(keep))] = False
    samples = recording.samples
    return replace(recording, samples=Samples(samples.stamp_ns[keep], samples.xyz[keep]))
