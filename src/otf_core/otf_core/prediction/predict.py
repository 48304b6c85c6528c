# SPDX-License-Identifier: Apache-2.0
"""Volumetric errors predicted from error tables, with their standard uncertainty.

u is that of the tables (linear propagation of their covariance); outside the driven volume none is
stated. A rotation r that the data do not see (``identifiable: false``) is written as zero. At the
target offset T that was measured with it needs no place in u: what it does there other motions can
do as well, and their tables hold it. With another offset T' the tables lack, of linear axes,

    r(q) x (T' - T)

``prior: {MOTION: {"sd": r}}`` of error_tables.json holds the standard deviation r (rad) of what it
may be, and u includes that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from otf_core.arrays import Array, Flags
from otf_core.errors import ConfigError
from otf_core.model.chain import Sight, displacement
from otf_core.model.machine import FULL_TURN, Machine
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.prediction.calibration_document import CalibrationDocument, load_tables
from otf_core.prediction.driven_volume import (
    EDGE,
    DrivenVolume,
    inside,
    table_ranges,
)
from otf_core.prediction.uncertainty import prediction_uncertainty

ABSURD = 10.0
"""Points further outside than this many axis ranges are refused: another unit, most likely."""
LONGEST_OFFSET = 10.0
"""m; as in machine.yaml."""
NO_LEVER = 1e-9
"""m; shorter levers are rounding."""
REPEATED = 2
"""Corrections of the commanded position: what the second leaves is below 1e-12 m for errors of
100 um that change by 1e-4."""


@dataclass(frozen=True)
class PredictedErrors:
    """Errors at positions.

    Attributes
    ----------
    error : ndarray, shape (n, 3), m
        Actual minus nominal.
    u, u_run : ndarray, shape (n, 3), m
        Its standard uncertainty (k = 1) with everything that is stated, and by noise and misfit
        of the run alone; not a number outside.
    inside : ndarray of bool, shape (n,)
        Whether a position lies in the driven volume.
    """

    error: Array
    u: Array
    u_run: Array
    inside: Flags


@dataclass(frozen=True)
class Predictor:
    """Error tables for one target offset, with all that their uncertainty needs.

    Attributes
    ----------
    tables : ErrorTables
        With the target offset that is predicted for.
    measured : ErrorTables
        With the one that was measured with.
    covariance, covariance_run : ndarray, shape (m, m)
        Of squareness and nodes, see ``uncertainty.prediction_rows``: for u, and for u_run.
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
    covariance_run: Array
    correlated: bool
    prior: Mapping[str, float]
    driven: DrivenVolume | None
    not_seen: tuple[str, ...]
    holds: str
    lacking: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, source: str | Path | CalibrationDocument, target_offset: Array | None = None
    ) -> Predictor:
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
        content = source if isinstance(source, CalibrationDocument) else load_tables(source)
        measured = content.tables
        machine = replace(measured.machine, target_offset=_offset(measured, target_offset))
        described = measured.machine
        size = len(described.scalars)
        size += sum(len(measured.motions[m].position) for m in described.motions)
        packed = content.covariance, content.covariance_run or content.covariance
        covariance, run = (None if c is None else c.unpack(size) for c in packed)
        return cls(
            tables=replace(measured, machine=machine),
            measured=measured,
            covariance=_independent(measured, run=False) if covariance is None else covariance,
            covariance_run=_independent(measured, run=True) if run is None else run,
            correlated=covariance is not None,
            prior={name: own.sd for name, own in content.prior.items()},
            driven=content.driven,
            not_seen=_not_seen(content),
            holds=_contained(content),
            lacking=_lacking(content, covariance is None),
        )

    def unseen(self, q: Array) -> dict[str, Array]:
        """What was not seen and acts through the new target offset, per rad, each (n, 3), m."""
        if np.array_equal(self.tables.machine.target_offset, self.measured.machine.target_offset):
            return {}
        new, old = (Sight.of_tool(t.machine).at(q) for t in (self.tables, self.measured))
        acting = {n: new.influence(n) - old.influence(n) for n in self.not_seen}
        return {n: own for n, own in acting.items() if np.any(np.abs(own) > NO_LEVER)}

    def at(self, q: Array) -> PredictedErrors:
        """Evaluate at programmed axis positions (n, k), m and rad."""
        machine = self.tables.machine
        nodes: dict[str, Array] = {m: self.tables.motions[m].position for m in machine.motions}
        unseen = sum(
            (self.prior.get(name, 0.0) * influence) ** 2
            for name, influence in self.unseen(q).items()
        )
        within = inside(self.measured, self.driven, q)
        u, u_run = (
            np.where(
                within[:, None],
                np.sqrt(prediction_uncertainty(machine, nodes, covariance, q) ** 2 + unseen),
                np.nan,
            )
            for covariance in (self.covariance, self.covariance_run)
        )
        return PredictedErrors(displacement(self.tables, q), u, u_run, within)

    def corrected(self, wanted: Array) -> Array:
        """Positions to command so that the target comes to the wanted ones, by the linear axes.

        Parameters
        ----------
        wanted : ndarray, shape (n, k), m and rad
            Programmed axis positions.

        Returns
        -------
        ndarray, shape (n, k), m and rad
            What linear axes that are missing would correct stays.
        """
        machine, command = self.tables.machine, wanted
        linear = [not machine.axes[a].rotary for a in machine.axis_names]
        velocity = Sight.of_tool(machine).at(wanted).velocity[:, :, linear]
        inverse = np.linalg.pinv(velocity)
        for _ in range(REPEATED):
            error = displacement(self.tables, command)
            command = wanted.copy()
            command[:, linear] -= np.einsum('nij,nj->ni', inverse, error)
        return command


