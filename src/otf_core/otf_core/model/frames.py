# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms between frames.

``T_machine_tracker`` takes tracker coordinates to machine coordinates; inner names cancel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array

XYZ = ('X', 'Y', 'Z')
"""Directions of a frame, as the components of its vectors are called."""


@dataclass(frozen=True)
class RigidTransform:
    """A proper rotation followed by a translation: y = rotation @ x + translation.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,), m
    """

    rotation: Array
    translation: Array

    def apply(self, points: Array) -> Array:
        """Transform points of shape (n, 3), m."""
        moved = self.rotate(points)
        for k, shift in enumerate(self.translation.tolist()):  # faster than all three together
            moved[..., k] += shift
        return moved

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
