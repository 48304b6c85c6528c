# SPDX-License-Identifier: Apache-2.0
"""Residuals of a calibration, one row a path piece: arrays in an .npz, or as text on request."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.calibration.result import RunResult
from otf_core.files.csv_points import write_csv
from otf_core.files.writing import whole_file

Array = NDArray[np.float64]

RESIDUALS_FILE = 'residuals.npz'
RESIDUALS_TEXT = 'residuals.csv'
_MOVING, _STANDING = ('2', '3'), ('1', '2', '3')
"""Names of the components of a deviation: two across the path; along the beam and two across."""


def residual_arrays(runs: Sequence[RunResult]) -> dict[str, NDArray[np.generic]]:
    """Return the residuals of all runs under the names of ``residuals.npz``.

    Returns
    -------
    dict of str to ndarray
        ``run``, ``leg``, ``count``, shape (n,); ``time``, s; ``speed``, m/s; ``q``, (n, 3), m;
        ``axes``, shape (n, c, 3), unit vectors; ``deviation``, ``residual``, shape (n, c), m.
    """
    pieces = [run.pieces for run in runs]
    sizes = [len(p) for p in pieces]
    counts = {
        'run': np.repeat(np.arange(len(runs)), sizes),
        'leg': np.concatenate([p.leg for p in pieces]),
        'count': np.concatenate([p.count for p in pieces]),
    }
    return {
        **{name: np.asarray(values, np.int32) for name, values in counts.items()},
        'time': np.concatenate([p.time for p in pieces]),
        'speed': np.concatenate([p.speed for p in pieces]),
        'q': np.concatenate([run.q for run in runs]),
        'axes': np.concatenate([np.stack(tuple(run.axes), axis=1) for run in runs]),
        'deviation': np.concatenate([run.deviation.T for run in runs]),
        'residual': np.concatenate([run.residual.T for run in runs]),
    }


def write_residuals(runs: Sequence[RunResult], folder: Path) -> None:
    """Write residuals.npz."""
    with whole_file(folder / RESIDUALS_FILE) as partial, partial.open('wb') as file:
        np.savez(file, allow_pickle=False, **residual_arrays(runs))


def write_residuals_text(runs: Sequence[RunResult], folder: Path) -> None:
    """Write residuals.csv, which takes a hundred times longer."""
    write_csv(folder / RESIDUALS_TEXT, *_table(residual_arrays(runs)))


def _table(arrays: Mapping[str, NDArray[np.generic]]) -> tuple[str, Array]:
    """Header and columns of the text, in which the counts are written as numbers with a point."""
    axes = arrays['axes']
    names = _STANDING if axes.shape[1] == len(_STANDING) else _MOVING
    header = ['run', 'time', 'leg', 'count', 'speed', 'x', 'y', 'z']
    header += [f'a{k}{axis}' for k in names for axis in 'xyz']
    header += [f'{what}{k}' for what in ('deviation', 'residual') for k in names]
    order = ('run', 'time', 'leg', 'count', 'speed', 'q')
    columns = [arrays[name] for name in order] + [axes.reshape(len(axes), -1)]
    columns += [arrays['deviation'], arrays['residual']]
    return ','.join(header), np.column_stack(columns).astype(np.float64)
