# SPDX-License-Identifier: Apache-2.0
"""System of equations (paper 1.2.4): rows perpendicular to the path, or all three at a stop.

Row i says: a_i . (R x + t - p(q)) = a_i . e(q) - a_i . (dt + dr x (R x + t)), with the measured
point x, the place q on the path, the nominal point p and the first-order error e of the chain, and
the pose correction dt, dr solved jointly. A target whose place is not known adds the turn of its
link times the correction of its place to p.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from otf_core.arrays import Array, Index
from otf_core.config import POINTS
from otf_core.effects.catalogue.machine import HELD, travel_sign
from otf_core.effects.state import state_of_travel
from otf_core.model.chain import ReflectorView, Sight
from otf_core.model.frames import RigidTransform, beam_frame
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import beam_shares, path_frame
from otf_core.pieces.pieces import Pieces
from otf_core.pieces.runs import Observed
from otf_core.solving.design import Design, Influence
from otf_core.solving.unknowns import Unknowns, lag_block, place_block, pose_block


@dataclass(frozen=True)
class System:
    """Rows of all pieces, not yet weighted.

    Attributes
    ----------
    q : ndarray, shape (p, k), m and rad
        Nominal axis positions of each piece on its path.
    axes : ndarray, shape (c, p, 3)
        Directions of the c rows of every piece: a2 and a3, or three at standstill.
    deviation : ndarray, shape (c, p), m
        Measured minus nominal along the axes.
    rows : Design
        Derivatives of the deviations.
    shares : ndarray, shape (3, c, p)
        Of the noise of range and angles in the deviations, see ``noise_model.beam_shares``.
    """

    q: Array
    axes: Array
    deviation: Array
    rows: Design
    shares: Array

    def at(self, pieces: Index) -> System:
        """Return the rows of some pieces, by their places."""
        return System(
            self.q[pieces],
            self.axes[:, pieces],
            self.deviation[:, pieces],
            self.rows.at(pieces),
            self.shares[:, :, pieces],
        )

    def of_unknowns(self, unknowns: Unknowns) -> System:
        """Return the same rows for other functions of the error motions."""
        return replace(self, rows=replace(self.rows, unknowns=unknowns))

    @property
    def design(self) -> sparse.csr_array:
        """All derivatives, shape (c p, full): rows of the first axis, then of the next."""
        return self.rows.csr


MOVES = 3
"""Steps that take the position on the path to the errors there, once tables are known."""
SETTLED = 1e-10
"""m; smaller steps end that."""
LONGEST = 0.2
"""Longest step, in units of place."""


def positions_on_path(
    sight: Sight, pieces: Pieces, points: Array, tables: ErrorTables | None
) -> Array:
    """Axis positions (p, k) on the path that measured points belong to.

    The nearest point is off by the error along the path; once tables are known, their
    displacement is taken off first (not the reversal: 100 um of it move a table of 300 urad by
    0.015 um, forward and backward to opposite sides).

    Parameters
    ----------
    sight : Sight
        Of the target of all pieces.
    points : ndarray, shape (p, 3), m
        Measured points in its frame.
    """
    q = pieces.q
    for _ in range(0 if pieces.standstill else 1 if tables is None else 1 + MOVES):
        seen = sight.at(q)
        off = points - seen.position
        if tables is not None:
            off -= seen.displacement(tables)
        speed = np.einsum('nij,nj->ni', seen.velocity, pieces.step)
        square = np.maximum(np.einsum('ni,ni->n', speed, speed), 1e-18)
        share = np.clip(np.einsum('ni,ni->n', off, speed) / square, -LONGEST, LONGEST)
        q = q + share[:, None] * pieces.step
        if float(np.max(np.abs(share) * np.sqrt(square), initial=0.0)) < SETTLED:
            break
    return q


TOWARDS_TRACKER = 0.01
"""m; a line that passes the tracker nearer than this runs along the beam: both directions across
it are seen alike, and which side of it the tracker stands on is nothing to choose them by."""


def row_directions(pieces: Pieces, pose: RigidTransform) -> Array:
    """Directions of the rows, (c, p, 3); noise of equal angles is not correlated between them.

    One where a piece is a measured component.

    A line and the tracker lie in one plane, so all pieces of the line have the same directions.
    """
    if pieces.method == POINTS:
        return pose.rotate(pieces.direction)[None]
    if pieces.standstill:
        return np.stack([pose.rotate(d) for d in beam_frame(pieces.xyz)[1:]])
    seen = pieces.origin - pose.translation
    across = seen - pieces.direction * np.sum(seen * pieces.direction, axis=1, keepdims=True)
    towards = np.linalg.norm(across, axis=1, keepdims=True) < TOWARDS_TRACKER
    return np.stack(path_frame(pieces.direction, np.where(towards, 0.0, across)))


def deviations(pieces: Pieces, pose: RigidTransform) -> Array:
    """Deviations across the path under a pose, before any tables, shape (c, p), m."""
    return components(row_directions(pieces, pose), pose.apply(pieces.xyz) - pieces.nominal)


def components(axes: Array, offset: Array) -> Array:
    """Components (c, p) of offsets (p, 3) along the rows."""
    return np.asarray(np.einsum('kij,ij->ki', axes, offset))


def build_system(
    run: Observed,
    unknowns: Unknowns,
    tables: ErrorTables | None = None,
    *,
    station: int = 0,
    nodal_lever: bool = False,
) -> System:
    """Set up the rows of all pieces of a run, at its pose and the places of its targets.

    Parameters
    ----------
    tables : ErrorTables, optional
        Tables of the last iteration, for the positions along the path.
    station : int
        Which pose block the rows belong to.
    nodal_lever : bool
        Take an axis' own travel in a lever arm at the centre of every spline. A rotation that
        acts only through it is then exactly a translation, as it is for continuous functions,
        instead of differing by what a spline times the travel is off a spline; and a turn of
        the tracker is one of the nominal positions, not of points that large errors move: for
        judging what is identifiable.
    """
    pieces, pose, machine = run.pieces, run.pose, run.machine
    points, axes = pose.apply(pieces.xyz), row_directions(pieces, pose)
    rows = _Rows(run, unknowns, axes, nodal_lever)
    q, off = np.array(pieces.q), points - pieces.nominal
    for name, own in run.by_target().items():
        sight, some = run.sight(name), pieces if own.all() else pieces.without(~own)
        q[own] = positions_on_path(sight, some, points[own], tables)
        seen = sight.at(q[own])
        if np.any(moved := run.moved(name)):
            off[own] -= moved if seen.inner is None else seen.inner @ moved
        rows.add(name, own, sight, seen)
        if nodal_lever:
            points[own] = seen.position
    turned = -np.cross(points, axes)
    pose_rows = {pose_block(station): np.concatenate([-axes, turned], axis=2)}
    return System(
        q=q,
        axes=axes,
        deviation=components(axes, off),
        rows=Design(machine, unknowns, {**pose_rows, **rows.fixed}, rows.influences()),
        shares=_shares(pieces, pose, axes),
    )


def _shares(pieces: Pieces, pose: RigidTransform, axes: Array) -> Array:
    """See ``noise_model.beam_shares``; components of pairs have one noise, that of the range."""
    if pieces.method == POINTS:
        return np.eye(3)[0, :, None, None] * np.ones(axes.shape[:2])
    return beam_shares(pieces.xyz, pose, axes)


class _Rows:
    """Rows of a run, target by target."""

    def __init__(self, run: Observed, unknowns: Unknowns, axes: Array, nodal_lever: bool) -> None:
        self._run, self._unknowns, self._axes, self._nodal = run, unknowns, axes, nodal_lever
        self.fixed: dict[str, Array] = {}
        self._motions: dict[str, list[Array]] = {}
        pieces, machine = run.pieces, run.machine
        self._shifts = [0.0] if nodal_lever or pieces.standstill else [1.0, -1.0]
        travel = replace(state_of_travel(machine, pieces.q, pieces.step), side=pieces.side)
        self._half = 0.5 * travel_sign(travel, {HELD: float(unknowns.held)})

    def add(self, name: str, own: NDArray[np.bool_], sight: Sight, seen: ReflectorView) -> None:
        """Add what moves one target at its pieces."""
        machine, axes, pieces = self._run.machine, self._axes[:, own], self._run.pieces
        if place_block(name) in self._unknowns.blocks:
            turned = axes if seen.inner is None else np.einsum('cni,nij->cnj', axes, seen.inner)
            self._put(place_block(name), own, turned)
        for scalar, moved in seen.scalars.items():
            self._put(scalar, own, components(axes, moved)[:, :, None])
        for axis in seen.axes:
            if lag_block(axis) in self._unknowns.blocks:
                k = machine.column(axis)
                late = -seen.velocity[:, :, k] * pieces.rate[own, k, None]
                self._put(lag_block(axis), own, components(axes, late)[:, :, None])
        for number, shift in enumerate(self._shifts):
            moved = shift * pieces.spread[own, None] * pieces.step[own]
            at = sight.at(seen.q + moved) if shift else seen
            for axis, six in at.motions.items():
                self._move(axis, number, own, sight, at.q, six)

    def _put(self, block: str, own: NDArray[np.bool_], values: Array) -> None:
        count = len(self._run.pieces)
        known = self.fixed.setdefault(block, np.zeros((len(values), count, values.shape[2])))
        known[:, own] += values

    def _move(
        self, axis: str, shift: int, own: NDArray[np.bool_], sight: Sight, q: Array, six: Array
    ) -> None:
        """Influence of the motions of one axis at one shift."""
        machine, count, c = self._run.machine, len(self._run.pieces), len(self._axes)
        column, basis = machine.column(axis), self._unknowns.bases[axis]
        place = machine.axes[axis].wrapped(q[:, column])
        values = [six]
        if self._nodal:
            first, _ = basis.places(place)
            of_splines = []
            for k in range(basis.nonzero):
                at = q.copy()
                at[:, column] += basis.centres[(first + k) % basis.size] - place
                of_splines.append(sight.at(at).motions[axis])
            values.append(np.stack(of_splines, axis=3))
        if axis not in self._motions:
            shapes = [(c, count, *own.shape[2:]) for own in values]
            shifts = len(self._shifts)
            self._motions[axis] = [np.zeros((shifts, *shape)) for shape in [(count,), *shapes]]
        position, *rows = self._motions[axis]
        position[shift, own] = place
        for row, value in zip(rows, values, strict=True):
            row[shift][:, own] = np.einsum('cni,ni...->cn...', self._axes[:, own], value)

    def influences(self) -> dict[str, Influence]:
        """What the motions of every axis do."""
        machine = self._run.machine
        order = [axis for axis in machine.axis_names if axis in self._motions]
        influences = {}
        for axis in order:
            q, six, *nodal = self._motions[axis]
            influences[axis] = Influence(q, six, self._half[:, machine.column(axis)], *nodal)
        return influences


def model_rows(machine: Machine, unknowns: Unknowns, q: Array) -> Array:
    """Derivatives of the volumetric error by the full vector; poses and reversal are left out.

    Parameters
    ----------
    q : ndarray, shape (n, k), m and rad

    Returns
    -------
    ndarray, shape (n, 3, full)
    """
    seen, rows = Sight.of_tool(machine).at(q), np.zeros((len(q), 3, unknowns.full))
    for name, moved in seen.scalars.items():
        rows[:, :, unknowns.blocks[name].start] = moved
    for motion in machine.motions:
        if motion.axis in seen.axes:
            place = machine.axes[motion.axis].wrapped(q[:, machine.column(motion.axis)])
            along = unknowns.bases[motion.axis].matrix(place)
            influence = seen.motions[motion.axis][:, :, DIRECTIONS.index(motion.direction)]
            rows[:, :, unknowns.blocks[motion]] = influence[:, :, None] * along[:, None, :]
    return rows
