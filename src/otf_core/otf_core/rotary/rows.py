# SPDX-License-Identifier: Apache-2.0
"""Rows of all pieces of a run: deviations across the curves and their derivatives.

For the direction a of a row, the point p = R x + t and the nominal point p(q; place)

    a . (p - p(q)) = a . e(q) + a . R_link dplace - a . (dt + dr x p)
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from otf_core.arrays import Array, Index
from otf_core.effects.catalogue.direction_dependent_tables import functions_along
from otf_core.effects.state import state_in_parts
from otf_core.effects.terms import State
from otf_core.model.frames import RigidTransform
from otf_core.model.joints import ReflectorView, Sight
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import beam_shares
from otf_core.rotary.axis_unknowns import lag_block, place_block
from otf_core.rotary.curve_matching import Part, sight_at
from otf_core.rotary.reduction import AxisPieces
from otf_core.solving.system import row_directions
from otf_core.solving.unknowns import Unknowns, pose_block, reversal_blocks

BLOCK = 2000
"""Pieces whose rows are dense at a time; bounds the memory."""


@dataclass(frozen=True)
class AxisRows:
    """Derivatives of the deviations of one run; dense rows are made for a few pieces at a time.

    Attributes
    ----------
    count : int
        Pieces.
    fixed : mapping of block to ndarray, shape (c, p, k)
        Poses, places, squareness and location errors, reversal and lags.
    motions : mapping of axis to list of (ndarray (c, p, 6), ndarray (p,))
        Influence of its six motions along the rows, and its position, at every shift.
    splines : ndarray, shape (p, k)
        Where the axes are: pieces with alike rows are treated together.
    """

    unknowns: Unknowns
    count: int
    fixed: Mapping[str, Array]
    motions: Mapping[str, list[tuple[Array, Array]]]
    splines: Index

    @cached_property
    def _functions(self) -> dict[str, list[tuple[Array, Array]]]:
        """Influence (c, p, 6) of the motions and the functions (p, size), at every shift."""
        return {
            axis: [(six, self.unknowns.bases[axis].matrix(q)) for six, q in shifts]
            for axis, shifts in self.motions.items()
        }

    def at(self, pieces: Index) -> AxisRows:
        """Rows of some pieces, by their places."""
        motions = {
            axis: [(six[:, pieces], q[pieces]) for six, q in shifts]
            for axis, shifts in self.motions.items()
        }
        fixed = {name: own[:, pieces] for name, own in self.fixed.items()}
        return AxisRows(self.unknowns, len(pieces), fixed, motions, self.splines[pieces])

    def prepare(self) -> None:
        """Set up what several threads use."""
        self._functions  # noqa: B018

    def dense(self, pieces: Index | slice) -> Array:
        """Rows (c, m, full) of some pieces."""
        sample = next(iter(self.fixed.values()))[:, pieces]
        rows = np.zeros((*sample.shape[:2], self.unknowns.full))
        for name, own in self.fixed.items():
            rows[:, :, self.unknowns.blocks[name]] = own[:, pieces]
        for axis, shifts in self._functions.items():
            for k, d in enumerate('XYZABC'):
                block = self.unknowns.blocks[f'E{d}{axis}']
                rows[:, :, block] = sum(
                    six[:, pieces, k, None] * (weight[pieces] / len(shifts))
                    for six, weight in shifts
                )
        return rows

    def touched(
        self, pieces: Index, width: int = 0, blocks: Collection[str] | None = None
    ) -> tuple[Index, Array]:
        """Rows of some pieces by the unknowns that they depend on; see ``design.Design``."""
        rows = self.dense(pieces)
        columns = np.flatnonzero(np.any(rows, axis=(0, 1)))
        dense = np.zeros((*rows.shape[:2], len(columns) + width))
        dense[:, :, : len(columns)] = rows[:, :, columns]
        return columns, dense

    def transposed(self, rows: Array) -> Array:
        """Transposed rows times values (c, p), shape (full,)."""
        product = np.zeros(self.unknowns.full)
        for name, own in self.fixed.items():
            product[self.unknowns.blocks[name]] += np.einsum('cpk,cp->k', own, rows)
        for axis, shifts in self._functions.items():
            pull = sum(
                weight.T @ np.einsum('cpk,cp->pk', six, rows) / len(shifts)
                for six, weight in shifts
            )
            for k, d in enumerate('XYZABC'):
                product[self.unknowns.blocks[f'E{d}{axis}']] += np.asarray(pull)[:, k]
        return product

    def times(self, value: Array) -> Array:
        """Deviations (c, p) for values of the unknowns (full,)."""
        total = sum(own @ value[self.unknowns.blocks[n]] for n, own in self.fixed.items())
        for axis, shifts in self._functions.items():
            blocks = [self.unknowns.blocks[f'E{d}{axis}'] for d in 'XYZABC']
            coefficients = np.stack([value[b] for b in blocks], axis=1) / len(shifts)
            for six, weight in shifts:
                total = total + np.einsum('cpk,pk->cp', six, weight @ coefficients)
        return np.asarray(total)

    def pulled(self, pieces: slice, values: Array) -> Array:
        """Transposed rows of some pieces times values (c, m, k), shape (full, k)."""
        product = np.zeros((self.unknowns.full, values.shape[2]))
        for name, own in self.fixed.items():
            product[self.unknowns.blocks[name]] = np.einsum('cpk,cpn->kn', own[:, pieces], values)
        for axis, shifts in self._functions.items():
            blocks = [self.unknowns.blocks[f'E{d}{axis}'] for d in 'XYZABC']
            for six, weight in shifts:
                turned = np.einsum('cpk,cpn->pkn', six[:, pieces], values) / len(shifts)
                pull = weight[pieces].T @ turned.reshape(len(turned), -1)
                for block, own in zip(
                    blocks, pull.reshape(len(pull), 6, -1).swapaxes(0, 1), strict=True
                ):
                    product[block] += own
        return product


@dataclass(frozen=True)
class AxisSystem:
    """Rows of a run, not yet weighted; see ``solving.system.System``.

    Attributes
    ----------
    q : ndarray, shape (p, k), m and rad
    axes : ndarray, shape (c, p, 3)
    deviation : ndarray, shape (c, p), m
    shares : ndarray, shape (3, c, p)
    """

    q: Array
    axes: Array
    deviation: Array
    rows: AxisRows
    shares: Array

    def at(self, pieces: Index) -> AxisSystem:
        """Return the rows of some pieces, by their places."""
        return AxisSystem(
            self.q[pieces],
            self.axes[:, pieces],
            self.deviation[:, pieces],
            self.rows.at(pieces),
            self.shares[:, :, pieces],
        )

    def of_unknowns(self, unknowns: Unknowns) -> AxisSystem:
        """Return the same rows for other functions of the error motions."""
        return replace(self, rows=replace(self.rows, unknowns=unknowns))

    @property
    def design(self) -> sparse.csr_array:
        """Derivatives of the deviations by all unknowns, component by component, (c p, full)."""
        count = self.rows.count
        parts = [
            [sparse.csr_array(own) for own in self.rows.dense(slice(low, min(low + BLOCK, count)))]
            for low in range(0, count, BLOCK)
        ]
        return sparse.csr_array(
            sparse.vstack([p[c] for c in range(len(self.axes)) for p in parts], format='csr')
        )


@dataclass(frozen=True)
class AxisRun:
    """One run reduced to pieces.

    Attributes
    ----------
    pose : RigidTransform
        Tracker to the link that it stands on.
    places : mapping of target to ndarray, shape (3,), m
        As known now.
    base : mapping of target to ndarray, shape (3,), m
        At which the nominal points of the pieces were computed.
    station : int
        Place of the tracker.
    """

    machine: Machine
    parts: tuple[Part, ...]
    pieces: AxisPieces
    pose: RigidTransform
    places: Mapping[str, Array]
    base: Mapping[str, Array]
    station: int
    name: str = ''
    free: tuple[str, ...] = field(default=())

    def placed(self, pose: RigidTransform, places: Mapping[str, Array]) -> AxisRun:
        """The same with another pose and other places."""
        return replace(self, pose=pose, places=places)

    def by_target(self) -> dict[str, NDArray[np.bool_]]:
        """Which pieces are of which target."""
        names = np.array([p.path.target for p in self.parts])[self.pieces.part]
        return {str(n): names == n for n in np.unique(names)}


def _filled(count: int, own: NDArray[np.bool_], values: Array) -> Array:
    filled = np.zeros((values.shape[0], count, *values.shape[2:]))
    filled[:, own] = values
    return filled


def _place_columns(seen: ReflectorView, axes: Array, own: NDArray[np.bool_]) -> Array:
    inner = np.eye(3)[None] if seen.inner is None else seen.inner
    turned = np.einsum('cni,nij->cnj', axes[:, own], np.broadcast_to(inner, (own.sum(), 3, 3)))
    return _filled(axes.shape[1], own, turned)


def place_columns(run: AxisRun, system: AxisSystem, target: str, own: NDArray[np.bool_]) -> Array:
    """Derivatives (c, p, 3) of the deviations by the place of a target, known or not.

    ``own`` (p,) are the pieces of the target.
    """
    seen = sight_at(run.machine, target, run.places).at(system.q[own])
    return _place_columns(seen, system.axes, own)


def build_rows(run: AxisRun, unknowns: Unknowns, tables: ErrorTables | None) -> AxisSystem:
    """Set up the rows of all pieces of a run.

    Parameters
    ----------
    tables : ErrorTables, optional
        Of the last iteration, for the places along the curves.
    """
    pieces, machine = run.pieces, run.machine
    points = run.pose.apply(pieces.xyz)
    axes = row_directions(cast(Any, pieces), run.pose)
    count = axes.shape[1]
    q, off = pieces.q.copy(), points - pieces.nominal
    fixed = {pose_block(run.station): np.concatenate([-axes, -np.cross(points, axes)], axis=2)}
    motions: dict[str, list[tuple[Array, Array]]] = {}
    for name, own in run.by_target().items():
        sight = sight_at(machine, name, run.places)
        seen = sight.at(q[own])
        inner = np.eye(3)[None] if seen.inner is None else seen.inner
        off[own] -= np.einsum('nij,j->ni', inner, run.places[name] - run.base[name])
        if not pieces.standstill:
            wanted = off[own] if tables is None else off[own] - seen.displacement(tables)
            q[own] += _along(seen, pieces, own, wanted)
            seen = sight.at(q[own])
            inner = np.eye(3)[None] if seen.inner is None else seen.inner
        if name in run.free:
            fixed[place_block(name)] = _place_columns(seen, axes, own)
        for scalar, moved in seen.scalars.items():
            column = np.einsum('cni,ni->cn', axes[:, own], moved)[:, :, None]
            before = fixed.get(scalar, 0.0)
            fixed[scalar] = before + _filled(count, own, column)
        _add_motions(motions, sight, pieces, own, axes, q)
        for axis in seen.axes:
            if lag_block(axis) in unknowns.blocks:
                late = -seen.velocity[:, :, machine.column(axis)]
                late = late * pieces.rate[own, machine.column(axis), None]
                column = np.einsum('cni,ni->cn', axes[:, own], late)[:, :, None]
                before = fixed.get(lag_block(axis), 0.0)
                fixed[lag_block(axis)] = before + _filled(count, own, column)
        for block, column in _reversed(seen, pieces, own, axes, unknowns):
            fixed[block] = fixed.get(block, 0.0) + _filled(count, own, column)
    return AxisSystem(
        q=q,
        axes=axes,
        deviation=np.einsum('cni,ni->cn', axes, off),
        rows=AxisRows(unknowns, count, fixed, motions, _cells(q)),
        shares=beam_shares(pieces.xyz, run.pose, axes),
    )


def _reversed(
    seen: ReflectorView,
    pieces: AxisPieces,
    own: NDArray[np.bool_],
    axes: Array,
    unknowns: Unknowns,
) -> Iterator[tuple[str, Array]]:
    """Reversal coefficients and their columns (c, m, 1) at the pieces of one target."""
    machine = seen.sight.machine
    for axis, six in seen.motions.items():
        column, half = machine.column(axis), 0.5 * pieces.side[own, machine.column(axis)]
        moved = np.einsum('cni,nik,n->cnk', axes[:, own], six, half, optimize=True)
        for k, d in enumerate(DIRECTIONS):
            blocks = reversal_blocks(unknowns, f'E{d}{axis}')
            order = len(blocks) - 1
            along = functions_along(machine.axes[axis], seen.q[:, column], max(order, 0))
            for name, weight in zip(blocks, along.T, strict=False):
                yield name, (moved[:, :, k] * weight)[:, :, None]


def _cells(q: Array) -> Index:
    """Axis positions (p, k) in parts of their ranges."""
    low, size = q.min(axis=0), np.maximum(np.ptp(q, axis=0), 1e-9)
    return np.asarray(np.rint(32.0 * (q - low) / size), dtype=np.int64)


def _add_motions(
    motions: dict[str, list[tuple[Array, Array]]],
    sight: Sight,
    pieces: AxisPieces,
    own: NDArray[np.bool_],
    axes: Array,
    q: Array,
) -> None:
    """Add influence and positions of the motions at the pieces of one target."""
    machine, count = sight.machine, len(pieces)
    shifts = [np.zeros(int(own.sum()))]
    if not pieces.standstill:
        shifts = [pieces.spread[own], -pieces.spread[own]]
    for number, shift in enumerate(shifts):
        at = sight.at(q[own] + shift[:, None] * pieces.step[own])
        for axis, six in at.motions.items():
            known = motions.setdefault(axis, [])
            if number == len(known):
                known.append((np.zeros((len(axes), count, 6)), np.zeros(count)))
            known[number][0][:, own] = np.einsum('cni,nik->cnk', axes[:, own], six)
            place = machine.axes[axis].wrapped(at.q[:, machine.column(axis)])
            known[number][1][own] = place


def _along(
    seen: ReflectorView, pieces: AxisPieces, own: NDArray[np.bool_], wanted: Array
) -> Array:
    """Change of the axis positions (m, k) that takes the nominal points along their curves."""
    speed = np.einsum('nij,nj->ni', seen.velocity, pieces.step[own])
    size = np.maximum(np.linalg.norm(speed, axis=1), 1e-9)
    share = np.einsum('ni,ni->n', wanted, speed) / size**2
    return np.asarray(np.clip(share, -0.2, 0.2)[:, None] * pieces.step[own])


def piece_state(run: AxisRun, q: Array, nodes: Mapping[str, Array], tables: ErrorTables) -> State:
    """State of the pieces of a run at axis positions q (p, k), m and rad.

    Parameters
    ----------
    nodes : mapping of axis to ndarray, m and rad
    tables : ErrorTables
        As solved.
    """
    pieces = run.pieces
    return state_in_parts(
        run.machine,
        [p.path.target for p in run.parts],
        run.places,
        pieces.part,
        pieces.stretch,
        q,
        pieces.rate,
        pieces.side,
        pieces.time,
        run.pose,
        nodes,
        tables,
        float(pieces.time.max() + pieces.duration[-1]),
        np.abs(pieces.step) * pieces.spread[:, None],
    )
