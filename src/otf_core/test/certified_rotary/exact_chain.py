# SPDX-License-Identifier: Apache-2.0
"""Where a reflector is, by homogeneous matrices along the chain, all errors in their exact place.

Matrices may be complex: derivatives by errors are complex steps of the position.
"""

import json
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
MACHINE = json.loads((HERE / 'machine.json').read_text(encoding='utf-8'))
AXES = ('X', 'Y', 'Z', 'C')
SIX = 'XYZABC'
LOCATION = ('X0C', 'Y0C', 'A0C', 'B0C')
SCALARS = ('C0Y', 'B0Z', 'A0Z', *LOCATION)
NODES = {
    a: np.round(np.arange(s['min'], s['max'] + 1e-9, s['table_pitch']), 12)
    for a, s in MACHINE['axes'].items()
}


def small(six, centre=(0.0, 0.0, 0.0)):
    """Rigid displacement (t, r), rotation vector r about a centre, to third order."""
    x, y, z = six[3:]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    found = np.eye(4, dtype=np.result_type(cross, float))
    found[:3, :3] += cross + cross @ cross / 2 + cross @ cross @ cross / 6
    found[:3, 3] = six[:3] + centre - found[:3, :3] @ centre
    return found


def joint(axis, q, errors):
    """Transform of one axis at position q with its errors; C carries the table, X Y Z the tool."""
    six = np.array([errors.get((f'E{d}{axis}', 'at'), 0.0) for d in SIX])
    if axis == 'C':
        centre = np.array(MACHINE['axes']['C']['centre'])
        c, s = np.cos(q), np.sin(q)
        move = np.eye(4)
        move[:3, :3] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        move[:3, 3] = centre - move[:3, :3] @ centre
        x, y, a, b = (errors.get((name, 'at'), 0.0) for name in LOCATION)
        line = small(np.array([x, y, 0, a, b, 0]), centre)
        return line @ move @ np.linalg.inv(line) @ small(six, centre)
    tilt = {'X': [0, 0, 0], 'Y': [-errors.get(('C0Y', 'at'), 0.0), 0, 0],
            'Z': [errors.get(('B0Z', 'at'), 0.0), -errors.get(('A0Z', 'at'), 0.0), 0]}  # fmt: skip
    travel = np.array(tilt[axis]) + np.eye(3)['XYZ'.index(axis)]
    move = np.eye(4, dtype=travel.dtype)
    move[:3, 3] = q * travel
    return move @ small(six)


def position(q, link, place, errors):
    """Reflector on the table (link w) or in the spindle (t) seen from the bed, shape (3,), m."""
    point = np.append(place, 1.0)
    if link == 'w':
        return (np.linalg.inv(joint('C', q[3], errors)) @ point)[:3]
    return (
        joint('X', q[0], errors) @ joint('Y', q[1], errors) @ joint('Z', q[2], errors) @ point
    )[:3]


def at_position(tables, q):
    """Errors of all axes at one position from tables at the nodes and scalars."""
    found = {(name, 'at'): tables[name] for name in SCALARS}
    for k, axis in enumerate(AXES):
        for d in SIX:
            name = f'E{d}{axis}'
            found[name, 'at'] = np.interp(q[k], NODES[axis], tables[name])
    return found
