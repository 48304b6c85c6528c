# SPDX-License-Identifier: Apache-2.0
"""How the run was made; ``python3 -m certified.make_run`` writes run.json and the CSV files anew.

A machine whose error motions are straight between nodes is driven along 24 lines with three
samples at rest at every corner and one every 20 mm or so, 25 a second. Actual positions are those
of the exact chain, X has play besides; the tracker's noise is half white, half slow (0.3 s).
twin.csv is the simulation of the same run: the same machine without the play, other noise. All
coordinates are rounded to 1 nm.
"""

import json

import numpy as np
from certified.exact_chain import AXES, MOTIONS, SQUARENESS, target_on_table
from certified.measured_rows import HERE, rotation_of

SEED, TWIN_SEED = 20231, 20232
INTERVAL_NS, START_NS = 40_000_000, 1_700_000_000_000_000_000
LENGTH, OFFSET = 0.02, 0.37
"""m from sample to sample; share of it from a corner to the first of a line."""
PLAY = 6e-6
"""m; X is off by half of it to either side."""
TRACKER = ([0.4, -1.1, 2.0], [0.55, -0.6, 0.12])
"""Rotation vector of machine coordinates into those of the tracker, and its place, m."""
LOW, HIGH = np.array([0.0, -0.08, -0.15]), np.array([0.27, 0.16, 0.0])
CORNERS = """000 100 110 010 000 110 111 011 001 101 111 001 100 101 010 011 100 000 101 110 011
000 111 010 101"""
RUN = {
    'machine': {
        'name': 'certified',
        'chain': 'w-Y-b-X-Z-t',
        'axes': {
            'X': {'min': 0.0, 'max': 0.27, 'table_pitch': 0.09},
            'Y': {'min': -0.08, 'max': 0.16, 'table_pitch': 0.08},
            'Z': {'min': -0.15, 'max': 0.0, 'table_pitch': 0.075},
        },
        'target_offset': [0.02, -0.03, -0.15],
        'tracker': {'u_range': 0.5e-6, 'u_angle': 2.0e-6},
    },
    'not_identifiable': ['ECX', 'EAZ', 'EBZ', 'ECZ'],
    'config': {
        'corner_exclusion': 0.04,
        'piece_length': 0.1,
        'alignment_stop': 1e-12,
        'reversal': 'none',
        'outlier_limit': 100.0,
    },
    'given': {
        'noise': {
            'white': 0.65,
            'slow': 0.4,
            'correlation_time': 0.2,
            'misfit_piece': 1e-7,
            'misfit_line': 3e-7,
        },
        'specified': {
            'white': 0.5,
            'slow': 0.5,
            'correlation_time': 0.3,
            'misfit_piece': 5e-8,
            'misfit_line': 0.0,
        },
        'roughness': {'translations': [4e-10, 0.3, 1e-10], 'rotations': [4e-9, 0.2, 1e-9]},
    },
}


def nodes_of(axis):
    """Nodes of an axis, m."""
    spec = RUN['machine']['axes'][axis]
    count = round((spec['max'] - spec['min']) / spec['table_pitch'])
    return np.linspace(spec['min'], spec['max'], count + 1)


def drive(corners):
    """Legs (n,), programmed positions (n, 3) and directions of travel (n, 3) of all samples."""
    legs, positions, travels = [], [], []
    for j, step in enumerate(np.diff(corners, axis=0)):
        count = int(np.linalg.norm(step) / LENGTH)
        share = np.concatenate([np.zeros(3), (np.arange(count) + OFFSET) / count])
        legs.append(np.full(len(share), j))
        positions.append(corners[j] + share[:, None] * step)
        travels.append(np.sign(step) * (share > 0)[:, None])
    return tuple(np.concatenate(v) for v in (legs, positions, travels))


def measured(points, seed):
    """Points (n, 3) in the frame of the tracker with its noise, m."""
    rng, n = np.random.default_rng(seed), len(points)
    spec, decay = RUN['machine']['tracker'], np.exp(-INTERVAL_NS * 1e-9 / 0.3)
    noise = np.zeros((n, 3))
    slow = rng.standard_normal(3)
    for k in range(n):
        noise[k] = np.sqrt(0.5) * (slow + rng.standard_normal(3))
        slow = decay * slow + np.sqrt(1 - decay**2) * rng.standard_normal(3)
    xyz = (points - TRACKER[1]) @ rotation_of(np.array(TRACKER[0])).T
    reach, level = np.linalg.norm(xyz, axis=1), np.hypot(xyz[:, 0], xyz[:, 1])
    azimuth = np.stack([-xyz[:, 1], xyz[:, 0], 0 * level], axis=1) / level[:, None]
    beam = xyz / reach[:, None]
    sideways = azimuth * noise[:, 1:2] + np.cross(beam, azimuth) * noise[:, 2:]
    xyz += spec['u_range'] * beam * noise[:, :1] + spec['u_angle'] * reach[:, None] * sideways
    return np.round(xyz, 9)


def write_samples(name, legs, xyz):
    """Write a CSV file: stamp, leg driven, point in the frame of the tracker."""
    rows = ['stamp_ns,leg,x,y,z']
    for k, (leg, point) in enumerate(zip(legs, xyz, strict=True)):
        rows.append(f'{START_NS + k * INTERVAL_NS},{leg},' + ','.join(f'{v:.9f}' for v in point))
    (HERE / name).write_text('\n'.join(rows) + '\n', encoding='utf-8')


def main():
    """Draw the machine, drive it, write the files."""
    rng = np.random.default_rng(SEED)
    corners = np.array([[int(c) for c in word] for word in CORNERS.split()]) * (HIGH - LOW) + LOW
    truth = {
        m: (rng.normal(size=len(nodes_of(m[2]))) * (2e-5 if m[1] in 'XYZ' else 6e-5)).round(7)
        for m in MOTIONS
    }
    truth |= dict(zip(SQUARENESS, rng.normal(0, 8e-5, 3).round(7), strict=True))
    legs, q, travel = drive(corners)
    errors = [np.interp(q[:, AXES.index(m[2])], nodes_of(m[2]), truth[m]) for m in MOTIONS]
    errors = np.stack([*errors, *(np.full(len(q), truth[s]) for s in SQUARENESS)], axis=1)
    machine = RUN['machine']
    points = target_on_table(machine['chain'], np.array(machine['target_offset']), q, errors)
    play = 0.5 * PLAY * travel[:, :1] * np.array([1.0, 0.0, 0.0])
    write_samples('samples.csv', legs, measured(points + play, SEED + 100))
    write_samples('twin.csv', legs, measured(points, TWIN_SEED))
    told = {k: np.array(v).tolist() for k, v in truth.items()}
    run = {**RUN, 'corners': corners.round(9).tolist(), 'truth': told}
    (HERE / 'run.json').write_text(json.dumps(run, indent=1) + '\n', encoding='utf-8')


if __name__ == '__main__':
    main()