def _lacking(content: CalibrationDocument, from_nodes: bool) -> tuple[str, ...]:
    """What a file does not say, ``u`` only where it is taken ``from_nodes``."""
    if not (content.without_u and from_nodes):
        return content.remarks
    names = ', '.join(content.without_u)
    return (
        *content.remarks,
        f'the tables hold no u of {names}: taken as exact, so u is too small',
    )


def _independent(tables: ErrorTables, run: bool) -> Array:
    """Covariance of nodes that are taken as independent, of u or of u_run."""
    machine, scalars = tables.machine, {**tables.squareness, **tables.location}

    def size(own: MotionTable | ScalarError) -> Array:
        return np.atleast_1d(own.u_run if run and own.u_run is not None else own.u)

    u = [size(scalars[n]) for n in machine.scalars]
    return np.diag(np.concatenate([*u, *(size(tables.motions[m]) for m in machine.motions)]) ** 2)


def _contained(content: CalibrationDocument) -> str:
    """What u holds, in words."""
    if content.headline is None:
        return 'the contributions in the tables, which their file does not state'
    return f'noise, misfit; {content.headline.label}'


def _not_seen(content: CalibrationDocument) -> tuple[str, ...]:
    """Names of motions, squareness and location errors that the data did not see."""
    scalars = {**content.squareness, **content.location}
    hidden = {n for n, own in scalars.items() if not own.identifiable}
    names = [n for n in scalars if n in hidden or n in content.not_identifiable]
    return (*names, *(m for m, own in content.motions.items() if not own.identifiable))


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


LIKE_DEGREES = 2.0 * FULL_TURN
"""rad; nobody asks for an endless axis beyond two turns."""
LIKE_MM = 'mm: divide them by 1000, or write x_mm,y_mm,z_mm into the header'
LIKE_INCHES = 'inches: write x_in,y_in,z_in into the header'


