# SPDX-License-Identifier: Apache-2.0
"""Comparison of error tables motion by motion and over the volume (paper 2.3.1 and 2.3.2).

The normalised error E_n = |a - b| / sqrt(U_a^2 + U_b^2), with U = 2 u (ISO 13528), is below 1
where two sources agree within their stated uncertainties.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.convention import (
    Common,
    Source,
    common_ground,
    operator,
    squareness_rows,
    vector_rows,
)
from otf_core.comparison.direct_csv import read_direct_csv
from otf_core.errors import ConfigError
from otf_core.model.direct_measurement import (
    DirectMeasurement,
    motion_readings,
    tables_of_readings,
)
from otf_core.model.evaluation import mean_length, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables, load_tables
from otf_core.prediction.covariance import unpack_covariance
from otf_core.prediction.driven_volume import table_ranges

COVERAGE_FACTOR = 2.0
"""k of the expanded uncertainties."""
GRID = 7
"""points per axis."""


@dataclass(frozen=True)
class MotionComparison:
    """One error motion of two sources in one convention.

    Attributes
    ----------
    position : ndarray, shape (k,), m
    a, b, u_a, u_b : ndarray, shape (k,), m or rad
        Values and standard uncertainties.
    """

    position: Array
    a: Array
    b: Array
    u_a: Array
    u_b: Array

    @property
    def difference(self) -> Array:
        """Value of b less that of a, shape (k,)."""
        return self.b - self.a

    @property
    def normalised(self) -> Array:
        """E_n, shape (k,); nan where the convention fixes both values."""
        return normalised_error(self.difference, np.hypot(self.u_a, self.u_b))


@dataclass(frozen=True)
class SquarenessComparison:
    """A squareness error of two sources in the gauge of the common motions, rad; u: k = 1."""

    a: float
    b: float
    u_a: float
    u_b: float

    @property
    def difference(self) -> float:
        """Value of b less that of a."""
        return self.b - self.a

    @property
    def normalised(self) -> float:
        """E_n; nan where no uncertainty is known."""
        u = np.array([np.hypot(self.u_a, self.u_b)])
        return float(normalised_error(np.array([self.difference]), u)[0])


@dataclass(frozen=True)
class VolumeComparison:
    """Error vectors of two sources on points.

    Attributes
    ----------
    q : ndarray, shape (n, 3), m
    a, b : ndarray, shape (n, 3), m
        Motions in one convention, squareness left out as in the paper.
    u : ndarray, shape (n, 3), m
        Standard uncertainty of the difference.
    squareness : tuple of float, or None
        Mean lengths of a, b and b - a with everything the sources know, squareness included and
        the rigid motion taken out, both at the target offset of a; None if one of them lacks
        squareness.
    """

    q: Array
    a: Array
    b: Array
    u: Array
    squareness: tuple[float, float, float] | None

    @property
    def difference(self) -> Array:
        """Vectors of b less those of a, shape (n, 3), m."""
        return self.b - self.a

    @property
    def normalised(self) -> Array:
        """E_n of every component, shape (n, 3)."""
        return normalised_error(self.difference, self.u)


@dataclass(frozen=True)
class Comparison:
    """Two sources compared.

    Attributes
    ----------
    names : tuple of str
    offsets : tuple of ndarray, shape (3,), m
        Target offsets.
    common : Common
    motions : mapping of motion to MotionComparison
    squareness : mapping of name to SquarenessComparison
        Those that both know.
    volume : VolumeComparison
    """

    names: tuple[str, str]
    offsets: tuple[Array, Array]
    common: Common
    motions: Mapping[str, MotionComparison]
    squareness: Mapping[str, SquarenessComparison]
    volume: VolumeComparison

    @property
    def without_u(self) -> tuple[str, ...]:
        """Which of 'a' and 'b' state no uncertainty of any motion: they count as exact in E_n."""
        sides = {
            'a': [m.u_a for m in self.motions.values()],
            'b': [m.u_b for m in self.motions.values()],
        }
        return tuple(side for side, u in sides.items() if not np.concatenate(u).any())


def normalised_error(difference: Array, u: Array) -> Array:
    """E_n for a difference and its standard uncertainty; nan where both are zero."""
    limit = COVERAGE_FACTOR * u
    known = limit > 1e-12 * max(float(np.abs(difference).max(initial=0.0)), 1e-12)
    return np.asarray(np.where(known, np.abs(difference) / np.where(known, limit, 1.0), np.nan))


def source_of_tables(
    name: str, tables: ErrorTables, covariance: Array | None, hidden: Collection[str] = ()
) -> Source:
    """Source of error tables.

    Parameters
    ----------
    name : str
    tables : ErrorTables
    covariance : ndarray, shape (3 + m, 3 + m), optional
        Of squareness errors and nodes; independent values if not given.
    hidden : collection of str
        Squareness errors that are not known.
    """
    known = tuple(n for n in SQUARENESS if n not in hidden)
    if covariance is None:
        square = [tables.squareness[n].u for n in SQUARENESS]
        u = np.concatenate([square, *(tables.motions[m].u for m in MOTIONS)])
        covariance = np.diag(u**2)
    return Source(name, tables, covariance, known)


def source_of_measurement(name: str, measurement: DirectMeasurement, machine: Machine) -> Source:
    """Source of a direct measurement: means over runs and directions, u from their scatter."""
    motions = motion_readings(measurement, machine)
    at = machine
    if measurement.target_offset is not None:
        at = replace(machine, target_offset=measurement.target_offset)
    tables, covariance = tables_of_readings(motions, at, measurement.u_length_scale)
    whole = np.zeros((len(SQUARENESS) + len(covariance),) * 2)
    whole[len(SQUARENESS) :, len(SQUARENESS) :] = covariance
    return Source(name, tables, whole, ())


def load_source(path: str | Path, machine: Machine | None) -> Source:
    """Read error_tables.json or, for the machine given, a direct measurement in CSV."""
    if Path(path).suffix.lower() == '.csv':
        if machine is None:
            raise ConfigError(f'{path}: a direct measurement needs --machine')
        return source_of_measurement(Path(path).stem, read_direct_csv(path, machine), machine)
    content = load_tables(path)
    size = len(SQUARENESS) + sum(len(content.tables.motions[m].position) for m in MOTIONS)
    covariance = unpack_covariance(content.extra.get('covariance'), size)
    name = Path(path).parent.name if Path(path).stem == 'error_tables' else Path(path).stem
    hidden = content.extra.get('not_identifiable') or ()
    return source_of_tables(name or str(path), content.tables, covariance, hidden)


def _common_grid(sources: Sequence[Source]) -> Array:
    """Points over the common range; in the plane or line that a source did not leave."""
    lows, highs = zip(*(table_ranges(s.tables) for s in sources), strict=True)
    low = np.max(lows, axis=0)
    high = np.maximum(low, np.min(highs, axis=0))
    axes = (np.unique(np.linspace(a, b, GRID)) for a, b in zip(low, high, strict=True))
    return np.stack([g.ravel() for g in np.meshgrid(*axes, indexing='ij')], axis=1)


def _with_squareness(
    a: Source, b: Source, machine: Machine, q: Array
) -> tuple[float, float, float] | None:
    if not (a.squareness and b.squareness):
        return None
    tables = (replace(s.tables, machine=machine) for s in (a, b))
    fields = [without_rigid_motion(displacement(own, q), q) for own in tables]
    return mean_length(fields[0]), mean_length(fields[1]), mean_length(fields[1] - fields[0])


def _squareness(a: Source, b: Source, common: Common, q: Array) -> dict[str, SquarenessComparison]:
    """Squareness errors that both know, between axes that moved in both."""
    moved = {axis for axis, p in common.position.items() if len(p) > 1}
    pairs = {'C0Y': {'X', 'Y'}, 'B0Z': {'X', 'Z'}, 'A0Z': {'Y', 'Z'}}
    names = [n for n in a.squareness if n in b.squareness and pairs[n] <= moved]
    if not names:
        return {}
    values, spreads = [], []
    for source in (a, b):
        rows = squareness_rows(source, common, q)
        values.append(rows @ source.all_values)
        spreads.append(np.sqrt(np.maximum(np.diag(rows @ source.whole @ rows.T), 0.0)))
    at = [SQUARENESS.index(n) for n in names]
    return {
        n: SquarenessComparison(*(float(part[k]) for part in (*values, *spreads)))
        for n, k in zip(names, at, strict=True)
    }


def compare(a: Source, b: Source, points: Array | None = None) -> Comparison:
    """Compare two sources.

    Parameters
    ----------
    a, b : Source
    points : ndarray, shape (n, 3), m, optional
        Where error vectors are compared; a regular grid over the common ranges if not given.

    Raises
    ------
    ConfigError
        If they share no range or no motion.
    """
    common = common_ground([a, b])
    matrices = [operator(s, common) for s in (a, b)]
    values = [h @ s.values for h, s in zip(matrices, (a, b), strict=True)]
    covariances = [h @ s.covariance @ h.T for h, s in zip(matrices, (a, b), strict=True)]
    u = [np.sqrt(np.maximum(np.diag(c), 0.0)) for c in covariances]
    motions: dict[str, MotionComparison] = {}
    start = 0
    for motion in common.motions:
        position = common.position[motion.axis]
        part = slice(start, start + len(position))
        motions[motion] = MotionComparison(
            position, values[0][part], values[1][part], u[0][part], u[1][part]
        )
        start = part.stop
    q = _common_grid((a, b)) if points is None else points
    rows = vector_rows(common, q)[:, :, : -len(SQUARENESS)]
    flat = rows.reshape(-1, rows.shape[2])
    variance = np.einsum('ij,ij->i', flat @ (covariances[0] + covariances[1]), flat)
    volume = VolumeComparison(
        q,
        rows @ values[0],
        rows @ values[1],
        np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3),
        _with_squareness(a, b, common.machine, q),
    )
    offsets = a.tables.machine.target_offset, b.tables.machine.target_offset
    squareness = _squareness(a, b, common, _common_grid((a, b)))
    return Comparison((a.name, b.name), offsets, common, motions, squareness, volume)


def agreement(normalised: Array) -> float:
    """Share of normalised errors that do not exceed 1; nan without any uncertainty."""
    known = normalised[np.isfinite(normalised)]
    return float(np.mean(known <= 1.0)) if known.size else float('nan')
