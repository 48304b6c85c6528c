# SPDX-License-Identifier: Apache-2.0
"""Draw the stops: errors of the size of a machine tool's, the tracker anywhere, nests off by 1 mm.

``python3 -m certified_rotary.make_stops`` writes stops.csv, exact.csv (without noise) and
truth.json. A line is one stop: target, axis positions, mean of the samples in the tracker's frame.
"""

import json

import numpy as np
from certified_rotary.exact_chain import (
    AXES,
    HERE,
    MACHINE,
    NODES,
    SCALARS,
    SIX,
    at_position,
    position,
)

SEED, SAMPLES = 20261, 500


def draw_tables(random):
    """True errors; zero where the gauge of the tables says so, but for the line of C."""
    tables = {name: random.normal() * (3e-5 if name[0] in 'XY' else 6e-5) for name in SCALARS}
    for axis in AXES:
        at = NODES[axis]
        for d in SIX:
            own = random.normal(size=len(at)) * (1.5e-5 if d in 'XYZ' else 4e-5)
            own -= np.interp(0.0, at, own)
            if axis in 'XYZ' and d in 'XYZ' and d != axis:
                own -= np.interp(at, at[[0, -1]], own[[0, -1]])
            tables[f'E{d}{axis}'] = own
    return tables


def draw_stops():
    """Targets and axis positions."""
    low, high = ([NODES[a][k] for a in 'XYZ'] for k in (0, -1))
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 3).T), -1).reshape(-1, 3)
    stops = [(t, [*p, 0.0]) for t in ('tool', 'long', 'side') for p in grid]
    turns = np.linspace(0.0, NODES['C'][-1], 13)
    return stops + [(f'nest-{k}', [0.0, 0.0, 0.2, c]) for k in (1, 2, 3) for c in turns]


def main():
    """Write the files."""
    random = np.random.default_rng(SEED)
    tables = draw_tables(random)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    stand = np.array([-0.9, 0.6, 0.8])
    places = {'tool': ('t', MACHINE['target_offset'])}
    for name, own in MACHINE['targets'].items():
        off = random.normal(size=3) * own['u']
        places[name] = (own['link'], np.array(own['place']) + off)
    exact, noisy = [], []
    for target, q in draw_stops():
        point = position(q, *places[target], at_position(tables, q))
        seen = turn.T @ (point - stand)
        size = np.linalg.norm(seen)
        beam = seen / size
        tracker = MACHINE['tracker']
        across = random.normal(size=3) * tracker['u_angle'] * size
        along = random.normal() * tracker['u_range']
        noise = (across - beam * (beam @ across) + along * beam) / np.sqrt(SAMPLES)
        for rows, xyz in ((exact, seen), (noisy, seen + noise)):
            rows.append(','.join([target, *(f'{v:.12f}' for v in (*q, *xyz))]))
    head = 'target,x,y,z,c,px,py,pz'
    for name, rows in (('exact.csv', exact), ('stops.csv', noisy)):
        (HERE / name).write_text('\n'.join([head, *rows]) + '\n', encoding='utf-8')
    truth = {k: np.asarray(v).tolist() for k, v in tables.items()}
    truth['start'] = {'rotation': turn.tolist(), 'translation': (stand + 4e-4).tolist()}
    (HERE / 'truth.json').write_text(json.dumps(truth, indent=1) + '\n', encoding='utf-8')


if __name__ == '__main__':
    main()
