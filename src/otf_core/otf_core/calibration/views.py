# SPDX-License-Identifier: Apache-2.0
"""How errors lie in the volume and residuals along the runs: blocks of error_tables.json.

Numbers are rounded far below their uncertainty: 0.1 nm, 1 nrad, 0.01 mm of places.
"""

from __future__ import annotations

from itertools import combinations, pairwise, product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.calibration.machine_verdict import size_and_u
from otf_core.model.chain import displacement, nominal_position
from otf_core.model.evaluation import evenly_spread, without_rigid_motion
from otf_core.model.machine import Machine
from otf_core.model.motions import unit_of
from otf_core.model.path import leg_bounds
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.volumetric import VolumetricError, table_places, table_rows, table_values

if TYPE_CHECKING:
    from otf_core.calibration.calibration_result import CalibrationResult, RunResult

STRETCHES = 900
"""Parts of the track of a run whose residual is stated, about."""
DRIFT_PARTS, LEGS_PER_PART = 8, 6
"""Parts of a run; legs of a part from which it is used."""
INFORMATION_SHARE = 1e-3
"""Smallest share of the information of a direction that has to be there."""
DIAGONAL_POINTS = 21
TRAVEL_BINS = 20
MOVING_SHARE = 0.1
"""Share of the longest travel on a leg, in ranges of the axes, from which an axis is moving."""
TURNS, PER_CELL = 7, 60
"""Positions of every rotary axis at which errors are stated, and of all axes at each."""


def _fine(values: Any, decimals: int = 10) -> Any:
    return (np.round(values, decimals) + 0.0).tolist()


def volume_view(result: CalibrationResult) -> dict[str, Any]:
    """Error vectors and their u over the volume, and what every error makes of them alone."""
    volume = result.volume
    return {
        'points': len(volume.grid),
        **volume.sizes(),
        'rigid_motion': 'taken out',
        'position': _fine(volume.positions, 6),
        'error': _fine(volume.error),
        'u': _fine(volume.u),
        'u_run': _fine(VolumetricError(result.tables, result.covariance_run).u),
        'alone': {
            name: float(np.sqrt(np.mean(np.sum(volume.part(name) ** 2, axis=1))))
            for name in table_places(result.tables)
            if name not in result.not_identifiable
        },
    }


def error_sizes(result: CalibrationResult) -> dict[str, dict[str, Any]]:
    """Span of every motion, size of every scalar, with u and k; None of what is not known."""
    sizes = {}
    machine = result.tables.machine
    for name in (*map(str, machine.motions), *machine.scalars):
        size = u = k = None
        if name not in result.not_identifiable:
            size, u, k = size_and_u(name, result.tables, result.budget)
        sizes[name] = {'unit': unit_of(name), 'size': size, 'u': u, 'k': k}
    return sizes


def diagonals(machine: Machine) -> list[tuple[str, str, Array, Array]]:
    """Kind, direction and ends (k,), m and rad, of the diagonals of the linear axes.

    Body diagonals, all of three axes, and face diagonals in the middle planes, two of each pair;
    rotary axes stand at zero, or as near as they come.
    """
    low, high = machine.lower, machine.upper
    linear = [k for k, own in enumerate(machine.axes.values()) if not own.rotary]
    rest = np.where([a.rotary for a in machine.axes.values()], np.clip(0.0, low, high),
                    0.5 * (low + high))  # fmt: skip
    found = []
    for size, kind in ((3, 'body'), (2, 'face')):
        for own in combinations(linear, size):
            for turns in product((1, -1), repeat=size - 1):
                sign = np.zeros(len(low), dtype=int)
                sign[list(own)] = (1, *turns)
                a = np.where(sign > 0, low, np.where(sign < 0, high, rest))
                b = np.where(sign > 0, high, np.where(sign < 0, low, rest))
                name = ' '.join(f'{"-+"[int(sign[k] > 0)]}{machine.axis_names[k]}' for k in own)
                found.append((kind, name, a, b))
    return found


