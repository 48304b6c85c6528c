# SPDX-License-Identifier: Apache-2.0
"""Residuals of a calibration as files: one row a path piece."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.calibration.calibration_result import RunResult
from otf_core.files.writing import whole_file, write_csv

RESIDUALS_FILE = 'residuals.npz'
RESIDUALS_TEXT = 'residuals.csv'
_MOVING_NAMES, _STANDING_NAMES = ('2', '3'), ('1', '2', '3')
"""Names of the components of a deviation: two across the path; along the beam and two across."""


def residual_arrays(runs: Sequence[RunResult]) -> dict[str, NDArray[np.generic]]:
    """Return the residuals of all runs under the names of ``residuals.npz``.

    Returns
    -------
    dict of str to ndarray
        ``run``, ``part``, ``leg``, ``count``, shape (n,); ``time``, s; ``speed``, m/s; ``q``,
        (n, k), m and rad; ``axes``, shape (n, c, 3), unit vectors in the frame of the tracker's
        link; ``deviation``, ``residual``, shape (n, c), m.
    """
    pieces = [run.pieces for run in runs]
    counts = {
        'run': np.repeat(np.arange(len(runs)), [len(p) for p in pieces]),
        'part': np.concatenate([run.part for run in runs]),
        'leg': np.concatenate([p.leg for p in pieces]),
        'count': np.concatenate([p.count for p in pieces]),
    }
    return {
        **{name: np.asarray(values, np.int32) for name, values in counts.items()},
        'time': np.concatenate([p.time for p in pieces]),
        'speed': np.concatenate([run.speed for run in runs]),
        'q': np.concatenate([run.q for run in runs]),
        'axes': np.concatenate([np.stack(tuple(run.axes), axis=1) for run in runs]),
        'deviation': np.concatenate([run.deviation.T for run in runs]),
        'residual': np.concatenate([run.residual.T for run in runs]),
    }


def write_residuals(arrays: Mapping[str, NDArray[np.generic]], folder: Path) -> None:
    """Write residuals.npz."""
    with whole_file(folder / RESIDUALS_FILE) as partial, partial.open('wb') as file:
        np.savez(file, allow_pickle=False, **arrays)


def write_residuals_text(
    arrays: Mapping[str, NDArray[np.generic]], folder: Path, axis_names: Sequence[str]
) -> None:
    """Write residuals.csv, which takes a hundred times longer."""
    write_csv(folder / RESIDUALS_TEXT, *_text_columns(arrays, axis_names))


def _text_columns(
    arrays: Mapping[str, NDArray[np.generic]], axis_names: Sequence[str]
) -> tuple[str, Array]:
    """Header and columns of the text, in which the counts are written as numbers with a point."""
    axes = arrays['axes']
    names = _STANDING_NAMES if axes.shape[1] == len(_STANDING_NAMES) else _MOVING_NAMES
    numbers = ['run', 'part', 'time', 'leg', 'count', 'speed']
    header = [*numbers, *(a.lower() for a in axis_names)]
    header += [f'a{k}{axis}' for k in names for axis in 'xyz']
    header += [f'{what}{k}' for what in ('deviation', 'residual') for k in names]
    columns = [arrays[name] for name in (*numbers, 'q')] + [axes.reshape(len(axes), -1)]
    columns += [arrays['deviation'], arrays['residual']]
    return ','.join(header), np.column_stack(columns).astype(np.float64)
