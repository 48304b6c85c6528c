# SPDX-License-Identifier: Apache-2.0
"""The same least squares for long runs: weights line by line, next to no prior, known noise.

What it leaves is what the noise of a run makes inevitable but for smoothness: the expected error.
"""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
from certified.error_model import ErrorModel
from certified.measured_rows import Pieces, moved, rows_of
from certified.noise_matrix import noise_matrices

STEPS = 3


def white_roots(rows, pieces, rotation, tracker, noise):
    """Rows of every line and the inverse root of the covariance of their noise."""
    found = []
    for leg in np.unique(pieces.leg):
        own = np.flatnonzero(pieces.leg == leg)
        part = Pieces(*(getattr(pieces, field.name)[own] for field in fields(Pieces)))
        both = np.concatenate([own, own + len(pieces.leg)])
        line = SimpleNamespace(axes=rows.axes[both], piece=np.tile(np.arange(len(own)), 2))
        noises = noise_matrices(line, part, part.xyz, rotation, tracker, noise)
        found.append((both, np.linalg.inv(np.linalg.cholesky(noises[0] + noises[1]))))
    return found


def solve_by_lines(run, pieces, pose, nodes, noise):
    """Model of straight tables over ``nodes``, its free values, and their covariance."""
    model, machine = ErrorModel(run, nodes, 1), run['machine']
    prior, rows = model.tie_breaker(), rows_of(machine, pieces, pose)
    roots = white_roots(rows, pieces, pose[0], machine['tracker'], noise)
    for step in range(STEPS):
        design, normal = model.design(rows), prior.T @ prior
        right = np.zeros(len(normal))
        for both, root in roots:
            white = root @ design[both]
            normal += white.T @ white
            right += white.T @ (root @ rows.deviation[both])
        covariance = np.linalg.inv(normal)
        value = covariance @ right
        if step < STEPS - 1:
            pose, own = moved(pose, value[:6]), np.append(np.zeros(6), value[6:])
            rows = rows_of(machine, pieces, pose, lambda q, x=own: model.error_rows(q) @ x)
    return model, value, covariance
