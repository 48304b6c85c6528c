# SPDX-License-Identifier: Apache-2.0
"""Neutral lattice as CSV: ``#`` lines, then x,y,z,dx,dy,dz,u_dx,u_dy,u_dz in m, Z fastest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from otf_core.errors import ConfigError, InputError
from otf_core.exports.format import POINT_WORDS, ExportedFiles, Format, Request
from otf_core.exports.lattice import Lattice, sampled_lattice
from otf_core.files.text_table import (
    LENGTHS,
    fault_words,
    known_lengths,
    read_text_table,
    split_heading,
)
from otf_core.prediction.predict import predict

HEADER = ('x', 'y', 'z', 'dx', 'dy', 'dz', 'u_dx', 'u_dy', 'u_dz')
DECIMALS = 12
SAME_COORDINATE = 1e-9
"""m; coordinates that differ by less are one plane of the lattice."""


class LatticeCsv(Format):
    """Volumetric errors and their standard uncertainties on a lattice."""

    name = 'lattice-csv'
    value_words = POINT_WORDS
    lacks = (
        'values between lattice points (interpolate trilinearly), other target offsets '
        'than the measured one, correlations; differences between the directions of travel'
    )
    takes_points = True

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return 'dx, dy, dz are errors (actual minus nominal), u standard uncertainties; all in m'

    def export(self, request: Request) -> ExportedFiles:
        """Make the CSV."""
        self.check(request)
        lattice, remarks = sampled_lattice(request.content.tables, request.points)
        q = lattice.points
        rounded = Lattice(lattice.axes, lattice.error.round(DECIMALS) + 0.0)
        u = predict(request.content, q).u.round(DECIMALS)
        rows = np.hstack([q.round(DECIMALS) + 0.0, rounded.error.reshape(-1, 3), u]).tolist()
        lines = [f'# {line}' for line in request.header(self)]
        lines += [','.join(HEADER)]  # no u outside the driven volume
        lines += [','.join(repr(v) if v == v else '' for v in row) for row in rows]
        return ExportedFiles(
            {request.name: ('\n'.join(lines) + '\n').encode()}, rounded.at, remarks
        )


def read_lattice_csv(path: str | Path) -> Lattice:
    """Read a lattice in any order of its points.

    Raises
    ------
    ConfigError
        Names file and line of what is wrong, or the point that is missing.
    """
    q, error = _columns(path)
    axes, places = [], []
    for k in range(3):
        order = np.unique(q[:, k])
        axes.append(order[np.concatenate([[True], np.diff(order) > SAME_COORDINATE])])
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
            f'{path}: not a regular lattice: {len(q)} points, '
            f'{" x ".join(map(str, shape))} planes, {what}'
        )
    if min(shape) < 2:
        raise ConfigError(f'{path}: needs two points along every axis, got {shape}')
    return Lattice((axes[0], axes[1], axes[2]), filled)


def _columns(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions and errors, each (n, 3), m, or in the units that the header states."""
    wanted = HEADER[:6]
    try:
        table = read_text_table(path, _is_head)
    except InputError as error:
        raise ConfigError(f'{error}; expected the header {",".join(wanted)}') from None
    if table.names is None:
        raise ConfigError(f'{path}: expected the header {",".join(wanted)}, in m')
    headings = [split_heading(name) for name in table.names]
    names = [name.lower() for name, _ in headings]
    places = [names.index(name) for name in wanted]
    read, _ = table.numbers({place: table.names[place] for place in places})
    faults = dict(table.faults)
    for column in read:
        faults |= {table.lines[row]: reason for row, reason in column.faults.items()}
    if faults:
        raise ConfigError(
            f'{path}: line {min(faults)}: expected six numbers; {fault_words(faults)}'
        )
    values = np.stack([column.values for column in read], axis=1)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise ConfigError(f'{path}: line {table.lines[bad[0]]}: not finite')
    for k, place in enumerate(places):
        unit = headings[place][1] or 'm'
        if unit not in LENGTHS:
            raise ConfigError(
                f'{path}: {table.names[place]}: no unit of length; possible: {known_lengths()}'
            )
        values[:, k] *= LENGTHS[unit]
    return values[:, :3], values[:, 3:]


def _is_head(fields: Sequence[str]) -> bool:
    return set(HEADER[:6]) <= {split_heading(field)[0].lower() for field in fields}


FORMAT = LatticeCsv()
