# SPDX-License-Identifier: Apache-2.0
"""Volumetric errors predicted from error tables, with their standard uncertainty.

u is that of the tables (linear propagation of their covariance) and, for another tool, of
rotations that the data do not see (``table_prior``). Outside the driven volume no u is stated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.tables import ErrorTables, TablesFile
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.predictor import PredictedErrors, Predictor

ABSURD = 10.0
"""Points further outside than this many axis ranges are refused: another unit, most likely."""


@dataclass(frozen=True)
class Prediction(PredictedErrors):
    """Predicted errors, and what is to be known of them.

    Attributes
    ----------
    correlated : bool
        True if u takes account of the covariance between nodes; False if only the nodes' own
        uncertainties were known and they were taken as independent.
    holds : str
        What u contains, in words.
    notes : tuple of str
        What the user should know of these points: outside, rotations not seen.
    """

    correlated: bool
    holds: str
    notes: tuple[str, ...]

    @property
    def summary(self) -> str:
        """One line: how many points, and means."""
        error, u = (1e6 * np.linalg.norm(v, axis=1) for v in (self.error, self.u[self.inside]))
        mean_u = f'mean |u| {u.mean():.3g} um' if len(u) else 'no u, as all lie outside'
        count = f'{len(self.u)} point{"s" if len(self.u) > 1 else ""}'
        return (
            f'{count}: mean |error| {error.mean():.4g} um, {mean_u} '
            f'(lengths of vectors, k = 1; u holds {self.holds})'
        )


LIKE_MM = 'mm: divide them by 1000, or write x_mm,y_mm,z_mm into the header'
LIKE_INCHES = 'inches: write x_in,y_in,z_in into the header'


def check_points(tables: ErrorTables, q: Array, where: str) -> list[str]:
    """Refuse points that no such machine can reach; tell of those outside its axes."""
    machine, (low, high) = tables.machine, table_ranges(tables)
    names = machine.axis_names
    if q.ndim != 2 or q.shape[1] != len(names):
        raise ConfigError(
            f'{where}: positions of {", ".join(names)} are needed, with the header '
            f'{",".join(names).lower()}; got {q.shape[-1]} columns'
        )
    low, high = np.minimum(low, machine.lower), np.maximum(high, machine.upper)
    at = machine.wrapped(q)
    out = np.maximum(np.maximum(low - at, at - high), 0.0)
    absurd = out > ABSURD * (high - low)
    if absurd.any():
        point, k = (int(i) for i in np.argwhere(absurd)[0])
        scaled = [
            words
            for factor, words in ((1e-3, LIKE_MM), (0.0254, LIKE_INCHES))
            if np.all((factor * q >= low - 0.1) & (factor * q <= high + 0.1))
        ]
        place, unit = ', '.join(f'{v:g}' for v in q[point]), machine.axes[names[k]].unit
        asked = f', and these look like {" or ".join(scaled)}' if scaled else ''
        if unit == 'rad':
            asked = '; is it in degrees?'
        raise ConfigError(
            f'{where}: point {point + 1} ({place}) lies {out[point, k]:g} {unit} outside '
            f'the range of axis {names[k]}, {low[k]:g} {unit} to {high[k]:g} {unit}; '
            f'points are in m{" and rad" if machine.rotary_names else ""}{asked}'
        )
    count = int(np.sum(np.any(out > 1e-6, axis=1)))
    if not count:
        return []
    k = int(np.argmax(out.max(axis=0)))
    return [
        f'{count} of {len(q)} points lie outside the axis ranges of the machine, by up to '
        f'{1e3 * out[:, k].max():.4g} m{machine.axes[names[k]].unit} (axis {names[k]})'
    ]


def _outside_note(within: NDArray[np.bool_]) -> list[str]:
    count = int(np.sum(~within))
    if not count:
        return []
    return [
        f'{count} of {len(within)} points lie outside the driven volume: tables are constant '
        f'there, and no u is stated'
    ]


def _unseen_note(unseen: Mapping[str, Array], prior: Mapping[str, float]) -> list[str]:
    known = [m for m in unseen if prior.get(m, 0.0) > 0]
    notes = []
    if known:
        notes.append(
            f'{", ".join(known)} were not determined and act on these points; u includes them by '
            f'their prior'
        )
    if len(known) < len(unseen):
        others = ', '.join(m for m in unseen if m not in known)
        notes.append(
            f'{others} were not determined and act on these points; the file contains no prior '
            f'for them, so u does not include them and is too small'
        )
    return notes


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
    q : ndarray, shape (n, k), m and rad
        Programmed axis positions, in the order of the axes of the machine.
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
    predictor = Predictor.of(source, target_offset)
    notes = [*check_points(predictor.tables, q, where), *predictor.lacking]
    if not predictor.correlated:
        notes.append('the tables hold no covariance; u takes their nodes as independent')
    prediction = predictor.at(q)
    notes += _outside_note(prediction.inside)
    notes += _unseen_note(predictor.unseen, predictor.prior)
    return Prediction(
        prediction.error,
        prediction.u,
        prediction.inside,
        predictor.correlated,
        predictor.holds,
        tuple(notes),
    )
