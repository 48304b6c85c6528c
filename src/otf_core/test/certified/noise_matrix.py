# SPDX-License-Identifier: Apache-2.0
"""Covariance of all rows of the run, docs/formulation.md sections 7 and 12.

Noise that is correlated over tau as exp(-|t - s| / tau), averaged over windows of lengths D, D'
whose centres lie g apart: exp(-g / tau) S(D) S(D'), S(D) = sinh(D / 2 tau) / (D / 2 tau); over one
window 2 (x - 1 + exp(-x)) / x^2, x = D / tau.
"""

import numpy as np

LASTING = 3.0
"""s; tau of the misfit that the pieces of a line share."""


def means_of_slow_noise(pieces, tau):
    """Covariance (p, p) of the means over all pieces of noise of unit variance."""
    x = pieces.duration / tau
    weight = np.sinh(0.5 * x) / (0.5 * x)
    apart = np.abs(pieces.time[:, None] - pieces.time) / tau
    matrix = np.exp(-apart) * np.outer(weight, weight)
    matrix[np.diag_indices_from(matrix)] = 2.0 * (x - 1.0 + np.exp(-x)) / x**2
    return matrix


def noise_matrices(rows, pieces, points, rotation, tracker, noise):
    """Covariance of the rows, (r, r) in m^2: noise of the tracker, misfit; then what is left.

    The first two hold between rows along the same of a2 and a3 on one line: the weights are made
    of them. The other two are what noise and misfit share otherwise. ``points`` (p, 3) of the
    pieces are in the frame of the tracker, from which ``rotation`` leads to the machine.
    ``noise``: white and slow variance over the variance specified for the ``tracker``, time
    constant of the slow part (s), misfit of every piece and of whole lines (m).
    """
    piece, reach = rows.piece, np.linalg.norm(points, axis=1)
    beam = points / reach[:, None]
    level = np.hypot(beam[:, 0], beam[:, 1])
    azimuth = np.stack([-beam[:, 1], beam[:, 0], 0.0 * level], axis=1) / level[:, None]
    along, beside, above = (
        np.sum(rows.axes * (v @ rotation.T)[piece], axis=1)
        for v in (beam, azimuth, np.cross(beam, azimuth))
    )
    of_range, of_angle = tracker['u_range'] * along, tracker['u_angle'] * reach[piece]
    one_line = pieces.leg[piece][:, None] == pieces.leg[piece]
    component = np.repeat([0, 1], len(reach))
    alike = one_line & (component[:, None] == component)
    slow = noise['slow'] * means_of_slow_noise(pieces, noise['correlation_time'])
    lasting = noise['misfit_line'] ** 2 * means_of_slow_noise(pieces, LASTING)
    slow, lasting = slow[np.ix_(piece, piece)], lasting[np.ix_(piece, piece)]
    shares = (of_range, of_angle * beside, of_angle * above)
    shared = sum(np.outer(v, v) for v in shares)
    white = noise['white'] * (piece[:, None] == piece) / pieces.count[piece]
    whole = (white + slow) * shared
    own = alike * whole
    misfit = noise['misfit_piece'] ** 2 * np.eye(len(piece)) + alike * lasting
    return own, misfit, whole - own, ~one_line * lasting * (rows.axes @ rows.axes.T)