def check_points(tables: ErrorTables, points: Array, where: str) -> list[str]:
    """Refuse points that no such machine can reach; tell of those outside its axes.

    Parameters
    ----------
    points : ndarray, shape (n, m), m and rad
        With the columns ``Machine.point_names``.
    """
    machine, (low, high) = tables.machine, table_ranges(tables)
    names = machine.axis_names
    if points.ndim != 2 or points.shape[1] != len(machine.point_names):
        raise ConfigError(
            f'{where}: columns {", ".join(machine.point_names).lower()} are needed; got '
            f'{points.shape[-1]} columns'
        )
    q = machine.axis_positions(points)
    low, high = np.minimum(low, machine.lower), np.maximum(high, machine.upper)
    at = machine.wrapped(q)
    for k, axis in enumerate(names):
        if machine.axes[axis].endless and np.abs(q[:, k]).max(initial=0.0) > LIKE_DEGREES:
            raise ConfigError(
                f'{where}: {axis.lower()}: {np.abs(q[:, k]).max():g} rad is '
                f'{np.abs(q[:, k]).max() / FULL_TURN:.0f} turns; is it in degrees? positions of '
                f'rotary axes are in rad'
            )
    out = np.maximum(np.maximum(low - at, at - high), 0.0)
    absurd = out > ABSURD * (high - low)
    if absurd.any():
        point, k = (int(i) for i in np.argwhere(absurd)[0])
        scaled = [
            words
            for factor, words in ((1e-3, LIKE_MM), (0.0254, LIKE_INCHES))
            if np.all((factor * q >= low - 0.1) & (factor * q <= high + 0.1))
        ]
        place, unit = ', '.join(f'{v:g}' for v in points[point]), machine.axes[names[k]].unit
        asked = f', and these look like {" or ".join(scaled)}' if scaled else ''
        if unit == 'rad':
            asked = '; is it in degrees?'
        raise ConfigError(
            f'{where}: point {point + 1} ({place}) lies {out[point, k]:g} {unit} outside '
            f'the range of axis {names[k]}, {low[k]:g} {unit} to {high[k]:g} {unit}; '
            f'points are in m{" and rad" if machine.rotary_names else ""}{asked}'
        )
    notes = []
    count = int(np.sum(np.any(out > EDGE, axis=1)))
    if count:
        k = int(np.argmax(out.max(axis=0)))
        notes.append(
            f'{count} of {len(q)} points lie outside the axis ranges of the machine, by up to '
            f'{1e3 * out[:, k].max():.4g} m{machine.axes[names[k]].unit} (axis {names[k]})'
        )
    if beside := int(np.sum(_beside(machine, points))):
        missing = ', '.join(a for a in machine.point_names if a not in names)
        notes.append(
            f'{beside} of {len(q)} points lie beside 0 along {missing}, which the chain '
            f'{machine.chain} does not move: they count as outside'
        )
    return notes


def _beside(machine: Machine, points: Array) -> Flags:
    """Which points (n,) the machine cannot reach: not zero along what it has no axis for."""
    absent = [k for k, a in enumerate(machine.point_names) if a not in machine.axis_names]
    return np.asarray(np.any(np.abs(points[:, absent]) > EDGE, axis=1))


def _outside_note(within: Flags) -> list[str]:
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
    source: str | Path | CalibrationDocument,
    points: Array,
    target_offset: Array | None = None,
    where: str = 'points',
) -> Prediction:
    """Evaluate an error_tables.json.

    Parameters
    ----------
    source : str, Path or CalibrationDocument
        A file or what it holds, in any gauge; its covariance, if any, is used, and likewise its
        prior.
    points : ndarray, shape (n, m), m and rad
        Programmed axis positions x, y, z and those of the rotary axes, see
        ``Machine.point_names``.
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
    machine = predictor.tables.machine
    notes = [*check_points(predictor.tables, points, where), *predictor.lacking]
    if not predictor.correlated:
        notes.append('the tables hold no covariance; u takes their nodes as independent')
    q = machine.axis_positions(points)
    prediction = predictor.at(q)
    within = prediction.inside & ~_beside(machine, points)
    u, u_run = (np.where(within[:, None], own, np.nan) for own in (prediction.u, prediction.u_run))
    notes += _outside_note(within)
    notes += _unseen_note(predictor.unseen(q), predictor.prior)
    return Prediction(
        prediction.error,
        u,
        u_run,
        within,
        predictor.correlated,
        predictor.holds,
        tuple(notes),
    )
