# SPDX-License-Identifier: Apache-2.0
"""Where the target is, by rotation matrices along the chain, and its derivatives by the errors.

Frames and signs are those of docs/conventions.md. A link of the target side is travel, then
error; of the table side error, then travel. The error of an axis turns by Rz(C) Ry(B) Rx(A) and
then shifts. The derivatives are taken at zero errors by complex steps, Im f(ih) / h: a finite
difference that loses no digits, since nothing is subtracted (Squire and Trapp, SIAM Review 40
(1998) 110).
"""

import numpy as np

AXES = 'XYZ'
MOTIONS = [f'E{direction}{axis}' for axis in AXES for direction in 'XYZABC']
SQUARENESS = ['C0Y', 'B0Z', 'A0Z']
STEP = 1e-30


def turned(angles, points):
    """Points (n, 3) turned by Rz(C) Ry(B) Rx(A), angles (n, 3) being A, B, C in rad."""
    (sa, sb, sc), (ca, cb, cc) = np.sin(angles).T, np.cos(angles).T
    x, y, z = points.T
    y, z = ca * y - sa * z, sa * y + ca * z
    x, z = cb * x + sb * z, cb * z - sb * x
    x, y = cc * x - sc * y, sc * x + cc * y
    return np.stack([x, y, z], axis=1)


def travel_directions(squareness):
    """Unit vectors (n, 3) of the travel of X, Y, Z; X is primary. C0Y, B0Z, A0Z as (n, 3)."""
    c0y, b0z, a0z = squareness.T
    zero, one = np.zeros_like(c0y), np.ones_like(c0y)
    return {
        'X': np.stack([one, zero, zero], axis=1),
        'Y': np.stack([-np.sin(c0y), np.cos(c0y), zero], axis=1),
        'Z': np.stack(
            [np.sin(b0z), -np.sin(a0z) * np.cos(b0z), np.cos(a0z) * np.cos(b0z)], axis=1
        ),
    }


def target_on_table(chain, offset, q, errors):
    """Target relative to the table less the offset, (n, 3), m.

    chain: such as w-Y-b-X-Z-t. offset: (3,), m. q: axis positions (n, 3), m. errors: values of
    MOTIONS and SQUARENESS at every point, (n, 21), m and rad.
    """
    links = chain.split('-')[1:-1]
    directions = travel_directions(errors[:, 18:])
    point = np.tile(offset, (len(q), 1)).astype(errors.dtype)
    for place in reversed(range(len(links))):
        axis = links[place]
        if axis == 'b':
            continue
        k = AXES.index(axis)
        travel = q[:, k, None] * directions[axis]
        shift, angles = errors[:, 6 * k : 6 * k + 3], errors[:, 6 * k + 3 : 6 * k + 6]
        if place < links.index('b'):
            point = turned(angles, point + travel) + shift
        else:
            point = turned(angles, point) + shift + travel
    return point - offset


def influences(chain, offset, q):
    """Derivatives of the target's position by MOTIONS and SQUARENESS, (n, 3, 21)."""
    errors = 1j * STEP * np.repeat(np.eye(21), len(q), axis=0)
    points = target_on_table(chain, offset, np.tile(q, (21, 1)), errors)
    return (points.imag / STEP).reshape(21, len(q), 3).transpose(1, 2, 0)
