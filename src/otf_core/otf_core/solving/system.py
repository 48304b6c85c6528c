# SPDX-License-Identifier: Apache-2.0
"""System of equations (paper 1.2.4): rows perpendicular to the path, or all three at a stop.

Row i says: a_i . (R p + t - q) = a_i . e(q) - a_i . (dt + dr x (R p + t)), with the point q on the
path, the error model e of ``kinematics`` and the pose correction dt, dr solved jointly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from otf_core.model.beam_frame import beam_frame
from otf_core.model.frames import RigidTransform
from otf_core.model.kinematics import displacement, motion_influence, squareness_influence
from otf_core.model.machine import AXES, Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables
from otf_core.noise.model import beam_shares, path_frame
from otf_core.pieces.pieces import Pieces
from otf_core.solving.reversal import reversal_columns
from otf_core.solving.unknowns import Unknowns, pose_block

Array = NDArray[np.float64]


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
    design : sparse array, shape (c p, full)
        Derivatives of the deviations; rows of the first axis of all pieces, then the next.
    shares : ndarray, shape (3, c, p)
        Of the noise of range and angles in the deviations, see ``noise.beam_shares``.
    """

    q: Array
    axes: Array
    deviation: Array
    design: sparse.csr_array
    shares: Array


def nominal_positions(
    pieces: Pieces, points: Array, tables: ErrorTables | None, iterations: int = 3
) -> Array:
    """Point of the path that each measured point belongs to.

    The nearest point is off by the error along the path; once tables are known, their
    displacement is taken off first (not the reversal: 100 um of it move a table of 300 urad by
    0.015 um, forward and backward to opposite sides).

    Parameters
    ----------
    pieces : Pieces
    points : ndarray, shape (p, 3), m
        Measured points in the machine frame.
    tables : ErrorTables, optional

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


def _axes(pieces: Pieces, pose: RigidTransform) -> Array:
    """Directions of the rows, (c, p, 3); noise of equal angles is not correlated between them."""
    beam, horizontal, vertical = (pose.rotate(d) for d in beam_frame(pieces.xyz)[1:])
    if not pieces.standstill:
        return np.stack(path_frame(pieces.direction, beam))
    return np.stack([beam, horizontal, vertical])


def _design(
    machine: Machine,
    unknowns: Unknowns,
    run: int,
    q: Array,
    points: Array,
    axes: Array,
    pieces: Pieces,
    nodal_lever: bool,
) -> sparse.csr_array:
    count, components, pose = len(q), len(axes), unknowns.blocks[pose_block(run)].start
    row = np.arange(count)
    rows, columns, values = [], [], []

    def add(influence: Array, column: NDArray[np.int64], factor: Array | float) -> None:
        for k in range(components):
            rows.append(row + k * count)
            columns.append(column)
            values.append(np.einsum('ij,ij->i', axes[k], influence) * factor)

    for k in range(3):
        unit = np.broadcast_to(np.eye(3)[k], q.shape)
        add(unit, np.full(count, pose + k), -1.0)
        add(np.cross(np.eye(3)[k], points), np.full(count, pose + 3 + k), -1.0)
    for name in SQUARENESS:
        add(squareness_influence(name, q), np.full(count, unknowns.blocks[name].start), 1.0)
    places = {a: unknowns.bases[a].places(q[:, k]) for k, a in enumerate(AXES)}
    for name in MOTIONS:
        basis, axis = unknowns.bases[name.axis], name.place
        first, weight = places[name.axis]
        start, influence = unknowns.blocks[name].start, motion_influence(machine, name, q)
        for step in range(basis.nonzero):
            if nodal_lever:
                lever_q = q.copy()
                lever_q[:, axis] = basis.centres[first + step]
                influence = motion_influence(machine, name, lever_q)
            add(influence, start + first + step, weight[:, step])
    for name, influence in reversal_columns(machine, q, pieces.direction, pieces.side, unknowns):
        add(influence, np.full(count, unknowns.blocks[name].start), 1.0)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(sparse.coo_array(entries, shape=(components * count, unknowns.full)))


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
    machine : Machine
    pieces : Pieces
    pose : RigidTransform
        Tracker to machine, good to the errors sought.
    unknowns : Unknowns
    tables : ErrorTables, optional
        Tables of the last iteration, for the positions along the path.
    run : int
        Which pose block the rows belong to.
    nodal_lever : bool
        Take an axis' own travel in a lever arm at the centre of every spline. A rotation that
        acts only through it is then exactly a translation, as it is for continuous functions,
        instead of differing by what a spline times the travel is off a spline: for judging
        what is identifiable.

    Returns
    -------
    System
    """
    points = pose.apply(pieces.xyz)
    q = nominal_positions(pieces, points, tables)
    axes = _axes(pieces, pose)
    # a piece is a mean over samples, not the value at its centre: from a curved motion the two
    # differ by h^2 f'' / 24; the mean of f at both Gauss points is right to the third order
    shifts = [np.zeros(3)]
    if len(pieces.spread) and not nodal_lever:
        reach = pieces.spread[:, None] * pieces.direction
        shifts = [reach, -reach]
    halves = [
        _design(machine, unknowns, run, q + s, points + s, axes, pieces, nodal_lever)
        for s in shifts
    ]
    return System(
        q=q,
        axes=axes,
        deviation=np.einsum('kij,ij->ki', axes, points - q),
        design=sparse.csr_array(sum(halves[1:], start=halves[0]) / len(halves)),
        shares=beam_shares(pieces.xyz, pose, axes),
    )


def model_rows(machine: Machine, unknowns: Unknowns, q: Array) -> Array:
    """Derivatives of the volumetric error by the full vector; poses and reversal are left out.

    Parameters
    ----------
    machine : Machine
    unknowns : Unknowns
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
