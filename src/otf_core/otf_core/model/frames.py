# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms between frames, and the frame of the beam of a tracker.

``T_machine_tracker`` takes tracker coordinates to machine coordinates; inner names cancel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.documents import Document, stated

XYZ = ('X', 'Y', 'Z')
"""Directions of a frame, as the components of its vectors are called."""


@dataclass(frozen=True)
class RigidTransform(Document):
    """A proper rotation followed by a translation: y = rotation @ x + translation."""

    rotation: Array = stated('proper rotation', shape=(3, 3))
    translation: Array = stated('translation', 'm', shape=(3,))

    def apply(self, points: Array) -> Array:
        """Transform points of shape (n, 3), m."""
        moved = self.rotate(points)
        for k, shift in enumerate(self.translation.tolist()):  # faster than all three together
            moved[..., k] += shift
        return moved

    def back(self, points: Array) -> Array:
        """Transform points (n, 3), m, of the target frame to the source frame."""
        return np.asarray((points - self.translation) @ self.rotation)

    def rotate(self, vectors: Array) -> Array:
        """Rotate free vectors of shape (n, 3)."""
        return np.asarray(vectors @ self.rotation.T)

    def moved_by(self, translation: Array, rotation_vector: Array) -> RigidTransform:
        """Apply a further small motion: rotation about the target frame's origin, then shift.

        Parameters
        ----------
        translation : ndarray, shape (3,), m
        rotation_vector : ndarray, shape (3,), rad
        """
        from scipy.spatial.transform import Rotation  # loaded on use: predicting needs none

        turn = Rotation.from_rotvec(rotation_vector).as_matrix()
        return RigidTransform(turn @ self.rotation, turn @ self.translation + translation)


def rigid_fit(source: Array, target: Array) -> RigidTransform:
    """Best rigid transform between paired points (Kabsch 1976), never a reflection.

    Parameters
    ----------
    source, target : ndarray, shape (n, 3), m
        At least three pairs that are not on one line.

    Returns
    -------
    RigidTransform
        Minimises the sum of squares of ``target - apply(source)``.
    """
    centre_source, centre_target = source.mean(axis=0), target.mean(axis=0)
    u, _, v = np.linalg.svd((target - centre_target).T @ (source - centre_source))
    turn = np.diag([1.0, 1.0, np.linalg.det(u @ v)])
    rotation = u @ turn @ v
    return RigidTransform(rotation, centre_target - rotation @ centre_source)


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
