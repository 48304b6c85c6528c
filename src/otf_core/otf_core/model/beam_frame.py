# SPDX-License-Identifier: Apache-2.0
"""The beam and the two directions across it, in the tracker's own frame.

The horizontal angle turns the beam about the third axis of the frame, the vertical one lifts it.
Both are counted as angles of the beam itself: a small angle moves the target by angle x range.
"""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array


def beam_frame(xyz: Array) -> tuple[Array, Array, Array, Array]:
    """Range and the three unit vectors at every point.

    Parameters
    ----------
    xyz : ndarray, shape (n, 3), m
        Points in the tracker frame.

    Returns
    -------
    distance : ndarray, shape (n,), m
    along, horizontal, vertical : ndarray, shape (n, 3)
        Right-handed; straight up or down the azimuth counts as zero.
    """
    distance = np.linalg.norm(xyz, axis=1)
    along = xyz / distance[:, None]
    level = np.hypot(xyz[:, 0], xyz[:, 1])
    upright = level < 1e-9 * distance
    horizontal = np.stack([-xyz[:, 1], xyz[:, 0], np.zeros_like(level)], axis=1)
    horizontal /= np.where(upright, 1.0, level)[:, None]
    horizontal[upright] = [0.0, 1.0, 0.0]
    return distance, along, horizontal, np.cross(along, horizontal)
