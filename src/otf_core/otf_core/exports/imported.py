# SPDX-License-Identifier: Apache-2.0
"""Error tables from volumetric errors on a lattice: least squares over all 21 functions.

Nodes stand at the planes of the lattice. The rigid-body model is linear in the node values, so
e = A p; of all p that fit alike (what is squareness, what a slope) the shortest is taken, angles
in units of the longest travel. What the model cannot follow stays over and is reported. Rotations
that act like translations, since no other axis changes their lever, are these: they are zero and
marked as not seen, so that a prediction for another target offset knows it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.exports.lattice import Lattice
from otf_core.files.units import unit_hint, unit_words
from otf_core.model.kinematics import has_constant_lever
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables, MotionTable, Squareness
from otf_core.prediction.uncertainty import prediction_rows

SMALLEST = 1e-10
"""Relative size of singular values below which a combination is not determined."""
EDGE = 1e-3
"""m; a lattice further outside the axes is not of this machine."""

LARGEST = 0.01
"""Of the travel; no machine has larger errors."""
SMALLEST_IN_UM = 1.0
"""Of the travel; errors in mm, read as m, are less."""


@dataclass(frozen=True)
class ImportedTables:
    """Tables and what they leave of the lattice.

    Attributes
    ----------
    tables : ErrorTables
        Without uncertainties.
    size_rms, left_rms : float
        m; of the errors on the lattice, and of what the tables do not follow.
    """

    tables: ErrorTables
    size_rms: float
    left_rms: float


def tables_from_lattice(lattice: Lattice, machine: Machine) -> ImportedTables:
    """Fit error tables to a lattice.

    Parameters
    ----------
    lattice : Lattice
    machine : Machine
        Its chain and target offset say how rotations act.

    Raises
    ------
    ConfigError
        If the lattice reaches beyond the axes of the machine, or its errors are none of a machine.
    """
    q = lattice.points
    _check_size(lattice, machine)
    nodes: dict[str, Array] = {m: lattice.axes[m.place] for m in MOTIONS}
    matrix = prediction_rows(machine, nodes, q).reshape(3 * len(q), -1)
    sizes = [1] * len(SQUARENESS) + [len(nodes[m]) for m in MOTIONS]
    reach = float(np.max(machine.upper - machine.lower))
    scale = np.concatenate(
        [[1.0 / reach] * len(SQUARENESS)]
        + [np.full(len(nodes[m]), 1.0 if m.is_translation else 1.0 / reach) for m in MOTIONS]
    )
    low, high = q.min(axis=0), q.max(axis=0)
    rotations = [m for m in MOTIONS if not m.is_translation]
    hidden = {m for m in rotations if has_constant_lever(machine, m, low, high)}
    scale[np.repeat([False] * len(SQUARENESS) + [m in hidden for m in MOTIONS], sizes)] = 0.0
    scaled, wanted = matrix * scale, lattice.error.reshape(-1)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    seen = values > SMALLEST * values[-1]
    basis = vectors[:, seen]
    solved = scale * (basis @ ((basis.T @ (scaled.T @ wanted)) / values[seen]))
    left = wanted - matrix @ solved
    tables = _tables(machine, nodes, solved, hidden)
    return ImportedTables(tables, float(_rms(wanted)), float(_rms(left)))


def _check_size(lattice: Lattice, machine: Machine) -> None:
    """Refuse positions and errors in another unit than m."""
    q, size = lattice.points, float(np.max(machine.upper - machine.lower))
    beyond = float(np.maximum(machine.lower - q, q - machine.upper).max())
    if beyond > EDGE:
        reach = float(np.abs([machine.lower, machine.upper]).max())
        hint = unit_hint(float(np.abs(q).max()), reach)
        named = f'x_{hint},y_{hint},z_{hint}'
        words = f'; are they in {unit_words(hint)}? write {named} into the header'
        raise ConfigError(
            f'lattice: reaches {1e3 * beyond:.4g} mm beyond the axes of {machine.name}; '
            f'positions are in m{words if hint else ""}'
        )
    largest = float(np.abs(lattice.error).max())
    if largest > LARGEST * size:
        unit = 'um' if largest > SMALLEST_IN_UM * size else 'mm'
        raise ConfigError(
            f'lattice: an error of {largest:g} m is none of a machine of {size:g} m; are dx, dy, '
            f'dz in {unit_words(unit)}? write dx_{unit},dy_{unit},dz_{unit} into the header'
        )


def _rms(values: Array) -> Array:
    """Root mean square of vectors of three."""
    return np.asarray(np.sqrt(np.mean(np.sum(values.reshape(-1, 3) ** 2, axis=1))))


def _tables(
    machine: Machine, nodes: dict[str, Array], values: Array, hidden: Collection[str]
) -> ErrorTables:
    square = {k: Squareness(float(v)) for k, v in zip(SQUARENESS, values[:3], strict=True)}
    motions: dict[str, MotionTable] = {}
    start = len(SQUARENESS)
    for motion in MOTIONS:
        position = nodes[motion]
        own = values[start : start + len(position)]
        motions[motion] = MotionTable(position, own, np.zeros(len(position)), motion not in hidden)
        start += len(position)
    return ErrorTables(machine, motions, square)
