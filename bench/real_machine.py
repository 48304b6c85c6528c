# SPDX-License-Identifier: Apache-2.0
"""What a calibration predicts of holes that a real machine drilled and that it has not seen.

    python bench/real_machine.py PLATE [PLATE ...]

Each PLATE is a table of nominal and measured X and Y of holes (docs/trials.md says where
such data are public). Of every tenth of the holes the deviations are predicted from the others.
Printed is what is left in X and Y, root mean square, beside offset, rotation, scale and skew
alone, positioning and straightness alone (polynomials), and a free field over both coordinates;
the share of the holes within 2 u; and how plates that were given in a row differ.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np

import otf_core
from otf_core.arrays import Array

FOLDS, SEED = 10, 20240607
CHAINS = ('w-b-X-Y-t', 'w-b-Y-X-t')
"""Which axis carries the other is not known: yaw of the one that does is seen."""
DEGREE = 5
"""Of the polynomials of positioning and straightness, and of the free field."""


def machine_of(chain: str, reach: float) -> otf_core.Machine:
    """A plotter of X and Y over a square of +-reach, m."""
    axis = {'min': -reach, 'max': reach, 'table_pitch': 0.05}
    return otf_core.Machine.from_dict({
        'name': 'plate', 'chain': chain, 'axes': {'X': axis, 'Y': axis},
        'target_offset': [0.0, 0.0, 0.0], 'tracker': {'u_range': 3e-6, 'u_angle': 1e-6},
    })  # fmt: skip


def held_out(pairs: otf_core.PointPairs, fold: Array) -> tuple[Array, Array]:
    """Deviations of every hole from their prediction, and their u; both (n, 2), m."""
    left, u = np.empty((2, len(fold), 2))
    for k in range(FOLDS):
        out = fold == k
        some = replace(
            pairs,
            q=pairs.q[~out],
            measured=pairs.measured[~out],
            target=pairs.target[: (~out).sum()],
        )
        result = otf_core.calibrate([some], method='points')
        points = np.pad(pairs.q[out], ((0, 0), (0, 1)))
        predicted = otf_core.predict(result, points)
        pose = result.runs[0].T_machine_tracker
        measured = np.nan_to_num(pairs.measured[out])
        left[out] = (pose.apply(measured) - points - predicted.error)[:, :2]
        scatter = np.hypot(result.runs[0].noise.range.level, result.runs[0].misfit.independent)
        u[out] = np.hypot(predicted.u_run[:, :2], scatter)
    return left, u


def left_by(columns: Array, deviation: Array, fold: Array) -> Array:
    """What least squares on columns (n, 2, p) leaves of the held-out deviations (n, 2), m."""
    left = np.empty_like(deviation)
    for k in range(FOLDS):
        out = fold == k
        rows = columns[~out].reshape(-1, columns.shape[2])
        fitted = np.linalg.lstsq(rows, deviation[~out].ravel(), rcond=None)[0]
        left[out] = deviation[out] - columns[out] @ fitted
    return left


def columns_of(x: Array, y: Array, kind: str) -> Array:
    """Columns (n, 2, p) of deviations in X and Y over coordinates of size 1."""
    n = len(x)
    of_x = [x**k for k in range(1, DEGREE + 1)]
    of_y = [y**k for k in range(1, DEGREE + 1)]
    one = np.ones(n)
    if kind == 'affine':
        terms = [[one, x, y]] * 2
    elif kind == 'positioning and straightness':
        terms = [[one, *of_x, *of_y]] * 2
    else:
        terms = [[x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]] * 2
    width = len(terms[0])
    columns = np.zeros((n, 2, 2 * width))
    for k, own in enumerate(terms):
        columns[:, k, k * width : (k + 1) * width] = np.stack(own, axis=1)
    return columns


def words_of(left: Array) -> str:
    """Root mean square in X and Y, um."""
    x, y = 1e6 * np.sqrt(np.mean(left**2, axis=0))
    return f'{x:.2f} / {y:.2f} um'


def main() -> int:
    """Print the figures of every plate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('plates', nargs='+')
    plates: list[tuple[str, Array, Array]] = []
    for name in parser.parse_args().plates:
        loose = otf_core.read_point_pairs(name, machine_of(CHAINS[0], 10.0))[0]
        reach = 1.02 * float(np.abs(loose.q).max())
        fold = np.random.default_rng(SEED).permutation(len(loose.q)) % FOLDS
        deviation = loose.measured[:, :2] - loose.q
        x, y = (loose.q / reach).T
        print(f'{name}: {len(fold)} holes')
        for kind in ('affine', 'positioning and straightness', 'free field'):
            left = left_by(columns_of(x, y, kind), deviation, fold)
            print(f'  {kind:38s} {words_of(left)}')
        for chain in CHAINS:
            left, u = held_out(otf_core.read_point_pairs(name, machine_of(chain, reach))[0], fold)
            within = np.mean(np.abs(left) < 2.0 * u)
            print(f'  calibrated as {chain:24s} {words_of(left)}, {100 * within:.0f} % within 2 u')
        plates.append((name, loose.q, deviation))
    for (one, q, a), (other, p, b) in pairwise(plates):
        if q.shape == p.shape and np.allclose(q, p, atol=1e-6):
            columns = columns_of(*(q / np.abs(q).max()).T, 'affine')
            print(f'{other} less {one}: {words_of(left_by(columns, b - a, fold))}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
