# SPDX-License-Identifier: Apache-2.0
"""Direct measurement of error motions (paper 2.3): six errors along each axis, several runs.

An instrument measures along one line per axis, so its translations hold the rotations of the
axis times the lever of that line (Abbe). With the measured rotations the lever is taken off, which
gives translations as ``kinematics`` defines them: t = measured - r x L.

CSV layout, one row a reading::

    # point Y: 0.3,,-0.2
    # target_offset: 0.0,0.0,-0.15
    axis,run,direction,position_m,EX_m,EY_m,EZ_m,EA_rad,EB_rad,EC_rad
    X,1,forward,0.0,0.0,0.0,0.0,0.0,0.0,0.0

``direction`` is forward or backward. Units stand in the header: position and translations in m, mm
or um, rotations in rad, urad or arcsec. Columns of errors the instrument lacks may be left out.
Comment lines state where it was done: ``point A`` the positions of the other two axes, m, and
``target_offset`` the measured point, m, as in machine.yaml; left out, mid-range and the machine's.
``u_length_scale`` is the standard uncertainty of the instrument's length unit, m/m; 0 if left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from otf_core.arrays import Array
from otf_core.errors import InputError
from otf_core.model.kinematics import motion_influence
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS, MOTIONS, SQUARENESS, ErrorMotion
from otf_core.model.tables import ErrorTables, MotionTable, Squareness

ROTATIONS = DIRECTIONS[3:]


@dataclass(frozen=True)
class AxisReadings:
    """Readings along one axis.

    Attributes
    ----------
    position : ndarray, shape (k,), m
        Positions, ascending.
    value : ndarray, shape (r, 2, k, 6), m and rad
        Runs, forward and backward, positions, errors X Y Z A B C; nan where not measured.
    point : ndarray, shape (3,), m
        Positions of the axes; that of the measured axis counts for nothing.
    """

    position: Array
    value: Array
    point: Array

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Which of the six errors were measured, shape (6,)."""
        return np.asarray(np.isfinite(self.value).any(axis=(0, 1, 2)))


@dataclass(frozen=True)
class DirectMeasurement:
    """A direct measurement of a machine: readings of the axes that were measured.

    Attributes
    ----------
    axes : mapping of axis name to AxisReadings
    target_offset : ndarray, shape (3,), m, or None
        Measured point; None if it is the machine's.
    u_length_scale : float
        m/m, standard uncertainty of the instrument's length unit.
    note : str
        What made the readings.
    """

    axes: Mapping[str, AxisReadings]
    target_offset: Array | None = None
    u_length_scale: float = 0.0
    note: str = ''


@dataclass(frozen=True)
class MotionReadings:
    """One error motion as measured directly, as ``kinematics`` defines it.

    Attributes
    ----------
    position : ndarray, shape (k,), m
    forward, backward : ndarray, shape (r, k), m or rad
        One row a run.
    """

    position: Array
    forward: Array
    backward: Array

    @property
    def mean(self) -> Array:
        """Mean of both directions over the runs, shape (k,)."""
        return np.asarray(0.5 * (self.forward.mean(axis=0) + self.backward.mean(axis=0)))

    @property
    def u(self) -> float:
        """Standard uncertainty of the means: scatter of the runs, pooled over positions."""
        both = 0.5 * (self.forward + self.backward)
        if len(both) < 2:
            return 0.0
        places = both.shape[1]  # each run has lost its mean over them
        variance = both.var(axis=0, ddof=1).mean() * places / max(places - 1, 1)
        return float(np.sqrt(variance / len(both)))


def _relative_to_own_mean(rows: Array) -> Array:
    """Take the offset of every run off: where an instrument is set to zero is no error."""
    offset = rows.mean(axis=(1, 2), keepdims=True)
    return np.asarray(rows - offset + offset.mean())


def motion_readings(measurement: DirectMeasurement, machine: Machine) -> dict[str, MotionReadings]:
    """Return each measured error motion with the Abbe lever taken off.

    Raises
    ------
    InputError
        If a translation was measured on a lever but a rotation that acts on it was not.
    """
    offset = measurement.target_offset
    at = machine if offset is None else replace(machine, target_offset=offset)
    readings_by_motion = {}
    for axis, readings in measurement.axes.items():
        q = np.tile(readings.point, (len(readings.position), 1))
        q[:, machine.column(axis)] = readings.position
        value = readings.value.copy()
        for k, letter in enumerate(ROTATIONS, start=3):
            lever = motion_influence(at, ErrorMotion(letter, axis), q)
            if readings.measured[k]:
                value[..., :3] -= readings.value[..., k, None] * lever
            elif np.abs(lever).max() > 1e-3:
                raise InputError(
                    f'axis {axis}: E{letter}{axis} was not measured, but acts on the measured '
                    f'point over {1e3 * np.abs(lever).max():.0f} mm'
                )
        for letter, column, known in zip(
            DIRECTIONS, np.moveaxis(value, -1, 0), readings.measured, strict=True
        ):
            if known:
                rows = _relative_to_own_mean(column)
                readings_by_motion[f'E{letter}{axis}'] = MotionReadings(
                    readings.position, rows[:, 0], rows[:, 1]
                )
    return readings_by_motion


def tables_of_readings(
    motions: Mapping[str, MotionReadings], machine: Machine, u_length_scale: float = 0.0
) -> tuple[ErrorTables, Array]:
    """Error tables of the means of a direct measurement; squareness and what lacks are zero.

    Returns
    -------
    tables : ErrorTables
    covariance : ndarray, shape (m, m)
        Of the nodes of EXX ... ECZ: scatter of the runs, and the length unit that all positions
        of an axis share.
    """
    tables: dict[str, MotionTable] = {}
    blocks = []
    for name in MOTIONS:
        seen = motions.get(name)
        if seen is None:
            axis = machine.axes[name.axis]
            empty = np.zeros(2)
            tables[name] = MotionTable(np.array([axis.min, axis.max]), empty, empty, False)
            blocks.append(np.zeros((2, 2)))
            continue
        block = np.eye(len(seen.position)) * seen.u**2
        if name.is_positioning:
            travel = u_length_scale * (seen.position - seen.position[0])
            block += np.outer(travel, travel)
        tables[name] = MotionTable(seen.position, seen.mean, np.sqrt(np.diag(block)))
        blocks.append(block)
    squareness = {k: Squareness() for k in SQUARENESS}
    return ErrorTables(machine, tables, squareness), block_diag(*blocks)
