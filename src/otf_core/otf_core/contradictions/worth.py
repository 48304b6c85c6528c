# SPDX-License-Identifier: Apache-2.0
"""Tables that are no use: as uncertain as the errors that they state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.contradictions.finding import GATE, WARNING, Finding
from otf_core.evaluation import rigid_columns
from otf_core.kinematics import displacement, motion_influence, squareness_influence
from otf_core.machine import AXES
from otf_core.runs import Run
from otf_core.tables import MOTIONS, SQUARENESS, ErrorTables
from otf_core.unknowns import interval

Array = NDArray[np.float64]

COUNT = 4
"""Points per axis of the lattice that is looked at."""
LEAST_SHOWN = 0.5
"""Share of the nodes that the data are to determine."""
REST = 5.0
"""Uncertainty over the noise of a sample below which small errors mean a good machine."""


def _determined(tables: ErrorTables, name: str) -> NDArray[np.bool_]:
    table = tables.motions[name]
    known = table.node_identifiable
    return np.ones(len(table.position), bool) if known is None else np.asarray(known)


def lattice_of(tables: ErrorTables) -> Array:
    """Lattice of nodes that the data determine, shape (n, 3), m.

    Single nodes that nothing shows are named in warnings; they are no measure of the rest.
    """
    lines = []
    for axis in AXES:
        names = [n for n in MOTIONS if n[2] == axis and tables.motions[n].identifiable]
        position = tables.motions[f'E{axis}{axis}'].position
        shown = np.ones(len(position), bool)
        for name in names:
            shown &= _determined(tables, name)
        use = position[shown] if shown.sum() > 1 else position
        lines.append(use[np.unique(np.linspace(0, len(use) - 1, COUNT).astype(int))])
    grids = np.meshgrid(*lines, indexing='ij')
    return np.stack([g.ravel() for g in grids], axis=1)


def shown_share(tables: ErrorTables) -> float:
    """Share of the nodes of identifiable motions that the data determine."""
    names = [n for n in MOTIONS if tables.motions[n].identifiable]
    return float(
        np.mean(np.concatenate([np.ones(1, bool), *(_determined(tables, n) for n in names)]))
    )


def _influence(tables: ErrorTables, q: Array) -> Array:
    """Displacement per unit of squareness and nodes, shape (n, 3, m)."""
    parts = [squareness_influence(n, q)[:, :, None] for n in SQUARENESS]
    for name in MOTIONS:
        position = tables.motions[name].position
        index, fraction = interval(position, q[:, AXES.index(name[2])])
        weight = np.zeros((len(q), len(position)))
        place = np.arange(len(q))
        weight[place, index] = 1.0 - fraction
        weight[place, np.minimum(index + 1, len(position) - 1)] += fraction
        parts.append(motion_influence(tables.machine, name, q)[:, :, None] * weight[:, None])
    return np.concatenate(parts, axis=2)


def volumetric(tables: ErrorTables, covariance: Array) -> tuple[float, float]:
    """Error that the tables state and its uncertainty, m.

    Root mean square of the length, and median over the volume, so that single nodes that nothing
    shows do not count; the rigid motion is taken out of both.

    Parameters
    ----------
    tables : ErrorTables
    covariance : ndarray, shape (m, m)
        Of squareness and nodes in the order of ``tables.MOTIONS``.
    """
    q = lattice_of(tables)
    columns = _influence(tables, q).reshape(3 * len(q), -1)
    basis, _ = np.linalg.qr(rigid_columns(q).reshape(-1, 6))

    def free(values: Array) -> Array:
        return np.asarray(values - basis @ (basis.T @ values))

    columns = free(columns)
    variance = np.sum((columns @ covariance) * columns, axis=1).reshape(-1, 3).sum(axis=1)
    error = free(displacement(tables, q).ravel())
    typical = float(np.median(np.maximum(variance, 0.0)))
    return float(np.sqrt(error @ error / len(q))), float(np.sqrt(typical))


def sample_noise(runs: Sequence[Run]) -> float:
    """Largest standard deviation of single samples among runs, m."""
    found = []
    for run in runs:
        distance = np.linalg.norm(run.pieces.xyz, axis=1)
        found.append(float(np.hypot(run.noise.u_range, run.noise.u_angle * distance.max())))
    return max(found)


def check_worth(tables: ErrorTables, covariance: Array, noise: float) -> list[Finding]:
    """Compare the error that tables state with its uncertainty.

    Parameters
    ----------
    tables : ErrorTables
    covariance : ndarray, shape (m, m)
    noise : float
        m; of a sample.
    """
    shown = shown_share(tables)
    if shown < LEAST_SHOWN:
        return [Finding('worth', GATE, (
            f'the data determine {100 * shown:.0f} % of the nodes of the tables only, the others '
            f'are interpolated: take a larger table_pitch, drive a path with more lines or stops '
            f'(plan), or calibrate on the fly (--method otf) if the run was driven without stops'
        ))]  # fmt: skip
    error, u = volumetric(tables, covariance)
    if u < error:
        return []
    text = (
        f'the volumetric error that the tables state is {1e6 * error:.2f} um, its standard '
        f'uncertainty in half of the driven volume is above {1e6 * u:.2f} um'
    )
    if u < REST * noise:
        return [Finding('worth', WARNING, (
            f'{text}: no more than the tracker can see; the machine needs no tables, or a '
            f'better place of the tracker'
        ))]  # fmt: skip
    return [Finding('worth', GATE, (
        f'{text}: they would not improve the machine. What is driven determines too little, or '
        f'the residuals are far above the noise: drive a path that plan recommends, take a '
        f'larger table_pitch, and mind the warnings'
    ))]  # fmt: skip
