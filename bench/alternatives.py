# SPDX-License-Identifier: Apache-2.0
"""What one would take instead, on the same bag: time, memory, and the error that is left.

Side by side, in turn, each in a process of its own: the dense pseudo-inverse of the paper (Eq. 7),
SciPy's sparse least squares on the same rows, and ``otf_core``. The first two read with rosbags
and reduce samples as one would write it from the paper: stops at the corners give the pose of the
tracker, what lies between two of them lies on one line, samples are averaged between table nodes
over 8 mm. They need a stop at every corner, find no outliers and state no uncertainty.

Seconds run from bag to tables in memory, without imports of NumPy, SciPy and rosbags; peak memory
is that of the process until then; the error left is the mean length on a grid, rigid motion
removed. Cases: 'simulate' (the project's: true tables have the nodes that are solved for), and
forms of ``src/otf_core/test/nature.py``, which shares no formula with any of them.

Usage: python bench/alternatives.py [--cases simulate,waves] [--seed S] [--repeats N]
"""

from __future__ import annotations

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import argparse
import json
import resource
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from statistics import median
from types import SimpleNamespace

import numpy as np
from common import ROOT, heading, measured, row, texts
from rosbags.highlevel import AnyReader
from scipy import sparse
from scipy.sparse.linalg import lsqr

import otf_core

MACHINE = ROOT / 'src/otf_bringup/config/machine.yaml'
SEED, TOLERANCE = 20_260_031, 1e-10
WAYS = {
    'pinv': 'rosbags, dense pseudo-inverse (Eq. 7)',
    'lsqr': 'rosbags, `scipy.sparse.linalg.lsqr`',
    'otf': '`otf_core.calibrate`',
}
STILL, WINDOW, SHORTEST, SIZE = 5e-3, 0.04, 0.1, 8e-3
"""A stop is slower (m/s), over this time (s), and this long (s); length of a piece, and left out
at either end of a line (m)."""


def make(folder: Path, kind: str, seed: int) -> dict:
    """Write bag, machine and the true error on a grid of a simulated run."""
    folder.mkdir(parents=True)
    if kind == 'simulate':
        machine = otf_core.load_machine(MACHINE)
        config = otf_core.SimulationConfig(rate=250.0)
        run = otf_core.simulate(machine, seed=seed, config=config)
        recording = run.recording
    else:
        sys.path.insert(0, str(ROOT / 'src/otf_core/test'))
        from nature import Cell

        cell = Cell(seed, form=kind)
        recording, machine = cell.recording(rate=200.0), cell.machine
    axes = [np.linspace(low, high, 8)[:-1] + (high - low) / 16
            for low, high in zip(machine.lower, machine.upper, strict=True)]  # fmt: skip
    grid = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)
    true = otf_core.predict(run.truth, grid).error if kind == 'simulate' else cell.error(grid)
    (folder / 'machine.yaml').write_text(json.dumps(machine.to_dict()), encoding='utf-8')
    np.savez(folder / 'truth.npz', grid=grid, true=true)
    otf_core.write_bag(recording, folder / 'bag')
    return {'samples': len(recording.samples)}


