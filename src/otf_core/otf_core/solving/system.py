# SPDX-License-Identifier: Apache-2.0
"""System of equations (paper 1.2.4): rows perpendicular to the path, or all three at a stop.

Row i says: a_i . (R p + t - q) = a_i . e(q) - a_i . (dt + dr x (R p + t)), with the point q on the
path, the error model e of ``kinematics`` and the pose correction dt, dr solved jointly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from otf_core.arrays import Array, Index
from otf_core.model.beam_frame import beam_frame
from otf_core.model.frames import RigidTransform
from otf_core.model.kinematics import displacement, motion_influence, squareness_influence
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import beam_shares, path_frame
from otf_core.pieces.pieces import Pieces
from otf_core.solving.design import Design
from otf_core.solving.unknowns import Unknowns


@dataclass(frozen=True)
class System:
    """Rows of all pieces, not yet weighted.

    Attributes
    ----------
    q : ndarray, shape (p, 3), m
        Nominal position of each piece on its leg.
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


def nominal_positions(
    pieces: Pieces, points: Array, tables: ErrorTables | None, iterations: int = 3
) -> Array:
    """Point of the path that each measured point belongs to.

    The nearest point is off by the error along the path; once tables are known, their
    displacement is taken off first (not the reversal: 100 um of it move a table of 300 urad by
    0.015 um, forward and backward to opposite sides).

    Parameters
    ----------
    points : ndarray, shape (p, 3), m
        Measured points in the machine frame.

    Returns
    -------
    ndarray, shape (p, 3), m
    """

    def nearest(position: Array) -> Array:
        along = np.einsum('ij,ij->i', position - pieces.origin, pieces.direction)
        return np.asarray(pieces.origin + along[:, None] * pieces.direction)

    if pieces.standstill:
        return pieces.origin
    q = nearest(points)
    for _ in range(iterations if tables is not None else 0):
        assert tables is not None
        q = nearest(points - displacement(tables, q))
    return q


TOWARDS_TRACKER = 0.01
"""m; a line that passes the tracker nearer than this runs along the beam: both directions across
it are seen alike, and which side of it the tracker stands on is nothing to choose them by."""


def row_directions(pieces: Pieces, pose: RigidTransform) -> Array:
    """Directions of the rows, (c, p, 3); noise of equal angles is not correlated between them.

    A line and the tracker lie in one plane, so all pieces of the line have the same directions.
    """
    if pieces.standstill:
        return np.stack([pose.rotate(d) for d in beam_frame(pieces.xyz)[1:]])
    seen = pieces.origin - pose.translation
    across = seen - pieces.direction * np.sum(seen * pieces.direction, axis=1, keepdims=True)
    towards = np.linalg.norm(across, axis=1, keepdims=True) < TOWARDS_TRACKER
    return np.stack(path_frame(pieces.direction, np.where(towards, 0.0, across)))


def deviations(pieces: Pieces, pose: RigidTransform) -> Array:
    """Deviations across the path under a pose, before any tables, shape (c, p), m."""
    points = pose.apply(pieces.xyz)
    return components(
        row_directions(pieces, pose), points - nominal_positions(pieces, points, None)
    )


def components(axes: Array, offset: Array) -> Array:
    """Components (c, p) of offsets (p, 3) along the rows."""
    return np.asarray(np.einsum('kij,ij->ki', axes, offset))


def build_system(
    machine: Machine,
    pieces: Pieces,
    pose: RigidTransform,
    unknowns: Unknowns,
    tables: ErrorTables | None = None,
    *,
    run: int = 0,
    nodal_lever: bool = False,
) -> System:
    """Set up the rows of all pieces.

    Parameters
    ----------
    pose : RigidTransform
        Tracker to machine, good to the errors sought.
    tables : ErrorTables, optional
        Tables of the last iteration, for the positions along the path.
    run : int
        Which pose block the rows belong to.
    nodal_lever : bool
        Take an axis' own travel in a lever arm at the centre of every spline. A rotation that
        acts only through it is then exactly a translation, as it is for continuous functions,
        instead of differing by what a spline times the travel is off a spline; and a turn of
        the tracker is one of the nominal positions, not of points that large errors move: for
        judging what is identifiable.
    """
    points = pose.apply(pieces.xyz)
    q = nominal_positions(pieces, points, tables)
    axes = row_directions(pieces, pose)
    # a piece is a mean over samples, not the value at its centre: from a curved motion the two
    # differ by h^2 f'' / 24; the mean of f at both Gauss points is right to the third order
    shifts: tuple[Array, ...] = (np.zeros(3),)
    if len(pieces.spread) and not nodal_lever:
        reach = pieces.spread[:, None] * pieces.direction
        shifts = (reach, -reach)
    return System(
        q=q,
        axes=axes,
        deviation=components(axes, points - q),
        rows=Design(
            machine,
            unknowns,
            run,
            q,
            q if nodal_lever else points,
            axes,
            shifts,
            pieces.direction,
            pieces.side,
            nodal_lever,
        ),
        shares=beam_shares(pieces.xyz, pose, axes),
    )


def model_rows(machine: Machine, unknowns: Unknowns, q: Array) -> Array:
    """Derivatives of the volumetric error by the full vector; poses and reversal are left out.

    Parameters
    ----------
    q : ndarray, shape (n, 3), m

    Returns
    -------
    ndarray, shape (n, 3, full)
    """
    rows = np.zeros((len(q), 3, unknowns.full))
    for name in SQUARENESS:
        rows[:, :, unknowns.blocks[name].start] = squareness_influence(name, q)
    for name in MOTIONS:
        along = unknowns.bases[name.axis].matrix(q[:, name.place])
        influence = motion_influence(machine, name, q)
        rows[:, :, unknowns.blocks[name]] = influence[:, :, None] * along[:, None, :]
    return rows
