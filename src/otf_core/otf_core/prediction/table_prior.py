# SPDX-License-Identifier: Apache-2.0
"""How uncertain error motions are where no data hold them, by the block ``prior`` of the tables.

``prior: {MOTION: {"slope": s, "intensity": q, "sd": r, "length": l}}``, every part optional:

- Beyond the end of a table, at a distance d, the motion goes on with a slope of the size s (m/m or
  rad/m), with smooth waves of the size r (m or rad) and the length l (m), and as an integrated
  random walk, its second derivative white with intensity q (m^2/m^3 or rad^2/m^3). Tables are
  constant there, so the variance added is

      v(d) = s^2 d^2 + 2 r^2 ( 1 - exp(-d^2 / (2 l^2)) ) + q d^3 / 3

- A rotation that the data do not see (``identifiable: false``) is written as zero; r (rad) is the
  standard deviation of what it may be. Inside what was driven, at the target offset T that was
  measured with, it needs no place in u: r_a x L_a is there what other motions can do as well, and
  their tables hold it. At another point or with another offset T' the lever L_a differs from the
  one that the tables hold it for, and the difference is missing from them:

      e(q, T') - tables = r_a(q_a) x ( L_a(q, T') - L_a(c(q), T) )

  c(q) is q moved into the driven range axis by axis. Inside the range the difference is T' - T;
  at the offset measured it is the travel by which q leaves the range, e.g. that of a plane.

- A squareness error that the data do not see (``not_identifiable``) acts in the same way through
  the travel by which q leaves the range.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.kinematics import lever, motion_influence, squareness_influence, turn_arms
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion
from otf_core.model.tables import ErrorTables
from otf_core.prediction.driven_volume import table_ranges

PARTS = ('slope', 'intensity', 'sd', 'length')
NO_LEVER = 1e-9
"""m; shorter levers are rounding."""


@dataclass(frozen=True)
class MotionPrior:
    """What is known of one error motion, or squareness error, without data.

    Attributes
    ----------
    slope : float
        Standard deviation of the slope at the ends of the table, m/m or rad/m.
    intensity : float
        Of the second derivative as white noise, m^2/m^3 or rad^2/m^3.
    sd : float
        Standard deviation of the motion itself about zero, m or rad; as a whole it counts where
        it is not seen.
    length : float
        Of the waves of the motion, m; 0: none.
    """

    slope: float = 0.0
    intensity: float = 0.0
    sd: float = 0.0
    length: float = 0.0

    def beyond(self, distance: Array) -> Array:
        """Variance added at distances (n,) m beyond the end of the table; zero inside."""
        d = np.maximum(distance, 0.0)
        total = self.slope**2 * d**2 + self.intensity * d**3 / 3.0
        if self.length:
            total -= 2.0 * self.sd**2 * np.expm1(-0.5 * (d / self.length) ** 2)
        return np.asarray(total)


def prior_from_dict(data: Any, where: str) -> dict[str, MotionPrior]:
    """Read the block ``prior`` of an error_tables.json.

    Parameters
    ----------
    data : object
        None if the file holds none. Keys that are no motion and parts that are not known here
        are left alone: extra fields are welcome.
    where : str
        For messages.

    Returns
    -------
    mapping of motion or squareness error to MotionPrior
        Empty if there is none.

    Raises
    ------
    ConfigError
        Names the motion and the part that is not a number from zero on.
    """
    if data is None:
        return {}
    if not isinstance(data, Mapping):
        raise ConfigError(f'{where}: prior: expected motions with {", ".join(PARTS)}')
    names = (*SQUARENESS, *MOTIONS)
    return {n: _entry(data[n], f'{where}: prior: {n}') for n in names if n in data}


def _entry(entry: Any, where: str) -> MotionPrior:
    if not isinstance(entry, Mapping):
        raise ConfigError(f'{where}: expected {", ".join(PARTS)}, got {entry!r}')
    values = {}
    for part in PARTS:
        value = entry.get(part, 0.0)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or value < 0:
            raise ConfigError(f'{where}: {part}: expected a number from 0 on, got {value!r}')
        values[part] = float(value)
    return MotionPrior(**values)


def growth_variance(tables: ErrorTables, prior: Mapping[str, MotionPrior], q: Array) -> Array:
    """Variance that the ends of the tables add.

    Parameters
    ----------
    tables : ErrorTables
        With the target offset that is predicted for.
    prior : mapping of motion to MotionPrior
    q : ndarray, shape (n, 3), m

    Returns
    -------
    ndarray, shape (n, 3), m^2
    """
    total = np.zeros_like(q)
    for motion in (m for m in MOTIONS if m in prior):
        nodes, along = tables.motions[motion].position, q[:, motion.place]
        added = prior[motion].beyond(np.maximum(nodes[0] - along, along - nodes[-1]))
        total += added[:, None] * motion_influence(tables.machine, motion, q) ** 2
    return total


def _lever_change(
    tables: ErrorTables, axis: str, q: Array, low: Array, high: Array, offset: Array
) -> Array:
    """L_a(q, T') - L_a(c(q), T), shape (n, 3), m; see the head of this module."""
    there = lever(replace(tables.machine, target_offset=offset), axis, q)
    return np.asarray(there - lever(tables.machine, axis, np.clip(q, low, high)))


def unseen_columns(
    tables: ErrorTables, names: Iterable[str], q: Array, low: Array, high: Array, offset: Array
) -> dict[str, Array]:
    """Rotations and squareness errors that were not seen and act on the points all the same.

    Parameters
    ----------
    tables : ErrorTables
        With the target offset that was measured with.
    names : iterable of str
        What was not seen; translations have no lever and are left out.
    q : ndarray, shape (n, 3), m
    low, high : ndarray, shape (3,), m
        Driven range.
    offset : ndarray, shape (3,), m
        Target offset that is predicted for.

    Returns
    -------
    mapping of name to ndarray, shape (n, 3), m/rad
        Displacement per rad that the tables do not hold; without those that have none.
    """
    columns_by_name = {}
    for name in names:
        if name in SQUARENESS:
            columns = squareness_influence(name, q - np.clip(q, low, high))
        elif (motion := ErrorMotion.of(name)).is_translation:
            continue
        else:
            change = _lever_change(tables, motion.axis, q, low, high, offset)
            columns = turn_arms(motion.along, change)
        if np.any(np.abs(columns) > NO_LEVER):
            columns_by_name[name] = columns
    return columns_by_name


def unseen_variance(
    columns: Mapping[str, Array], prior: Mapping[str, MotionPrior], q: Array
) -> Array:
    """Variance (n, 3), m^2, that what was not seen adds at q (n, 3), by ``unseen_columns``."""
    total = np.zeros_like(q)
    for name, own in columns.items():
        total += (prior.get(name, MotionPrior()).sd * own) ** 2
    return total


def beyond_variance(
    tables: ErrorTables, prior: Mapping[str, MotionPrior], not_seen: Iterable[str], q: Array
) -> Array:
    """Variance (n, 3), m^2, at q (n, 3) beyond the tables at the offset that was measured with."""
    low, high = table_ranges(tables)
    offset = tables.machine.target_offset
    columns = unseen_columns(tables, not_seen, q, low, high, offset)
    return growth_variance(tables, prior, q) + unseen_variance(columns, prior, q)
