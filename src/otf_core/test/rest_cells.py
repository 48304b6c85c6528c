# SPDX-License-Identifier: Apache-2.0
"""A target at rest seen by a tracker whose three components of noise are drawn here."""

import numpy as np
from core_cells import START_NS
from nature_tracker import beam_frame, coloured

from otf_core.model.observation import Samples


def spoiled(xyz, rate, rng, level, white=(0.5, 0.5, 0.5), tau=0.3, dof=(None, None, None)):
    """Points (n, 3) with noise of range, horizontal and vertical angle; white: variance share."""
    distance = np.linalg.norm(xyz, axis=1)
    off = np.zeros_like(xyz)
    for k, direction in enumerate(beam_frame(xyz)):
        reach = distance if k else 1.0
        series = coloured(rng, len(xyz), 1.0 / rate, 1.0 - white[k], tau, dof[k])
        off += (level[k] * reach * series)[:, None] * direction
    return xyz + off


def at_rest(stops, seconds, rate, seed, level, **noise):
    """Samples of a target that stops at places around a metre away and moves on quickly."""
    rng, rows = np.random.default_rng(seed), []
    for _ in range(stops):
        place = np.array([1.0, 0.8, 0.2]) + rng.uniform(-0.3, 0.3, 3)
        rows.append(np.tile(place, (round(seconds * rate), 1)))
        rows.append(place + np.linspace(0.01, 0.1, max(4, round(0.3 * rate)))[:, None])
    xyz = spoiled(np.concatenate(rows), rate, rng, level, **noise)
    return Samples(START_NS + np.rint(np.arange(len(xyz)) / rate * 1e9).astype(np.int64), xyz)
