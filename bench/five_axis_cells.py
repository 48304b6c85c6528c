# SPDX-License-Identifier: Apache-2.0
"""Machines with rotary axes: ``otf calibrate`` beside exact transforms that share nothing with it.

Ten cells of the nature of the blind trial (``bench/blind/nature.py``), each with one reflector in
the spindle or with two lengths: a trunnion, one whose axes turn in the reversed sense, four axes
with the tracker on the turning table (the target creeps), a swivel head (likewise), and stops
(``--method standstill``) of four and of five axes with the tracker on the bed. The error of the
tool at 300 positions spread over all axes is that of the exact transforms with the drawn errors,
and with the tables in their place; the rigid motion of the table is removed of both sides. Left:
mean length after over before; within 2 u: share of the components, by ``covariance_run``.

Usage: python bench/five_axis_cells.py --seed S [--count N] [--tree CHECKOUT] [--out DIR]
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from blind.draw import write_bag
from blind.machines import _at, figures, parts_of_rotary, rotary_spec, run_along
from blind.nature import Errors, Machine, Part
from common import core_on_path, heading, row

ONE, TWO = 'one length', 'two lengths'
KINDS = ('trunnion', 'reversed', 'rotary', 'head')
STOPS = ('four axes', 'five axes')
CELLS = (*((k, n) for k in KINDS for n in (ONE, TWO)), *zip(STOPS, (ONE, TWO), strict=True))
POINTS = 300


def stops_of(machine, name, rng):
    """Random positions to stop at; the first of the axes that move goes to and fro."""
    moving = [a for a in machine.letters if (a in 'XYZ') == (not name.startswith('nest'))]
    share = rng.uniform(size=(120, len(moving)))
    share[:, 0] = 0.4 * share[:, 0] + 0.6 * (np.arange(len(share)) % 2)
    low, high = machine.ends(moving)
    q = low + share * (high - low)
    return Part(name, _at(machine, len(q), **dict(zip(moving, q.T, strict=True))),
                np.full(len(q) - 1, 0.15), 0.5, (0.3, 1.0), 1.2)  # fmt: skip


def lines_of(machine, rng):
    """Face figures and space diagonals with the tool."""
    low, high = machine.ends('XYZ')
    q = low + figures(rng) * (high - low)
    return Part('tool', _at(machine, len(q), **dict(zip('XYZ', q.T, strict=True))),
                np.full(len(q) - 1, 0.15), push=(0.5, 1.0), dwell=0.1)  # fmt: skip


def run_of(kind, lengths, rng):
    """Draw machine, errors and what is driven; see the head of this file."""
    spec = rotary_spec(kind if kind in ('rotary', 'head') else 'trunnion', rng)
    if kind == 'four axes':
        del spec['axes']['A']
        spec['chain'] = 'w-C-b-X-Y-Z-t'
    if kind == 'reversed':
        for axis in 'AC':
            spec['axes'][axis]['direction'] = [-v for v in spec['axes'][axis]['direction']]
    machine = Machine(spec)
    if kind in STOPS:
        nests = [n for n in spec['targets'] if n.startswith('nest')]
        parts = [stops_of(machine, n, rng) for n in ('tool', 'long', *nests)]
    else:
        parts = [lines_of(machine, rng), *parts_of_rotary(machine, rng)[1:]]
    if lengths == ONE:
        parts = [p for p in parts if p.target not in ('long', 'side')]
    run = run_along(machine, parts, rng)
    zero = {n: np.clip(0.0, *machine.range_of(n[2])) for n in run.errors.motions}
    motions = {n: lambda q, f=f, at=zero[n]: f(q) - f(at) for n, f in run.errors.motions.items()}
    return replace(run, errors=Errors(motions, run.errors.constants))  # targets are as stated


def field(machine, q, errors):
    """Error of the tool (n, 3), m, in the frame of the table, by exact transforms."""
    return machine.at(q, errors=errors) - machine.at(q)


def judge(run, document, rng):
    """Left, %, and components within 2 u, %."""
    machine, low, high = run.machine, *run.machine.ends(run.machine.letters)
    q = rng.uniform(low, high, (POINTS, len(low)))
    tables = {
        n: (np.array(t['position']), np.array(t['value'])) for n, t in document['motions'].items()
    }
    scalars = {
        n: s['value'] for part in ('squareness', 'location') for n, s in document[part].items()
    }
    own = Errors({n: lambda at, t=t: np.interp(at, *t) for n, t in tables.items()}, scalars)
    step = 1e-6
    columns = [field(machine, q, Errors({}, {n: step}))[..., None] / step for n in scalars]
    for name, (position, _) in tables.items():
        one = field(machine, q, Errors({name: lambda at: np.full_like(at, step)})) / step
        at = q[:, machine.column(name[2])]
        hats = np.stack([np.interp(at, position, e) for e in np.eye(len(position))], axis=1)
        columns.append(one[:, :, None] * hats[:, None])
    rows = np.concatenate(columns, axis=2).reshape(3 * POINTS, -1)
    lower = np.frombuffer(base64.b64decode(document['covariance_run']['data']), '<f8')
    covariance = np.zeros((rows.shape[1],) * 2)
    covariance[np.tril_indices(len(covariance))] = lower
    covariance += np.tril(covariance, -1).T
    turn = np.cross(np.eye(3), machine.at(q)[:, None]).swapaxes(1, 2)
    rigid = np.concatenate([np.tile(np.eye(3), (POINTS, 1, 1)), turn], axis=2)
    basis = np.linalg.qr(rigid.reshape(3 * POINTS, 6))[0]
    truth = field(machine, q, run.errors).ravel()
    off = field(machine, q, own).ravel() - truth
    truth, off, rows = (v - basis @ (basis.T @ v) for v in (truth, off, rows))
    u = np.sqrt(np.einsum('ij,jk,ik->i', rows, covariance, rows))
    before, after = (np.linalg.norm(v.reshape(-1, 3), axis=1).mean() for v in (truth, off))
    return 100 * after / before, 100 * np.mean(np.abs(off) <= 2 * u)


def calibrated(folder, tree, method):
    """Processor seconds of ``otf calibrate`` and its document; SystemExit if it is refused."""
    out = folder / tree.name
    words = ['-m', 'otf_core.cli', 'calibrate', folder / 'bag', '--overwrite', '--method', method]
    words += ['--machine', folder / 'machine.yaml', '--out', out]
    run = subprocess.Popen(
        [sys.executable, *map(str, words)],
        env=core_on_path(tree),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    said = run.stderr.read()
    _, status, used = os.wait4(run.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 4, 5):
        raise SystemExit(said.strip().splitlines()[-1])
    return used.ru_utime + used.ru_stime, json.loads((out / 'error_tables.json').read_text())


def main(given, folder):
    """Draw, calibrate and judge cell by cell; print the table."""
    print(f'Seed {given.seed}, {given.tree.name}\n')
    print(heading(('cell', 'left, %', 'within 2 u, %', 'processor s')))
    found = []
    for k in range(len(CELLS) * given.count):
        kind, lengths = CELLS[k % len(CELLS)]
        run, own = run_of(kind, lengths, np.random.default_rng([given.seed, k])), folder / str(k)
        if not own.exists():
            own.mkdir(parents=True)
            (own / 'machine.yaml').write_text(yaml.safe_dump(run.machine.spec, sort_keys=False))
            write_bag(own / 'bag', run, *run.measured(run.plain, run.noise))
        method = 'standstill' if kind in STOPS else 'otf'
        try:
            seconds, document = calibrated(own, given.tree, method)
        except SystemExit as refused:
            print(row((f'{kind}, {lengths}', refused)), flush=True)
            continue
        found.append(judge(run, document, np.random.default_rng([given.seed, k, 1])))
        columns = (f'{v:.2f}' for v in found[-1])
        print(row((f'{kind}, {lengths}', *columns, f'{seconds:.1f}')), flush=True)
    left, within = np.array(found).T
    print(f'\nleft {np.median(left):.2f} % in the median, {left.max():.2f} % at worst; within 2 u '
          f'{within.mean():.1f} % on average, {within.min():.1f} % at worst')  # fmt: skip


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seed', type=int, required=True)
    parser.add_argument('--count', type=int, default=1, help='how often all ten cells are drawn')
    parser.add_argument('--tree', type=Path, default=Path(__file__).resolve().parents[1],
                        help='whose code to ask')  # fmt: skip
    parser.add_argument('--out', type=Path, help='keeps recordings and results')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        main(options, options.out or Path(scratch))
