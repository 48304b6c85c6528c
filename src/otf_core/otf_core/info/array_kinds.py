# SPDX-License-Identifier: Apache-2.0
"""Residuals and tables of numbers as text."""

from __future__ import annotations

import csv
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np

from otf_core.errors import ConfigError
from otf_core.info.kind import Explained, Kind, begins
from otf_core.inputs.points_file import read_points


def _residuals(path: Path) -> Explained:
    try:
        with path.open('rb') as raw, np.load(raw, allow_pickle=False) as file:
            shapes = {name: list(file[name].shape) for name in file.files}
            rest = np.linalg.norm(file['residual'], axis=1)
            before = np.linalg.norm(file['deviation'], axis=1)
            runs = int(file['run'].max()) + 1
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(f'{path}: is no residuals.npz of otf calibrate ({error})') from None
    rows = (
        ('pieces', f'{len(rest)} of the path, in {runs} run{"s" if runs > 1 else ""}'),
        ('residual', f'{1e6 * rest.mean():.2f} um on average, at most {1e6 * rest.max():.2f} um'),
        ('deviation', f'{1e6 * before.mean():.2f} um on average, before compensation'),
        ('arrays', ', '.join(f'{name} {tuple(shape)}' for name, shape in shapes.items())),
    )
    facts = {
        'pieces': len(rest), 'runs': runs, 'arrays': shapes,
        'mean_residual': float(rest.mean()), 'largest_residual': float(rest.max()),
    }  # fmt: skip
    return Explained(rows, facts)


def _direct(path: Path) -> Explained:
    with path.open(encoding='utf-8-sig', newline='') as file:
        lines = [line for line in file if line.strip() and not line.startswith('#')]
    table = list(csv.DictReader(lines))
    counts = Counter(row['axis'] for row in table)
    columns = [name for name in table[0] if name] if table else []
    rows = (
        ('readings', ', '.join(f'{n} along {axis}' for axis, n in counts.items()) or 'none'),
        ('columns', ', '.join(columns)),
    )
    return Explained(rows, {'readings': dict(counts), 'columns': columns})


def _points(path: Path) -> Explained:
    points = read_points(path)[0]
    low, high = points.min(axis=0), points.max(axis=0)
    rows = [('points', str(len(points)))]
    ends = zip('xyz', low, high, strict=True)
    rows += [(axis, f'{1e3 * a:g} to {1e3 * b:g} mm') for axis, a, b in ends]
    facts = {'points': len(points), 'lower': low.tolist(), 'upper': high.tolist()}
    return Explained(tuple(rows), facts)


RESIDUALS = Kind(
    'residuals',
    'what a calibration leaves at every piece of the path',
    lambda path: path.suffix == '.npz' and path.is_file(),
    _residuals,
)
DIRECT = Kind(
    'direct measurement',
    'readings of an instrument along single axes; otf compare reads it',
    lambda path: path.suffix.lower() == '.csv' and begins(path, 'axis,run,direction,'),
    _direct,
)
POINTS = Kind(
    'points',
    'positions x,y,z in m; otf predict, plan --path and simulate --path read it',
    lambda path: path.suffix.lower() == '.csv' and begins(path, 'x,y,z'),
    _points,
)
