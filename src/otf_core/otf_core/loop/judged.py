# SPDX-License-Identifier: Apache-2.0
"""Volumetric error along lines that a control drove: true, and as a tracker sees it.

Where the program is the nominal path, the nominal position is where the control believes to be.
In a corrected program it belongs to the point of the program that the control has reached, found
by the length driven since the start: the control runs along the points of its program, so equal
shares of that length are equal places in it, whatever the correction has moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.loop.control import Driven
from otf_core.model.evaluation import mean_length, without_rigid_motion
from otf_core.model.path import NominalPath
from otf_core.pieces.runs import Recording, prepare_runs, rigid_pose

REACHED = 2e-6
"""m; the control stands at a point."""
STEP = 1e-3
"""m; the error is taken this often along the path."""
DETOUR = 1e-4
"""Largest relative difference of the length driven from that of the program."""


@dataclass(frozen=True)
class OnPath:
    """Moments spread evenly along a path.

    Attributes
    ----------
    row : ndarray of int64, shape (n,)
        Servo periods.
    nominal : ndarray, shape (n, 3), m
        Where the target should be.
    share : ndarray, shape (n,)
        Of the whole path.
    """

    row: NDArray[np.int64]
    nominal: Array
    share: Array


def start_row(driven: Driven, point: Array) -> int:
    """First servo period in which the control stands at the start of the path."""
    there = np.flatnonzero(np.linalg.norm(driven.believed - point, axis=1) < REACHED)
    if not len(there):
        raise InputError('LinuxCNC: never reached the start of the path')
    return int(there[0])


def on_path(driven: Driven, programmed: NominalPath, nominal: NominalPath | None = None) -> OnPath:
    """Find what the control was to drive at each moment.

    Parameters
    ----------
    driven : Driven
    programmed : NominalPath
        Points of the program.
    nominal : NominalPath, optional
        Where the target should be at these points, if not there.

    Raises
    ------
    InputError
        If the control drove another length than that of its program.
    """
    first = start_row(driven, programmed.points[0])
    moved = np.linalg.norm(np.diff(driven.believed[first:], axis=0), axis=1)
    reach = np.concatenate([[0.0], np.cumsum(moved)])
    corners = np.concatenate([[0.0], np.cumsum(programmed.leg_lengths)])
    if abs(reach[-1] - corners[-1]) > DETOUR * corners[-1]:
        raise InputError(f'LinuxCNC: drove {reach[-1]:.6f} m of a program of {corners[-1]:.6f} m')
    reach *= corners[-1] / reach[-1]
    wanted = np.arange(STEP, corners[-1], STEP)
    row = np.minimum(np.searchsorted(reach, wanted), len(reach) - 1)
    if nominal is None:
        return OnPath(first + row, driven.believed[first + row], wanted / corners[-1])
    at = reach[row]
    points = np.stack([np.interp(at, corners, nominal.points[:, k]) for k in range(3)], axis=1)
    return OnPath(first + row, points, wanted / corners[-1])


def by_line(error: Array, at: OnPath, path: NominalPath) -> tuple[tuple[float, float], ...]:
    """Mean and largest length of the errors on each line, best rigid motion of all taken out.

    Parameters
    ----------
    error : ndarray, shape (n, 3), m
    at : OnPath
    path : NominalPath
        The lines.

    Returns
    -------
    tuple of (mean, largest), m
        One pair a line.
    """
    length = np.linalg.norm(without_rigid_motion(error, at.nominal), axis=1)
    ends = np.cumsum(path.leg_lengths)
    line = np.minimum(np.searchsorted(ends, at.share * ends[-1]), len(ends) - 1)
    own = [length[line == k] for k in range(len(ends))]
    return tuple((float(v.mean()), float(v.max())) for v in own)


def volumetric(error: Array, q: Array) -> float:
    """Mean length of errors (n, 3) at positions (n, 3), best rigid motion taken out, m."""
    return mean_length(without_rigid_motion(error, q))


def seen_from_lines(recording: Recording) -> float:
    """Mean distance of tracker samples from the lines, rigidly aligned, m.

    What a real machine shows: without a common clock nothing is seen along the line.
    """
    config = CalibrationConfig()
    (run, *_), _ = prepare_runs([recording], config)
    points = rigid_pose(run.pieces, run.pose, config).apply(run.pieces.xyz)
    away = points - run.pieces.origin
    along = np.einsum('ij,ij->i', away, run.pieces.direction)
    return mean_length(away - along[:, None] * run.pieces.direction)