def deviations(result: CalibrationResult, a: Array, b: Array) -> tuple[Array, Array]:
    """Deviation along a diagonal from a to b and its u, shape (DIAGONAL_POINTS,), m.

    Deviation at a point: the part of the error vector along the diagonal, less that at its start.
    No rigid motion changes it.
    """
    tables = result.tables
    q = a + np.linspace(0.0, 1.0, DIAGONAL_POINTS)[:, None] * (b - a)
    ends = nominal_position(tables.machine, q[[0, -1]])
    unit = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    rows = np.einsum('k,nkm->nm', unit, table_rows(tables, q))
    rows = rows - rows[:1]
    variance = np.einsum('nm,nm->n', rows @ result.covariance, rows)
    return rows @ table_values(tables), np.sqrt(np.maximum(variance, 0.0))


def diagonals_view(result: CalibrationResult) -> list[dict[str, Any]]:
    """Diagonals as the tables predict them, in the manner of ISO 230-6."""
    rows = []
    for kind, name, a, b in diagonals(result.tables.machine):
        value, u = deviations(result, a, b)
        rows.append(
            {'kind': kind, 'direction': name, 'length': float(np.linalg.norm(b - a)),
             'span': float(np.ptp(value)), 'end': float(value[-1]), 'u_end': float(u[-1])}
        )  # fmt: skip
    return rows


def turns_view(result: CalibrationResult) -> dict[str, Any] | None:
    """Mean length of the error vector over the rotary axes, the linear ones anywhere; or None."""
    machine, names = result.tables.machine, result.tables.machine.rotary_names
    if not names:
        return None
    low, high = table_ranges(result.tables)
    columns = [machine.column(a) for a in names]
    ends = [np.linspace(low[k], high[k], TURNS) for k in columns]
    cells = np.stack([g.ravel() for g in np.meshgrid(*ends, indexing='ij')], axis=1)
    q = np.tile(evenly_spread(low, high, PER_CELL), (len(cells), 1))
    q[:, columns] = np.repeat(cells, PER_CELL, axis=0)
    free = without_rigid_motion(displacement(result.tables, q), nominal_position(machine, q))
    sizes = np.linalg.norm(free, axis=1).reshape(len(cells), -1).mean(axis=1)
    return {'axes': list(names), 'position': _fine(ends, 6),
            'mean': _fine(sizes.reshape((TURNS,) * len(names)))}  # fmt: skip


def _moving(machine: Machine, run: RunResult) -> NDArray[np.bool_]:
    """Which axes travelled a good part of the leg of a piece, shape (p, k)."""
    moving = np.zeros(run.q.shape, dtype=bool)
    for a, b in leg_bounds(run.pieces.leg):
        share = np.ptp(run.q[a:b], axis=0) / (machine.upper - machine.lower)
        moving[a:b] = (share > MOVING_SHARE * share.max()) & (share > 0.0)
    return moving


def coverage_view(result: CalibrationResult) -> dict[str, Any]:
    """How many samples lie where along every axis, and around every node of its tables."""
    machine, view = result.tables.machine, {}
    count = np.concatenate([run.pieces.count for run in result.runs])
    moving = np.concatenate([_moving(machine, run) for run in result.runs])
    for (axis, own), low, high in zip(
        machine.axes.items(), *table_ranges(result.tables), strict=True
    ):
        k = machine.column(axis)
        q = own.wrapped(np.concatenate([run.q[:, k] for run in result.runs]))
        bins = np.linspace(own.min, own.max, TRAVEL_BINS + 1)
        position = result.tables.motions[f'E{axis}{axis}'].position
        around = [-np.inf, *(0.5 * (position[1:] + position[:-1])), np.inf]
        moves = moving[:, k]
        view[axis] = {
            'tables': [float(low), float(high)],
            'samples': np.histogram(q, bins, weights=count)[0].tolist(),
            'samples_moving': np.histogram(q[moves], bins, weights=count[moves])[0].tolist(),
            'samples_at_nodes': np.histogram(q, around, weights=count)[0].tolist(),
        }
    return view


