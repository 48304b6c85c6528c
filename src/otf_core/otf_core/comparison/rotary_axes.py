# SPDX-License-Identifier: Apache-2.0
"""Tables of two sources of one machine with rotary axes, compared error by error and in volume.

Where both files are in the gauge of our tables and cover the same range of an axis, its motions
and location errors are compared as they stand: the line of a rotary axis is that over its nodes.
Where they are not, only the volume is compared, which knows no gauge but a rigid motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.compare import MotionComparison, SquarenessComparison
from otf_core.errors import ConfigError
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.kinematics import displacement, nominal_position
from otf_core.model.machine import Axis, Machine
from otf_core.model.nodes import hat_matrix
from otf_core.model.tables import ErrorTables, TablesFile, load_tables
from otf_core.prediction.covariance import unpack_covariance
from otf_core.prediction.driven_volume import table_ranges

SAME_LINE = 1e-6
"""m, or 1 for directions; nominal lines that differ by less are one."""
SAME_RANGE = 0.02
"""Share of the range of an axis by which the ends of two tables may differ."""
GRID_POINTS = 5
"""Points per axis of the volume."""


@dataclass(frozen=True)
class RotaryComparison:
    """Two sources compared.

    Attributes
    ----------
    machine : Machine
        That of the first.
    motions : mapping of motion to MotionComparison
        Positions in m and rad.
    scalars : mapping of name to SquarenessComparison
        Squareness (rad) and location errors (m, rad).
    not_compared : mapping of name to str
        What is left out, and why.
    volume : tuple of float
        Mean length of the errors of a, of b and of b - a over the common range, m; each without
        its rigid motion.
    points : int
        Of the volume.
    """

    names: tuple[str, str]
    machine: Machine
    motions: Mapping[str, MotionComparison]
    scalars: Mapping[str, SquarenessComparison]
    not_compared: Mapping[str, str]
    volume: tuple[float, float, float]
    points: int


def compare_rotary(first: str | Path, second: str | Path) -> RotaryComparison:
    """Compare two files of error tables of a machine with rotary axes.

    Raises
    ------
    ConfigError
        If they are not of one machine, or their nominal lines are not the same.
    """
    for path in (first, second):
        if Path(path).suffix.lower() == '.csv':
            raise ConfigError(
                f'{path}: a direct measurement is compared with tables of three linear axes only'
            )
    names = (_name(first), _name(second))
    a, b = load_tables(first), load_tables(second)
    machine = a.tables.machine
    check_one_machine(names, machine, b.tables.machine)
    left_out = not_compared(names, a, b)
    motions = {str(m): _motion(a, b, str(m)) for m in machine.motions if str(m) not in left_out}
    scalars = {n: _scalar(a, b, n) for n in machine.scalars if n not in left_out}
    sizes, points = _volume(a.tables, b.tables)
    return RotaryComparison(names, machine, motions, scalars, left_out, sizes, points)


def _name(path: str | Path) -> str:
    path = Path(path)
    return path.parent.name or str(path) if path.stem == 'error_tables' else path.stem


def check_one_machine(names: tuple[str, str], a: Machine, b: Machine) -> None:
    """Refuse tables of another machine, or of other nominal lines.

    Raises
    ------
    ConfigError
    """
    if str(a.chain) != str(b.chain):
        raise ConfigError(
            f'{names[1]}: chain {b.chain}, but {names[0]} has {a.chain}; these are different '
            f'machines'
        )
    for axis in a.rotary_names:
        if not _same_line(a.axes[axis], b.axes[axis]):
            raise ConfigError(
                f'{names[1]}: direction or centre of {axis} is not that of {names[0]}; location '
                f'errors count from these, so calibrate both with the same ones'
            )


def _same_line(a: Axis, b: Axis) -> bool:
    assert a.direction is not None and b.direction is not None
    return np.allclose(a.direction, b.direction, atol=SAME_LINE, rtol=0) and np.allclose(
        a.centre, b.centre, atol=SAME_LINE, rtol=0
    )


def not_compared(names: tuple[str, str], a: TablesFile, b: TablesFile) -> dict[str, str]:
    """What cannot be compared, and why."""
    machine = a.tables.machine
    reasons: dict[str, str] = {}
    gauges = [source.extra.get('gauge') for source in (a, b)]
    one_gauge = gauges[0] == gauges[1] and gauges[0] is not None
    unstated = [n for n, gauge in zip(names, gauges, strict=True) if gauge is None]
    apart_words = (
        f'{" and ".join(unstated)} state{"s" * (len(unstated) == 1)} no gauge' if unstated
        else 'the gauges differ'
    ) + ', so that only the errors in the volume can be compared'  # fmt: skip
    ends = [table_ranges(s.tables) for s in (a, b)]
    for k, axis in enumerate(machine.axis_names):
        own = [str(m) for m in machine.motions if m.axis == axis]
        own += [n for n in machine.location if n[-1] == axis]
        width = machine.axes[axis].max - machine.axes[axis].min
        apart = max(abs(ends[0][j][k] - ends[1][j][k]) for j in (0, 1))
        if not one_gauge:
            reasons |= dict.fromkeys(own, apart_words)
        elif apart > SAME_RANGE * width:
            reasons |= dict.fromkeys(own, f'the tables cover different ranges of {axis}')
    if not one_gauge:
        reasons |= dict.fromkeys(machine.squareness, apart_words)
    for name, source in zip(names, (a, b), strict=True):
        listed = source.extra.get('not_identifiable')
        hidden = set(listed) if isinstance(listed, list) else set()
        hidden |= {m for m, t in source.tables.motions.items() if not t.identifiable}
        hidden |= {n for n, v in source.tables.location.items() if not v.identifiable}
        for error in (*machine.scalars, *map(str, machine.motions)):
            if error in hidden:
                reasons[error] = f'{name} does not determine it'
    return reasons


def whole_vector(source: TablesFile) -> tuple[Array, Array]:
    """Scalars and nodes of all motions in the order of a file, (m,), and their covariance."""
    tables = source.tables
    machine = tables.machine
    own = [tables.squareness[n] for n in machine.squareness]
    lines = [tables.location[n] for n in machine.location]
    motions = [tables.motions[m] for m in machine.motions]
    scalar = [s.value for s in own] + [s.value for s in lines]
    value = np.concatenate([scalar, *(m.value for m in motions)])
    covariance = unpack_covariance(source.extra.get('covariance'), len(value))
    if covariance is None:
        u_scalar = [s.u for s in own] + [s.u for s in lines]
        u = np.concatenate([u_scalar, *(m.u for m in motions)])
        covariance = np.diag(u**2)
    return value, covariance


def _motion(a: TablesFile, b: TablesFile, name: str) -> MotionComparison:
    both = [s.tables.motions[name].position for s in (a, b)]
    low, high = max(p[0] for p in both), min(p[-1] for p in both)
    at = np.unique(np.concatenate([[low, high], *both]))
    at = at[(at >= low) & (at <= high)]
    at = at[np.concatenate([[True], np.diff(at) > 1e-9])]
    (va, ua), (vb, ub) = (_values(s, name, at) for s in (a, b))
    return MotionComparison(at, va, vb, ua, ub)


def _values(source: TablesFile, name: str, at: Array) -> tuple[Array, Array]:
    """Values and standard uncertainties of a motion at positions (k,)."""
    tables = source.tables
    table, machine = tables.motions[name], tables.machine
    rows = hat_matrix(table.position, at)
    start = len(machine.scalars)
    for motion in machine.motions:
        if motion == name:
            break
        start += len(tables.motions[motion].position)
    size = len(machine.scalars)
    size += sum(len(tables.motions[m].position) for m in machine.motions)
    whole = unpack_covariance(source.extra.get('covariance'), size)
    part = slice(start, start + len(table.position))
    covariance = np.diag(table.u**2) if whole is None else whole[part, part]
    variance = np.einsum('ij,jk,ik->i', rows, covariance, rows)
    return rows @ table.value, np.sqrt(np.maximum(variance, 0.0))


def _scalar(a: TablesFile, b: TablesFile, name: str) -> SquarenessComparison:
    def u(tables: ErrorTables) -> float:
        own = tables.squareness if name in tables.squareness else tables.location
        return own[name].u

    return SquarenessComparison(
        a.tables.scalar(name), b.tables.scalar(name), u(a.tables), u(b.tables)
    )


def _volume(a: ErrorTables, b: ErrorTables) -> tuple[tuple[float, float, float], int]:
    """Mean lengths over the range both cover, at the target offset of a."""
    machine = a.machine
    ranges = [table_ranges(t) for t in (a, b)]
    low = np.maximum(ranges[0][0], ranges[1][0])
    high = np.minimum(ranges[0][1], ranges[1][1])
    if np.any(high < low):
        axis = machine.axis_names[int(np.argmax(low - high))]
        raise ConfigError(f'axis {axis}: the sources cover no common range')
    q = lattice(machine, GRID_POINTS)
    share = (q - machine.lower) / (machine.upper - machine.lower)
    q = low + share * (high - low)
    at = nominal_position(machine, q)
    fields = [without_rigid_motion(displacement(t.on(machine), q), at) for t in (a, b)]
    sizes = mean_length(fields[0]), mean_length(fields[1]), mean_length(fields[1] - fields[0])
    return sizes, len(q)