def read_with_rosbags(bag: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (n,), ns; points (n, 3), m; corner points of the path (k, 3), m."""
    stamp, xyz, corners = [], [], []
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic == '/tracker/point':
                message = reader.deserialize(raw, connection.msgtype)
                p, t = message.point, message.header.stamp
                stamp.append(t.sec * 1_000_000_000 + t.nanosec)
                xyz.append((p.x, p.y, p.z))
            elif connection.topic == '/planner/path':
                poses = reader.deserialize(raw, connection.msgtype).poses
                corners = [
                    (p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in poses
                ]
    return np.array(stamp), np.array(xyz), np.array(corners)


def stops(at: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """First and last sample of every stop, (s, 2)."""
    half = max(1, round(0.5 * WINDOW / float(np.median(np.diff(at)))))
    way = np.linalg.norm(xyz[2 * half :] - xyz[: -2 * half], axis=1)
    speed = np.pad(way / (at[2 * half :] - at[: -2 * half]), half, mode='edge')
    edge = np.flatnonzero(np.diff(np.concatenate([[0], speed < STILL, [0]])))
    found = edge.reshape(-1, 2) - [0, 1]
    return found[at[found[:, 1]] - at[found[:, 0]] >= SHORTEST]


def marks(start: np.ndarray, step: np.ndarray, nodes: list[np.ndarray]) -> np.ndarray:
    """Boundaries of the pieces of one line, m from its start."""
    length = np.linalg.norm(step)
    cuts = [(n - s) / d * length for n, s, d in zip(nodes, start, step, strict=True) if d != 0]
    cuts = np.unique(np.concatenate([[SIZE, length - SIZE], *cuts]).round(9))
    cuts = cuts[(cuts >= SIZE - 1e-9) & (cuts <= length - SIZE + 1e-9)]
    parts = [np.linspace(a, b, int(np.ceil((b - a) / SIZE)), endpoint=False)
             for a, b in pairwise(cuts)]  # fmt: skip
    return np.concatenate([*parts, cuts[-1:]])


def pieces(bag: Path, nodes: list[np.ndarray]) -> SimpleNamespace:
    """Place on the path q (p, 3), deviation (p, 3) and two directions across it (2, p, 3)."""
    stamp, xyz, corners = read_with_rosbags(bag)
    at = (stamp - stamp[0]) * 1e-9
    still = stops(at, xyz)
    if len(still) != len(corners):
        raise SystemExit(f'{len(still)} stops found, the path has {len(corners)} corners')
    found = np.array([xyz[a : b + 1].mean(axis=0) for a, b in still])
    middle, there = found.mean(axis=0), corners.mean(axis=0)
    left, _, right = np.linalg.svd((corners - there).T @ (found - middle))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    points = (xyz - middle) @ rotation.T + there
    line = np.searchsorted(still.mean(axis=1), np.arange(len(xyz))) - 1
    line = np.clip(line, 0, len(corners) - 2)
    step = np.diff(corners, axis=0)
    unit = step / np.linalg.norm(step, axis=1)[:, None]
    along = np.einsum('ij,ij->i', points - corners[line], unit[line])
    piece, number = np.full(len(xyz), -1), 0
    for k, (a, b) in enumerate(pairwise(np.searchsorted(line, np.arange(len(step) + 1)))):
        cuts = marks(corners[k], step[k], nodes)
        own = np.searchsorted(cuts, along[a:b], side='right') - 1
        inside = (own >= 0) & (own < len(cuts) - 1)
        piece[a:b][inside] = number + own[inside]
        number += len(cuts)
    use = np.flatnonzero(piece >= 0)
    _, first, of = np.unique(piece[use], return_index=True, return_inverse=True)
    means = np.stack([np.bincount(of, v) for v in points[use].T], axis=1)
    means /= np.bincount(of)[:, None]
    own = line[use[first]]
    q = corners[own] + np.einsum('ij,ij->i', means - corners[own], unit[own])[:, None] * unit[own]
    aside = np.cross(unit[own], np.eye(3)[np.argmin(np.abs(unit[own]), axis=1)])
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    return SimpleNamespace(q=q, deviation=means - q, axes=(aside, np.cross(unit[own], aside)))


def columns(machine: otf_core.Machine, q: np.ndarray) -> list[sparse.csr_matrix]:
    """Displacement along X, Y, Z per squareness error and node value, from docs/conventions.md."""
    names, target = machine.axis_names, machine.target_offset
    zero, rows = np.zeros(len(q)), [[], [], []]
    for one in (np.stack([-q[:, 1], zero, zero]), np.stack([q[:, 2], zero, zero]),
                np.stack([zero, -q[:, 2], zero])):  # fmt: skip
        for k in range(3):
            rows[k].append(sparse.csr_matrix(one[k][:, None]))
    for axis in names:
        moved = np.array([a in machine.chain.lever_axes(axis) for a in 'XYZ'])
        arm, place = target + q * moved, q[:, 'XYZ'.index(axis)]
        own = machine.axes[axis]
        nodes = np.append(np.arange(own.min, own.max - 1e-9, own.table_pitch), own.max)
        cell = np.clip(np.searchsorted(nodes, place, side='right') - 1, 0, len(nodes) - 2)
        share = (place - nodes[cell]) / (nodes[cell + 1] - nodes[cell])
        each = np.arange(len(q))
        hats = sparse.csr_matrix(
            (np.concatenate([1 - share, share]),
             (np.concatenate([each, each]), np.concatenate([cell, cell + 1]))),
            shape=(len(q), len(nodes)),
        )  # fmt: skip
        for unit in np.eye(3):
            for influence in (np.broadcast_to(unit, q.shape), np.cross(unit, arm)):
                for k in range(3):
                    rows[k].append(sparse.diags(influence[:, k]) @ hats)
    return [sparse.hstack(part, format='csr') for part in rows]


def least_squares(folder: Path, way: str) -> tuple[int, np.ndarray]:
    """Rows, and the error of the tables on the grid (g, 3), by Eq. 7."""
    machine = otf_core.load_machine(folder / 'machine.yaml')
    nodes = [np.arange(a.min, a.max + 1e-9, a.table_pitch) for a in machine.axes.values()]
    run = pieces(folder / 'bag', nodes)
    model, pose = columns(machine, run.q), []
    for unit in np.eye(3):
        pose += [np.broadcast_to(unit, run.q.shape), np.cross(unit, run.q)]
    whole = [
        sparse.hstack([np.stack([p[:, k] for p in pose], axis=1), model[k]]) for k in range(3)
    ]
    rows = sparse.vstack(
        [sum(sparse.diags(a[:, k]) @ whole[k] for k in range(3)) for a in run.axes]
    ).tocsr()
    seen = np.concatenate([np.einsum('ij,ij->i', a, run.deviation) for a in run.axes])
    scale = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=0)).ravel())
    scale = np.where(scale > 0, 1.0 / np.maximum(scale, 1e-300), 0.0)
    scaled = rows @ sparse.diags(scale)
    if way == 'pinv':
        found = scale * (np.linalg.pinv(scaled.toarray(), rcond=1e-9) @ seen)
    else:
        found = scale * lsqr(scaled, seen, atol=TOLERANCE, btol=TOLERANCE, iter_lim=5000)[0]
    grid = np.load(folder / 'truth.npz')['grid']
    return rows.shape[0], np.stack([part @ found[6:] for part in columns(machine, grid)], axis=1)


def solve(folder: Path, way: str) -> dict:
    """From bag to tables: seconds, peak until then, error before and after in um, rows."""
    start, cpu = time.perf_counter(), time.process_time()
    if way == 'otf':
        machine = otf_core.load_machine(folder / 'machine.yaml')
        result = otf_core.calibrate(otf_core.read_bag(folder / 'bag', machine))
        rows = 2 * result.fit.pieces
    else:
        rows, error = least_squares(folder, way)
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    truth = np.load(folder / 'truth.npz')
    if way == 'otf':
        error = otf_core.predict(result, truth['grid']).error
    before, left = (float(1e6 * np.linalg.norm(otf_core.without_rigid_motion(f, truth['grid']),
                                               axis=1).mean())
                    for f in (truth['true'], truth['true'] - error))  # fmt: skip
    return {'wall': wall, 'processor': cpu, 'peak': peak, 'rows': rows, 'before': before,
            'left': left}  # fmt: skip


def show(found: dict[str, list[dict]]) -> None:
    """Print the table of a case; smallest times, ratios to those of otf_core."""
    own = min(one['wall'] for one in found['otf'])
    print(heading(('way', 'rows', 'wall s', 'ratio', 'processor s', 'peak MB', 'error left um')))
    for way, runs in found.items():
        wall = min(one['wall'] for one in runs)
        print(row((WAYS[way], runs[0]['rows'], f'{wall:.2f}', f'{wall / own:.2f}',
                   f'{min(one["processor"] for one in runs):.2f}',
                   f'{median(one["peak"] for one in runs):.0f}',
                   f'{runs[0]["left"]:.3f} of {runs[0]["before"]:.1f}')))  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--cases', type=texts, default=('simulate', 'waves'))
    parser.add_argument('--seed', type=int, default=SEED)
    parser.add_argument('--repeats', type=int, default=5)
    parser.add_argument('--job', nargs='+', help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.job:
        what, folder, *case = chosen.job
        path = Path(folder)
        done = make(path, case[0], chosen.seed) if what == 'make' else solve(path, what)
        print(json.dumps(done))
        return
    with tempfile.TemporaryDirectory() as scratch:
        for case in chosen.cases:
            own = [__file__, '--seed', str(chosen.seed), '--job']
            made = json.loads(measured([*own, 'make', Path(scratch, case), case]).text)
            found: dict[str, list[dict]] = {way: [] for way in WAYS}
            for _ in range(chosen.repeats):
                for way in WAYS:
                    text = measured([*own, way, Path(scratch, case)]).text
                    found[way].append(json.loads(text.splitlines()[-1]))
            print(f'\n{case}, seed {chosen.seed}: {made["samples"]} samples, '
                  f'load {os.getloadavg()[0]:.1f}\n')  # fmt: skip
            show(found)


if __name__ == '__main__':
    main()