def drift(run: RunResult) -> tuple[Array, Array, Array]:
    """Time (n,), s, mean displacement and its standard uncertainty (n, 3), m, by part of a run.

    In parts of the run, equal in time, the mean displacement d of all residuals r = a . d across
    the path is estimated by least squares; legs are the independent units of its uncertainty.
    """
    bounds, pieces = leg_bounds(run.pieces.leg), run.pieces
    gram = np.array([np.einsum('cpi,cpj->ij', *[run.axes[:, a:b]] * 2) for a, b in bounds])
    right = np.array(
        [np.einsum('cpi,cp->i', run.axes[:, a:b], run.residual[:, a:b]) for a, b in bounds]
    )
    middle = np.array([pieces.time[a:b].mean() for a, b in bounds])
    edges = np.linspace(0.0, float(pieces.time.max()) + 1e-9, DRIFT_PARTS + 1)
    changes = []
    for low, high in pairwise(edges):
        own = (middle >= low) & (middle < high)
        total = gram[own].sum(axis=0)
        strength = np.linalg.eigvalsh(total)
        if own.sum() < LEGS_PER_PART or strength[0] <= INFORMATION_SHARE * strength[-1]:
            continue
        value = np.linalg.solve(total, right[own].sum(axis=0))
        rest = right[own] - gram[own] @ value
        cover = np.linalg.inv(total)
        cover = cover @ (rest.T @ rest) @ cover * own.sum() / (own.sum() - 1)
        changes.append((float(middle[own].mean()), value, np.sqrt(np.diag(cover))))
    if not changes:
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
    time, value, u = (np.array(part) for part in zip(*changes, strict=True))
    return time, value, u


def run_view(run: RunResult) -> dict[str, Any]:
    """How a run was driven, what became of its samples, and where its residuals lie."""
    pieces, bounds = run.pieces, leg_bounds(run.pieces.leg)
    seen = run.T_machine_tracker.apply(pieces.xyz)
    length = np.linalg.norm(run.residual, axis=0)
    share = max(1, round(len(length) / STRETCHES))
    track, sizes, legs = list[Array](), list[float](), list[int]()
    for leg, (a, b) in enumerate(bounds):
        for c, d in pairwise(np.linspace(a, b, max(1, (b - a) // share) + 1).astype(int)):
            track.append(seen[c])
            sizes.append(float(np.sqrt(np.mean(length[c:d] ** 2))))
            legs.append(leg)
        track.append(seen[b - 1])
        sizes.append(0.0)
        legs.append(leg)
    square = [np.sum(rows**2, axis=0) for rows in (run.aligned, run.residual)]
    before, after = ([np.sqrt(own[a:b].mean()) for a, b in bounds] for own in square)
    time, value, u = drift(run)
    return {
        'standstill': pieces.standstill,
        'duration': float((pieces.time + pieces.duration).max()),
        'rate': run.rate,
        'feed': np.quantile(run.speed, (0.05, 0.5, 0.95)),
        'used': pieces.used,
        'outliers': pieces.outliers,
        'lost': {'samples': run.lost.samples, 'gaps': run.lost.gaps, 'longest': run.lost.longest},
        'remarks': run.remarks,
        'residual_rms_of': np.sqrt(np.mean(run.residual**2, axis=1)),
        'legs': {'time': _fine([pieces.time[a:b].mean() for a, b in bounds], 3),
                 'before': _fine(before), 'after': _fine(after)},
        'track': {'leg': legs, 'point': _fine(track, 5), 'residual': _fine(sizes)},
        'drift': {'time': _fine(time, 3), 'value': _fine(value), 'u': _fine(u)},
    }  # fmt: skip


def result_views(result: CalibrationResult) -> dict[str, Any]:
    """Return all blocks but those of the runs."""
    return {
        'volumetric_error': volume_view(result),
        'sizes': error_sizes(result),
        'coverage': coverage_view(result),
        'diagonals': tuple(diagonals_view(result)),
        'turns': turns_view(result),
    }
