# SPDX-License-Identifier: Apache-2.0
"""Paper 2.1 in simulation: errors of about 100 um on path and grid, before and after.

Cell of 600 x 500 x 400 mm, default path, 500 samples per second, tracker noise as specified with
half of its variance correlated over 0.3 s. Path: mean distance across the path at points 8 mm
apart; grid: mean length of the error vectors at 7 x 7 x 7 points. From every field, before and
after, the best rigid motion is taken out: it belongs to the choice of the frame. First block: the
true errors are tables with the nodes that are solved for. Second block: smooth curves (cubic
splines) through the same values, which piecewise linear tables cannot follow.

The seeds were not used in development. Nothing is tuned to them.

Usage: PYTHONPATH=src/otf_core python bench/paper_2_1.py [FIRST_SEED [CELLS]]
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import otf_core

MACHINE = """
name: paper
chain: w-b-X-Y-Z-t
axes:
  X: {min: 0.0, max: 0.6, table_pitch: 0.03}
  Y: {min: 0.0, max: 0.5, table_pitch: 0.03}
  Z: {min: -0.4, max: 0.0, table_pitch: 0.03}
target_offset: [0.0, 0.0, -0.15]
tracker: {u_range: 0.5e-6, u_angle: 2.0e-6}
"""
SIZE, RATE, STEP, DENSE = 1e-4, 500.0, 8e-3, 20
PAPER = (117e-6, 0.95e-6), (103e-6, 0.87e-6)


def smoothed(tables):
    """Splines through the values of tables, sampled densely."""
    motions = {}
    for name, table in tables.motions.items():
        position = np.linspace(table.position[0], table.position[-1], DENSE * len(table.position))
        value = CubicSpline(table.position, table.value)(position)
        motions[name] = replace(table, position=position, value=value, u=np.zeros_like(value))
    return replace(tables, motions=motions)


def error_of(tables, q):
    """First order, all axes on the side of the target: error of tables at positions (n, 3), m."""
    square = {name: entry.value for name, entry in tables.squareness.items()}
    total = np.stack([square['B0Z'] * q[:, 2] - square['C0Y'] * q[:, 1],
                      -square['A0Z'] * q[:, 2], 0.0 * q[:, 0]], axis=1)  # fmt: skip
    for k, axis in enumerate('XYZ'):
        six = [np.interp(q[:, k], t.position, t.value)
               for t in (tables.motions[f'E{d}{axis}'] for d in 'XYZABC')]  # fmt: skip
        arm = tables.machine.target_offset + q * (np.arange(3) > k)
        total += np.stack(six[:3], axis=1) + np.cross(np.stack(six[3:], axis=1), arm)
    return total


def points_of(path):
    """Points every 8 mm on the lines of a path (n, 3), and their directions (n, 3)."""
    points, directions = [], []
    for first, last in pairwise(path):
        length = np.linalg.norm(last - first)
        share = np.arange(STEP, length - STEP, STEP)[:, None] / length
        points.append(first + share * (last - first))
        directions.append(np.tile((last - first) / length, (len(share), 1)))
    return np.concatenate(points), np.concatenate(directions)


def across(field, q, direction):
    """Mean length across the path of a field (n, 3) without its best rigid motion."""
    aside = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction), axis=1)])
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    axes = np.stack([aside, np.cross(direction, aside)], axis=1)
    turns = np.stack([np.cross(unit, q) for unit in np.eye(3)], axis=2)
    rows = np.concatenate([axes, axes @ turns], axis=2).reshape(-1, 6)
    seen = np.einsum('nij,nj->ni', axes, field).ravel()
    left = seen - rows @ np.linalg.lstsq(rows, seen, rcond=None)[0]
    return np.linalg.norm(left.reshape(-1, 2), axis=1).mean()


def one_cell(machine, seed, smooth):
    """Simulate, calibrate, compare with the truth: before and after on path and grid, m."""
    config = otf_core.SimulationConfig(rate=RATE, error_size=SIZE)
    run = otf_core.simulate(machine, seed=seed, config=config)
    if smooth:
        run = otf_core.simulate(machine, seed=seed, config=config, tables=smoothed(run.truth))
    result = otf_core.calibrate(run.recording)
    q, direction = points_of(run.recording.path.points)
    axes = [np.linspace(low, high, 7) for low, high in zip(q.min(0), q.max(0), strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)
    fields = []
    for points in (q, grid):
        true = error_of(run.truth, points)
        fields.append((true, true - otf_core.predict(result, points).error))
    on_grid = (otf_core.without_rigid_motion(field, grid) for field in fields[1])
    return (
        tuple(across(field, q, direction) for field in fields[0]),
        tuple(np.linalg.norm(field, axis=1).mean() for field in on_grid),
    )


def line(name, found):
    """One row of the table: um and the part that is gone."""
    cells = [f'{1e6 * before:10.2f}{1e6 * after:8.3f}{100 * (1 - after / before):9.2f} %'
             for before, after in found]  # fmt: skip
    return f'{name:10}' + '  '.join(cells)


def main(first=20_260_001, cells=5):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, 'machine.yaml')
        file.write_text(MACHINE)
        machine = otf_core.load_machine(file)
    for smooth, text in ((False, 'nodes as solved for'), (True, 'smooth between the nodes')):
        print(f'\ntrue errors: {text}; mean absolute error in um')
        print(f'{"":10}{"path before":>11}{"after":>7}{"less":>10}{"grid before":>15}{"after":>8}'
              f'{"less":>10}')  # fmt: skip
        print(line('paper', PAPER))
        for seed in range(first, first + cells):
            start = time.process_time()
            found = one_cell(machine, seed, smooth)
            print(line(str(seed), found), f'{time.process_time() - start:5.0f} s', flush=True)


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
