# SPDX-License-Identifier: Apache-2.0
"""Neutral lattice as CSV: ``#`` lines, then x,y,z,dx,dy,dz,u_dx,u_dy,u_dz in m, Z fastest."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from otf_core.errors import ConfigError
from otf_core.exports.base import Exported, Format, Request
from otf_core.exports.lattice import Lattice, sampled_lattice
from otf_core.files.writing import unreadable
from otf_core.prediction.predict import predict

HEADER = ('x', 'y', 'z', 'dx', 'dy', 'dz', 'u_dx', 'u_dy', 'u_dz')
DECIMALS = 12
SAME = 1e-9
"""m; coordinates that differ by less are one plane of the lattice."""


class LatticeCsv(Format):
    """Volumetric errors and their standard uncertainties on a lattice."""

    name = 'lattice-csv'
    lacks = (
        'the course between lattice points (take trilinear interpolation), other target offsets '
        'than the measured one, correlations; differences between the directions of travel'
    )
    takes_points = True

    def sign_words(self, request: Request) -> str:
        """Say what the values are."""
        return 'dx, dy, dz are errors (actual minus nominal), u standard uncertainties; all in m'

    def export(self, request: Request) -> Exported:
        """Make the CSV."""
        self.check(request)
        lattice, remarks = sampled_lattice(request.content.tables, request.points)
        q = lattice.points
        rounded = Lattice(lattice.axes, lattice.error.round(DECIMALS) + 0.0)
        u = predict(request.content, q).u.round(DECIMALS)
        rows = np.hstack([q.round(DECIMALS) + 0.0, rounded.error.reshape(-1, 3), u]).tolist()
        lines = [f'# {line}' for line in request.header(self)]
        lines += [','.join(HEADER), *(','.join(map(repr, row)) for row in rows)]
        return Exported({request.name: ('\n'.join(lines) + '\n').encode()}, rounded.at, remarks)


def read_lattice_csv(path: str | Path) -> Lattice:
    """Read a lattice in any order of its points.

    Returns
    -------
    Lattice

    Raises
    ------
    ConfigError
        Names file and line of what is wrong, or the point that is missing.
    """
    q, error = _columns(path)
    axes, places = [], []
    for k in range(3):
        order = np.unique(q[:, k])
        axes.append(order[np.concatenate([[True], np.diff(order) > SAME])])
        places.append(np.abs(q[:, k, None] - axes[k]).argmin(axis=1))
    shape = tuple(map(len, axes))
    filled = np.full((*shape, 3), np.nan)
    filled[tuple(places)] = error
    missing = np.argwhere(np.isnan(filled[..., 0]))
    if len(missing) or len(q) != np.prod(shape):
        what = 'points appear twice'
        if len(missing):
            x, y, z = (axes[k][missing[0][k]] for k in range(3))
            what = f'no point at ({x:g}, {y:g}, {z:g})'
        raise ConfigError(
            f'{path}: no regular lattice: {len(q)} points, '
            f'{" x ".join(map(str, shape))} planes, {what}'
        )
    if min(shape) < 2:
        raise ConfigError(f'{path}: needs two points along every axis, got {shape}')
    return Lattice((axes[0], axes[1], axes[2]), filled)


def _columns(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions and errors, each (n, 3), m."""
    try:
        text = Path(path).read_text(encoding='utf-8-sig')
    except OSError as error:
        raise unreadable(path, error) from None
    except UnicodeDecodeError:
        raise ConfigError(f'{path}: not a CSV text file') from None
    lines = text.splitlines()
    first = next((n for n, line in enumerate(lines) if line and not line.startswith('#')), None)
    header = [] if first is None else [h.strip() for h in lines[first].split(',')]
    if first is None or not set(HEADER[:6]) <= set(header):
        raise ConfigError(
            f'{path}: expected the header {",".join(HEADER[:6])} after lines that begin with #'
        )
    places, rows = [header.index(k) for k in HEADER[:6]], []
    for number, row in enumerate(csv.reader(lines[first + 1 :]), start=first + 2):
        if not row or row[0].startswith('#'):
            continue
        try:
            rows.append([float(row[k]) for k in places])
        except (ValueError, IndexError):
            raise ConfigError(f'{path}: line {number}: expected six numbers, got {row}') from None
        if not np.all(np.isfinite(rows[-1])):
            raise ConfigError(f'{path}: line {number}: not finite')
    if not rows:
        raise ConfigError(f'{path}: holds no points')
    values = np.array(rows)
    return values[:, :3], values[:, 3:]


FORMAT = LatticeCsv()
