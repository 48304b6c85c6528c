# SPDX-License-Identifier: Apache-2.0
"""Volumetric errors predicted from error tables, with their standard uncertainty.

u is that of the tables (linear propagation of their covariance) and, where the file holds a
``prior``, what lies beyond them: see ``table_prior``. Without it u is that of the nearest end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.model.kinematics import displacement
from otf_core.model.machine import AXES
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables, TablesFile, load_tables
from otf_core.prediction.covariance import unpack_covariance
from otf_core.prediction.driven_volume import driven_from_dict, inside, table_ranges
from otf_core.prediction.table_prior import (
    MotionPrior,
    growth_variance,
    prior_from_dict,
    unseen_columns,
)
from otf_core.prediction.uncertainty import prediction_uncertainty

Array = NDArray[np.float64]

ABSURD = 10.0
"""Points further outside than this many axis ranges are refused: another unit, most likely."""
LONGEST_OFFSET = 10.0
"""m; as in machine.yaml."""


@dataclass(frozen=True)
class Prediction:
    """Predicted errors.

    Attributes
    ----------
    error, u : ndarray, shape (n, 3), m
        Actual minus nominal, and its standard uncertainty (k = 1).
    inside : ndarray of bool, shape (n,)
        Whether a point lies in the driven volume.
    correlated : bool
        True if u takes account of the covariance between nodes; False if only the nodes' own
        uncertainties were known and they were taken as independent.
    holds : str
        What u contains, in words.
    notes : tuple of str
        What the user should know of these points: outside, no prior, rotations not seen.
    """

    error: Array
    u: Array
    inside: NDArray[np.bool_]
    correlated: bool
    holds: str
    notes: tuple[str, ...]

    @property
    def summary(self) -> str:
        """One line: how many points, and means."""
        error, u = (1e6 * np.linalg.norm(v, axis=1).mean() for v in (self.error, self.u))
        count = f'{len(self.u)} point{"s" if len(self.u) > 1 else ""}'
        return (
            f'{count}: mean |error| {error:.4g} um, mean |u| {u:.3g} um '
            f'(lengths of vectors, k = 1; u holds {self.holds})'
        )


def _independent(tables: ErrorTables) -> Array:
    own = [np.array([tables.squareness[k].u]) for k in SQUARENESS]
    own += [tables.motions[k].u for k in MOTIONS]
    return np.diag(np.concatenate(own) ** 2)


def _contained(tables: ErrorTables, extra: Mapping[str, Any]) -> str:
    budget = extra.get('budget')
    if not isinstance(budget, Mapping) or not isinstance(budget.get('not_stated'), list):
        return 'what the tables hold, which their file does not say'
    missing = ', '.join(map(str, budget['not_stated']))
    if not missing:
        return 'noise, misfit and the declared systematic contributions'
    if tables.machine.uncertainty is None:
        return 'noise and misfit only, no systematic contribution'
    return f'noise, misfit and what was declared, but not: {missing}'


def _check_points(tables: ErrorTables, q: Array, where: str) -> list[str]:
    """Refuse points that no such machine can reach; tell of those outside its axes."""
    machine, (low, high) = tables.machine, table_ranges(tables)
    low, high = np.minimum(low, machine.lower), np.maximum(high, machine.upper)
    out = np.maximum(np.maximum(low - q, q - high), 0.0)
    absurd = out > ABSURD * (high - low)
    if absurd.any():
        point, k = (int(i) for i in np.argwhere(absurd)[0])
        scaled = np.all((1e-3 * q >= low - 0.1) & (1e-3 * q <= high + 0.1))
        x, y, z = q[point]
        raise ConfigError(
            f'{where}: point {point + 1} ({x:g}, {y:g}, {z:g}) lies {out[point, k]:g} m outside '
            f'the range of axis {AXES[k]}, {low[k]:g} m to {high[k]:g} m; points are in m'
            + (', and these look like mm: divide them by 1000' if scaled else '')
        )
    count = int(np.sum(np.any(out > 1e-6, axis=1)))
    if not count:
        return []
    k = int(np.argmax(out.max(axis=0)))
    return [
        f'{count} of {len(q)} points lie outside the axis ranges of the machine, by up to '
        f'{1e3 * out[:, k].max():.4g} mm (axis {AXES[k]})'
    ]


def _outside_note(within: NDArray[np.bool_], prior: Mapping[str, MotionPrior]) -> list[str]:
    count = int(np.sum(~within))
    if not count:
        return []
    grows = (
        'tables are constant there, and u grows by their prior'
        if prior
        else 'tables are constant there; the file holds no prior, so u does not grow there and is '
        'too small'
    )
    return [f'{count} of {len(within)} points lie outside the driven volume; {grows}']


def _unseen_note(unseen: Mapping[str, Array], prior: Mapping[str, MotionPrior]) -> list[str]:
    known = [m for m in unseen if m in prior and prior[m].sd > 0]
    notes = []
    if known:
        notes.append(
            f'{", ".join(known)} were not seen and act on these points; u holds them by their '
            f'prior'
        )
    if len(known) < len(unseen):
        others = ', '.join(m for m in unseen if m not in known)
        notes.append(
            f'{others} were not seen and act on these points; the file holds no prior of them, so '
            f'u does not hold them and is too small'
        )
    return notes


def _unseen(tables: ErrorTables, extra: Mapping[str, Any]) -> list[str]:
    """Names of motions and squareness errors that the data did not see."""
    listed = extra.get('not_identifiable')
    squareness = [n for n in SQUARENESS if isinstance(listed, list) and n in listed]
    return [*squareness, *(m for m in MOTIONS if not tables.motions[m].identifiable)]


def _offset(tables: ErrorTables, wanted: Array | None) -> Array:
    if wanted is None:
        return tables.machine.target_offset
    offset = np.asarray(wanted, dtype=float)
    if offset.shape != (3,) or not np.all(np.isfinite(offset)):
        raise ConfigError('target_offset: expected three finite numbers, in m')
    if np.max(np.abs(offset)) > LONGEST_OFFSET:
        raise ConfigError(f'target_offset: {offset.tolist()} m is no length of a tool; unit is m')
    return offset


def predict(
    source: str | Path | TablesFile,
    q: Array,
    target_offset: Array | None = None,
    where: str = 'points',
) -> Prediction:
    """Evaluate an error_tables.json.

    Parameters
    ----------
    source : str, Path or TablesFile
        A file or what it holds, in any gauge; its covariance, if any, is used, and likewise its
        prior.
    q : ndarray, shape (n, 3), m
        Programmed axis positions.
    target_offset : ndarray, shape (3,), m, optional
        Predict for this one instead of the one that was measured with, e.g. for another tool.
        Rotations that the data did not see act through the difference: they enter u by their
        prior, never the errors.
    where : str
        What the points are called in messages.

    Raises
    ------
    ConfigError
        If the tables cannot be read, or points or offset are not of such a machine.
    """
    content = source if isinstance(source, TablesFile) else load_tables(source)
    name = 'tables' if isinstance(source, TablesFile) else str(source)
    measured, extra = content.tables, content.extra
    prior = prior_from_dict(extra.get('prior'), name)
    driven = driven_from_dict(extra.get('driven'), name)
    offset, (low, high) = _offset(measured, target_offset), table_ranges(measured)
    notes = _check_points(measured, q, where)
    tables = replace(measured, machine=replace(measured.machine, target_offset=offset))
    nodes: dict[str, Array] = {m: tables.motions[m].position for m in MOTIONS}
    size = len(SQUARENESS) + sum(len(v) for v in nodes.values())
    covariance = unpack_covariance(extra.get('covariance'), size)
    known = covariance is not None
    if covariance is None:
        covariance = _independent(tables)
        notes.append('the tables hold no covariance; u takes their nodes as independent')
    u = prediction_uncertainty(tables.machine, nodes, covariance, q)
    unseen = unseen_columns(measured, _unseen(measured, extra), q, low, high, offset)
    variance = u**2 + growth_variance(tables, prior, q)
    for motion, columns in unseen.items():
        variance = variance + (prior.get(motion, MotionPrior()).sd * columns) ** 2
    within = inside(measured, driven, q)
    notes += [*_outside_note(within, prior), *_unseen_note(unseen, prior)]
    return Prediction(
        displacement(tables, q),
        np.sqrt(variance),
        within,
        known,
        _contained(measured, extra),
        tuple(notes),
    )
