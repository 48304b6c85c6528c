# SPDX-License-Identifier: Apache-2.0
"""The beam in the tracker's own spherical coordinates.

Azimuth H counts about the third axis of the tracker frame from its first, zenith angle V from the
third axis down; e_R, e_H, e_V point to growing range, azimuth and zenith angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import State


@dataclass(frozen=True)
class Beam:
    """Spherical coordinates of the target.

    Attributes
    ----------
    distance : ndarray, shape (n,), m
    sin_h, cos_h, sin_v, cos_v : ndarray, shape (n,)
    e_r, e_h, e_v : ndarray, shape (n, 3)
        Unit vectors in the machine frame.
    """

    distance: Array
    sin_h: Array
    cos_h: Array
    sin_v: Array
    cos_v: Array
    e_r: Array
    e_h: Array
    e_v: Array


def beam_of(state: State) -> Beam:
    """Return the beam of every point; straight up or down the azimuth counts as zero."""
    own = state.beam @ state.R_machine_tracker
    distance = np.linalg.norm(own, axis=1)
    level = np.hypot(own[:, 0], own[:, 1])
    upright = level < 1e-9 * distance
    safe = np.where(upright, 1.0, level)
    cos_h = np.where(upright, 1.0, own[:, 0] / safe)
    sin_h = np.where(upright, 0.0, own[:, 1] / safe)
    sin_v, cos_v = level / distance, own[:, 2] / distance
    e_h = np.stack([-sin_h, cos_h, np.zeros_like(sin_h)], axis=1)
    e_v = np.stack([cos_v * cos_h, cos_v * sin_h, -sin_v], axis=1)
    turn = state.R_machine_tracker.T
    e_r = state.beam / distance[:, None]
    return Beam(distance, sin_h, cos_h, sin_v, cos_v, e_r, e_h @ turn, e_v @ turn)
