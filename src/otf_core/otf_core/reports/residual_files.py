# SPDX-License-Identifier: Apache-2.0
"""Residuals of a calibration as files: one row a path piece."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.calibration.axis_calibration import AxisCalibration
from otf_core.calibration.calibration_result import RunResult
from otf_core.files.writing import whole_file, write_csv
from otf_core.model.frames import XYZ
from otf_core.model.nodes import table_nodes
from otf_core.rotary.rows import piece_state

RESIDUALS_FILE = 'residuals.npz'
RESIDUALS_TEXT = 'residuals.csv'
_MOVING_NAMES, _STANDING_NAMES = ('2', '3'), ('1', '2', '3')
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


def residual_arrays_of_axes(result: AxisCalibration) -> dict[str, NDArray[np.generic]]:
    """Return the residuals of a machine with rotary axes in the same layout.

    Returns
    -------
    dict of str to ndarray
        As ``residual_arrays``, and ``part``, shape (n,): number of the part, from 0; ``q`` has a
        column for every axis, m and rad; vectors are in the frame of the tracker's link.
    """
    runs = result.solution.runs
    nodes = table_nodes(result.machine, *result.driven)
    states = [piece_state(s.run, s.system.q, nodes, result.tables) for s in runs]
    pieces = [s.run.pieces for s in runs]
    counts = {
        'run': np.repeat(np.arange(len(runs)), [len(p) for p in pieces]),
        'part': np.concatenate([p.part for p in pieces]),
        'leg': np.concatenate([p.leg for p in pieces]),
        'count': np.concatenate([p.count for p in pieces]),
    }
    return {
        **{name: np.asarray(values, np.int32) for name, values in counts.items()},
        'time': np.concatenate([p.time for p in pieces]),
        'speed': np.concatenate([s.speed for s in states]),
        'q': np.concatenate([s.system.q for s in runs]),
        'axes': np.concatenate([np.stack(tuple(s.system.axes), axis=1) for s in runs]),
        'deviation': np.concatenate([s.system.deviation.T for s in runs]),
        'residual': np.concatenate([s.residual.T for s in runs]),
    }


def write_residuals(arrays: Mapping[str, NDArray[np.generic]], folder: Path) -> None:
    """Write residuals.npz."""
    with whole_file(folder / RESIDUALS_FILE) as partial, partial.open('wb') as file:
        np.savez(file, allow_pickle=False, **arrays)


def write_residuals_text(
    arrays: Mapping[str, NDArray[np.generic]], folder: Path, axis_names: Sequence[str] = XYZ
) -> None:
    """Write residuals.csv, which takes a hundred times longer."""
    write_csv(folder / RESIDUALS_TEXT, *_text_columns(arrays, axis_names))


def _text_columns(
    arrays: Mapping[str, NDArray[np.generic]], axis_names: Sequence[str]
) -> tuple[str, Array]:
    """Header and columns of the text, in which the counts are written as numbers with a point."""
    axes = arrays['axes']
    names = _STANDING_NAMES if axes.shape[1] == len(_STANDING_NAMES) else _MOVING_NAMES
    numbers = ['run', 'part'] if 'part' in arrays else ['run']
    header = [*numbers, 'time', 'leg', 'count', 'speed', *(a.lower() for a in axis_names)]
    header += [f'a{k}{axis}' for k in names for axis in 'xyz']
    header += [f'{what}{k}' for what in ('deviation', 'residual') for k in names]
    order = (*numbers, 'time', 'leg', 'count', 'speed', 'q')
    columns = [arrays[name] for name in order] + [axes.reshape(len(axes), -1)]
    columns += [arrays['deviation'], arrays['residual']]
    return ','.join(header), np.column_stack(columns).astype(np.float64)
