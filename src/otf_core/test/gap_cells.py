# SPDX-License-Identifier: Apache-2.0
"""Synthetic runs for tests of where a gap lies and of its report: plain arrays, no simulation."""

from itertools import pairwise, product

import numpy as np

from otf_core.diagnosis.place.groups import RunView
from otf_core.diagnosis.place.where import where_and_shape
from otf_core.model.frames import XYZ
from otf_core.noise.noise_model import path_frame

TRACKER = np.array([-0.8, -0.5, 0.3])
SIZE = np.array([0.6, 0.5, 0.4])
NOISE = 5e-7


def corner_list(laps=2):
    """Lines along the axes at two levels of the others, and diagonals; every second lap back."""
    lap = []
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        for k, levels in enumerate(product((0.0, 1.0), repeat=2)):
            ends = np.zeros((2, 3))
            ends[:, others] = levels
            ends[(k + 1) % 2, axis] = 1.0
            lap.extend(ends)
    for a, b in product((0.0, 1.0), repeat=2):
        lap += [np.array([0.0, a, b]), np.array([1.0, 1.0 - a, 1.0 - b])]
        lap += [np.array([a, 0.0, b]), np.array([a, 1.0, 1.0 - b])]
    points = np.array(lap) * SIZE
    points = points[np.r_[True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6]]
    return np.concatenate([points[:: 1 - 2 * (k % 2)][int(k > 0) :] for k in range(laps)])


def pieces_of(corners, feed, ratio, step=0.008):
    """Time, leg, q, direction, speed of pieces along a path whose second half is slower."""
    rows, now = [], 2.0
    for leg, (a, b) in enumerate(pairwise(corners)):
        length = np.linalg.norm(b - a)
        unit = (b - a) / length
        speed = feed * (ratio if leg >= len(corners) // 2 else 1.0)
        along = np.arange(step, length - step, step) + 0.5 * step
        rows += [(now + s / speed, leg, *(a + s * unit), *unit, speed) for s in along]
        now += length / speed + 0.3
    table = np.array(rows)
    return table[:, 0], table[:, 1].astype(int), table[:, 2:5], table[:, 5:8], table[:, 8]


def correlated(view_time, leg, rng, size, tau=0.3):
    """Gauss-Markov noise of unit time constant tau, shape (2, p), m."""
    apart, same = np.diff(view_time, prepend=0.0), np.diff(leg, prepend=leg[0] - 1) == 0
    rho = np.where(same, np.exp(-apart / tau), 0.0)
    noise = rng.normal(size=(len(view_time), 2)) * size * np.sqrt(1 - rho**2)[:, None]
    for k in np.flatnonzero(same):
        noise[k] += rho[k] * noise[k - 1]
    return noise.T.copy()


def run_view(
    gap=None, seed=1, name='run', noise=NOISE, laps=2, feed=0.25, ratio=0.6, after=None, more=()
):
    """A run whose residual is noise and the displacement ``gap(view)``, shape (p, 3), m.

    ``more``: corners that are driven after the others, in shares of the volume.
    """
    corners = np.concatenate([corner_list(laps), np.reshape(more, (-1, 3)) * SIZE])
    time, leg, q, direction, speed = pieces_of(corners, feed, ratio)
    beam = q - TRACKER
    axes = np.stack(path_frame(direction, beam / np.linalg.norm(beam, axis=1)[:, None]))
    rng = np.random.default_rng(seed)
    pure = correlated(time, leg, rng, noise)
    parts = (time, leg, q, direction, speed, beam, axes)
    empty = RunView(name, XYZ, *parts, pure, pure, np.full(pure.shape, NOISE))
    if gap is None:
        return empty
    before = pure + np.einsum('cpk,pk->cp', axes, gap(empty))
    rest = pure if after is None else pure + np.einsum('cpk,pk->cp', axes, after(empty))
    return RunView(name, XYZ, *parts, before, rest, empty.expected)


def along(axis, size):
    """Displacement of given sizes, shape (p,), along one machine axis (0 to 2)."""
    return np.asarray(size)[:, None] * np.eye(3)[axis]


def where_of(views):
    """Where the gap of runs lies."""
    return where_and_shape(views)[0]
