# SPDX-License-Identifier: Apache-2.0
"""Tables of the stops by dense least squares.

``python3 -m certified_rotary.dense`` writes expected.json.

Rows are the three coordinates of every stop with the inverse of their covariance, columns complex
steps of the exact chain; what the gauge sets to zero is left out; pose and places are moved until
they stand still; at last the line of C is fitted and taken over into its location errors.
"""

import json

import numpy as np
from certified_rotary.exact_chain import AXES, HERE, MACHINE, NODES, SCALARS, SIX, position

SAMPLES, STEP = 500, 1e-25
SIZE = {'translation': 5e-5, 'rotation': 1e-4}
"""m and rad; standard deviation of node values and scalars before any data."""
NAMES = [(f'E{d}{a}', k) for a in AXES for d in SIX for k in range(len(NODES[a]))]
NAMES = [(s, 0) for s in SCALARS] + NAMES
NESTS = [n for n, t in MACHINE['targets'].items() if t['u'] > 0.0]


def is_fixed(name, node):
    """Tell whether the gauge sets a node to zero."""
    at, ends = NODES[name[-1]], (0, len(NODES[name[-1]]) - 1)
    straightness = name[0] == 'E' and name[1] in 'XYZ' and name[2] in 'XYZ' and name[1] != name[2]
    return name[0] == 'E' and (node in ends if straightness else abs(at[node]) < 1e-12)


USED = np.array([not is_fixed(*n) for n in NAMES])


def columns(q, link, place):
    """Derivatives (3, m) of the position by node values and scalars."""
    found = np.zeros((3, len(NAMES)))
    for j, (name, node) in enumerate(NAMES):
        axis, share = name[-1], 1.0
        if name[0] == 'E':
            share = np.interp(q[AXES.index(axis)], NODES[axis], np.eye(len(NODES[axis]))[node])
        if USED[j] and share:
            errors = {(name, 'at'): 1j * STEP}
            found[:, j] = share * position(q, link, place, errors).imag / STEP
    return found


def read_stops(name):
    """Targets, axis positions (n, 4) and measured points (n, 3)."""
    lines = [row.split(',') for row in (HERE / name).read_text(encoding='utf-8').split()[1:]]
    values = np.array([row[1:] for row in lines], dtype=float)
    return [row[0] for row in lines], values[:, :4], values[:, 4:]


def solve(name, start):
    """Values of scalars and nodes (m,), their covariance, places of the nests."""
    targets, q, seen = read_stops(name)
    turn, stand = np.array(start['rotation']), np.array(start['translation'])
    links = {n: t['link'] for n, t in MACHINE['targets'].items()} | {'tool': 't'}
    places = {n: np.array(t['place']) for n, t in MACHINE['targets'].items()}
    stated = {n: places[n].copy() for n in NESTS}
    places['tool'] = np.array(MACHINE['target_offset'])
    sd = np.array(
        [SIZE['translation' if n[0][n[0][0] == 'E'] in 'XYZ' else 'rotation'] for n in NAMES]
    )
    count = len(NAMES)
    for _ in range(6):
        weight = np.zeros((count + 6 + 3 * len(NESTS),) * 2)
        right = np.zeros(len(weight))
        for target, at, xyz in zip(targets, q, seen, strict=True):
            link, point = links[target], turn @ xyz + stand
            nominal = position(at, link, places[target], {})
            row = np.zeros((3, len(weight)))
            row[:, :count] = columns(at, link, places[target])
            row[:, count : count + 3] = -np.eye(3)
            row[:, count + 3 : count + 6] = -np.cross(np.eye(3), point).T
            if target in NESTS:
                own = count + 6 + 3 * NESTS.index(target) + np.arange(3)
                shift = [position(at, link, places[target] + e, {}) - nominal for e in np.eye(3)]
                row[:, own] = np.array(shift).T
            size = np.linalg.norm(xyz)
            beam = np.outer(turn @ xyz, turn @ xyz) / size**2
            u_range, u_angle = MACHINE['tracker']['u_range'], MACHINE['tracker']['u_angle']
            cover = (u_range**2 * beam + (u_angle * size) ** 2 * (np.eye(3) - beam)) / SAMPLES
            weight += row.T @ np.linalg.solve(cover, row)
            right += row.T @ np.linalg.solve(cover, point - nominal)
        prior = np.append(sd**-2.0, np.zeros(6 + 3 * len(NESTS)))
        for k, nest in enumerate(NESTS):
            own, u = count + 6 + 3 * k + np.arange(3), MACHINE['targets'][nest]['u']
            prior[own] = u**-2.0
            right[own] += (stated[nest] - places[nest]) / u**2
        use = np.append(USED, np.ones(6 + 3 * len(NESTS), dtype=bool))
        weight, value = weight + np.diag(prior), np.zeros(len(weight))
        scale = 1.0 / np.sqrt(np.diag(weight)[use])
        inverse = (
            scale[:, None]
            * np.linalg.inv(scale[:, None] * weight[np.ix_(use, use)] * scale)
            * scale
        )
        value[use] = inverse @ right[use]
        stand, turn = moved(stand, turn, value[count : count + 6])
        for k, nest in enumerate(NESTS):
            places[nest] = places[nest] + value[count + 6 + 3 * k : count + 9 + 3 * k]
    cover = np.zeros((count, count))
    cover[np.ix_(USED, USED)] = inverse[: USED.sum(), : USED.sum()]
    return value[:count], cover, {n: places[n] for n in NESTS}


