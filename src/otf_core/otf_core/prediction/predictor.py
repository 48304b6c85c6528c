# SPDX-License-Identifier: Apache-2.0
"""Error tables made ready to be evaluated again and again: at points of a file, or at 1 kHz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.kinematics import displacement
from otf_core.model.tables import ErrorTables, TablesFile, load_tables
from otf_core.prediction.covariance import unpack_covariance
from otf_core.prediction.driven_volume import DrivenVolume, driven_from_dict, inside
from otf_core.prediction.table_prior import prior_from_dict, unseen_columns
from otf_core.prediction.uncertainty import prediction_uncertainty

LONGEST_OFFSET = 10.0
"""m; as in machine.yaml."""
REPEATED = 2
"""Corrections of the commanded position: what the second leaves is below 1e-12 m for errors of
100 um that change by 1e-4."""


@dataclass(frozen=True)
class PredictedErrors:
    """Errors at positions.

    Attributes
    ----------
    error, u : ndarray, shape (n, 3), m
        Actual minus nominal, and its standard uncertainty (k = 1); u is not a number outside.
    inside : ndarray of bool, shape (n,)
        Whether a position lies in the driven volume.
    """

    error: Array
    u: Array
    inside: NDArray[np.bool_]


@dataclass(frozen=True)
class Predictor:
    """Error tables for one target offset, with all that their uncertainty needs.

    Attributes
    ----------
    tables : ErrorTables
        With the target offset that is predicted for.
    measured : ErrorTables
        With the one that was measured with.
    covariance : ndarray, shape (m, m)
        Of squareness and nodes, see ``uncertainty.prediction_rows``.
    correlated : bool
        False if the file holds no covariance: nodes are taken as independent.
    prior : mapping of motion to float
        Standard deviations of what was not seen.
    not_seen : tuple of str
        Motions and squareness errors that the data did not see.
    holds : str
        What u contains, in words.
    lacking : tuple of str
        What the file does not say and is zero therefore, in words.
    """

    tables: ErrorTables
    measured: ErrorTables
    covariance: Array
    correlated: bool
    prior: Mapping[str, float]
    driven: DrivenVolume | None
    not_seen: tuple[str, ...]
    holds: str
    lacking: tuple[str, ...] = ()

    @classmethod
    def of(cls, source: str | Path | TablesFile, target_offset: Array | None = None) -> Predictor:
        """Read tables.

        Parameters
        ----------
        target_offset : ndarray, shape (3,), m, optional
            See ``predict.predict``.

        Raises
        ------
        ConfigError
            If the tables cannot be read, or the offset is none.
        """
        content = source if isinstance(source, TablesFile) else load_tables(source)
        name = 'tables' if isinstance(source, TablesFile) else str(source)
        measured, extra = content.tables, content.extra
        machine = replace(measured.machine, target_offset=_offset(measured, target_offset))
        described = measured.machine
        size = len(described.scalars)
        size += sum(len(measured.motions[m].position) for m in described.motions)
        covariance = unpack_covariance(extra.get('covariance'), size)
        return cls(
            tables=replace(measured, machine=machine),
            measured=measured,
            covariance=_independent(measured) if covariance is None else covariance,
            correlated=covariance is not None,
            prior=prior_from_dict(extra.get('prior'), name),
            driven=driven_from_dict(extra.get('driven'), name),
            not_seen=_not_seen(measured, extra),
            holds=_contained(measured, extra),
            lacking=_lacking(content, covariance is None),
        )

    @property
    def unseen(self) -> Mapping[str, Array]:
        """Columns (3,) of what was not seen and acts through the new target offset."""
        if self.measured.machine.rotary_names:
            return {}
        offsets = (t.machine.target_offset for t in (self.tables, self.measured))
        return unseen_columns(self.not_seen, np.subtract(*offsets))

    def at(self, q: Array) -> PredictedErrors:
        """Evaluate at programmed axis positions (n, k), m and rad."""
        machine = self.tables.machine
        nodes: dict[str, Array] = {m: self.tables.motions[m].position for m in machine.motions}
        variance = prediction_uncertainty(machine, nodes, self.covariance, q) ** 2
        for name, column in self.unseen.items():
            variance += (self.prior.get(name, 0.0) * column) ** 2
        within = inside(self.measured, self.driven, q)
        u = np.where(within[:, None], np.sqrt(variance), np.nan)
        return PredictedErrors(displacement(self.tables, q), u, within)

    def corrected(self, wanted: Array) -> Array:
        """Positions to command (n, 3), m, so that the target comes to the wanted ones."""
        command = wanted
        for _ in range(REPEATED):
            command = wanted - displacement(self.tables, command)
        return command


def _lacking(content: TablesFile, from_nodes: bool) -> tuple[str, ...]:
    """What a file does not say, ``u`` only where it is taken ``from_nodes``."""
    notes = []
    if content.without_value:
        notes.append(
            f'the tables do not contain {", ".join(content.without_value)}: taken as zero'
        )
    if content.without_u and from_nodes:
        names = ', '.join(content.without_u)
        notes.append(f'the tables hold no u of {names}: taken as exact, so u is too small')
    return tuple(notes)


def _independent(tables: ErrorTables) -> Array:
    own = [np.array([tables.squareness[k].u]) for k in tables.machine.squareness]
    own += [np.array([tables.location[k].u]) for k in tables.machine.location]
    own += [tables.motions[k].u for k in tables.machine.motions]
    return np.diag(np.concatenate(own) ** 2)


def _contained(tables: ErrorTables, extra: Mapping[str, Any]) -> str:
    budget = extra.get('budget')
    if not isinstance(budget, Mapping) or not isinstance(budget.get('not_stated'), list):
        return 'the contributions in the tables, which their file does not state'
    missing = ', '.join(map(str, budget['not_stated']))
    if not missing:
        return 'noise, misfit and the declared systematic contributions'
    if tables.machine.uncertainty is None:
        return 'noise and misfit only, no systematic contribution'
    return f'noise, misfit and what was declared, but not: {missing}'


def _not_seen(tables: ErrorTables, extra: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of motions and squareness errors that the data did not see."""
    listed = extra.get('not_identifiable')
    machine = tables.machine
    squareness = [n for n in machine.squareness if isinstance(listed, list) and n in listed]
    location = [n for n in machine.location if not tables.location[n].identifiable]
    motions = (m for m in machine.motions if not tables.motions[m].identifiable)
    return (*squareness, *location, *motions)


def _offset(tables: ErrorTables, wanted: Array | None) -> Array:
    if wanted is None:
        return tables.machine.target_offset
    offset = np.asarray(wanted, dtype=float)
    if offset.shape != (3,) or not np.all(np.isfinite(offset)):
        raise ConfigError('target_offset: expected three finite numbers, in m')
    if np.max(np.abs(offset)) > LONGEST_OFFSET:
        raise ConfigError(
            f'target_offset: {offset.tolist()} m is not a plausible tool length; unit is m'
        )
    return offset