def moved(stand, turn, step):
    """Pose after a small motion: translation, then rotation vector about the origin."""
    angle = np.linalg.norm(step[3:])
    x, y, z = step[3:] / max(angle, 1e-300)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    extra = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return extra @ stand + step[:3], extra @ turn


def line_of_c():
    """Matrix (m, m) that takes the least-squares line of C out of its motions."""
    matrix, at = np.eye(len(NAMES)), NODES['C']
    place = {n: j for j, n in enumerate(NAMES)}
    c, s, one, zero = np.cos(at), np.sin(at), np.ones(len(at)), np.zeros(len(at))
    for first, second, names in (('EXC', 'EYC', ('X0C', 'Y0C')), ('EAC', 'EBC', ('A0C', 'B0C'))):
        own = [place[m, k] for m in (first, second) for k in range(len(at))]
        # table side: R^-1 D - D, R^-1 the turn by -c
        shape = np.block([[c - 1.0, s], [-s, c - 1.0]]).reshape(2, 2, -1).transpose(0, 2, 1)
        shape = shape.reshape(-1, 2)
        level = np.stack([np.append(one, zero), np.append(zero, one)], axis=1)
        line = np.linalg.lstsq(np.hstack([shape, level]), np.eye(len(shape)), rcond=None)[0][:2]
        rest = np.eye(len(shape)) - shape @ line
        matrix[np.ix_(own, own)] = rest - level @ rest[[0, len(at)]]
        for name, part in zip(names, line, strict=True):
            matrix[place[name, 0], own] = part
    return matrix


def tables(name, start):
    """Certified values: scalars, motions and places with their uncertainties."""
    value, cover, places = solve(name, start)
    gauge = line_of_c()
    value, u = gauge @ value, np.sqrt(np.maximum(np.diag(gauge @ cover @ gauge.T), 0.0))
    said = {}
    for j, (label, _) in enumerate(NAMES):
        own = said.setdefault(label, {'value': [], 'u': []})
        own['value'].append(value[j])
        own['u'].append(u[j])
    return said | {n: {'value': p.tolist()} for n, p in places.items()}


if __name__ == '__main__':
    begin = json.loads((HERE / 'truth.json').read_text(encoding='utf-8'))['start']
    found = {name: tables(f'{name}.csv', begin) for name in ('stops', 'exact')}
    text = json.dumps(found, indent=1, default=float)
    (HERE / 'expected.json').write_text(text + '\n', encoding='utf-8')
