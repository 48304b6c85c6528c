# SPDX-License-Identifier: Apache-2.0
"""Error tables: 18 error motions and 3 squareness errors (ISO 230-1), piecewise linear.

A table is linear between its nodes and constant outside them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.files.json_file import read_json
from otf_core.files.strict_yaml import shown
from otf_core.model.machine import AXES, Machine, machine_from_dict

DIRECTIONS = ('X', 'Y', 'Z', 'A', 'B', 'C')
MOTIONS = tuple(f'E{d}{a}' for a in AXES for d in DIRECTIONS)
SQUARENESS = ('C0Y', 'B0Z', 'A0Z')
SCHEMA = 'otf-error-tables/1'


def unit_of(motion: str) -> str:
    """Return 'm' for a translation such as EYX, 'rad' for a rotation such as EBX."""
    return 'm' if motion[1] in 'XYZ' else 'rad'


def is_positioning(motion: str) -> bool:
    """Tell whether a motion is a linear positioning error such as EXX."""
    return motion[1] == motion[2]


def is_straightness(motion: str) -> bool:
    """Tell whether a motion is a straightness error such as EYX."""
    return motion[1] in 'XYZ' and not is_positioning(motion)


@dataclass(frozen=True)
class MotionTable:
    """One error motion of one axis.

    Attributes
    ----------
    position : ndarray, shape (k,), m
        Nodes, ascending, as programmed axis positions.
    value : ndarray, shape (k,), m or rad
        Actual minus nominal, target relative to table.
    u : ndarray, shape (k,), m or rad
        Standard uncertainty, k = 1.
    identifiable : bool
        False if the data cannot see the motion; its values are zero then.
    node_identifiable : ndarray of bool, shape (k,)
        False where a single node is not determined and was interpolated from its neighbours.
    """

    position: NDArray[np.float64]
    value: NDArray[np.float64]
    u: NDArray[np.float64]
    identifiable: bool = True
    node_identifiable: NDArray[np.bool_] | None = None

    def at(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the error at axis positions q (any shape, m); constant outside the nodes."""
        return np.interp(q, self.position, self.value)


@dataclass(frozen=True)
class Squareness:
    """A squareness error: value and standard uncertainty, rad."""

    value: float = 0.0
    u: float = 0.0


@dataclass(frozen=True)
class ErrorTables:
    """Error tables of one machine.

    Attributes
    ----------
    machine : Machine
    motions : mapping of motion name (EXX ... ECZ) to MotionTable
    squareness : mapping of C0Y, B0Z, A0Z to Squareness
    """

    machine: Machine
    motions: Mapping[str, MotionTable]
    squareness: Mapping[str, Squareness]

    def scaled(self, factor: float) -> ErrorTables:
        """Return the same tables with every error multiplied by a factor."""
        return replace(
            self,
            motions={k: replace(m, value=m.value * factor) for k, m in self.motions.items()},
            squareness={k: Squareness(s.value * factor, s.u) for k, s in self.squareness.items()},
        )


def with_uncertainty(tables: ErrorTables, covariance: NDArray[np.float64]) -> ErrorTables:
    """Return the tables with the standard uncertainties of a covariance.

    Parameters
    ----------
    tables : ErrorTables
    covariance : ndarray, shape (m, m), m and rad
        Of C0Y, B0Z, A0Z and the nodes of EXX ... ECZ in that order.
    """
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    squareness = {
        name: replace(tables.squareness[name], u=float(u[k])) for k, name in enumerate(SQUARENESS)
    }
    motions, start = {}, len(SQUARENESS)
    for name in MOTIONS:
        table = tables.motions[name]
        stop = start + len(table.position)
        motions[name] = replace(table, u=u[start:stop] if table.identifiable else 0.0 * table.u)
        start = stop
    return replace(tables, motions=motions, squareness=squareness)


@dataclass(frozen=True)
class TablesFile:
    """Content of an error_table.json: the tables and all other top-level keys."""

    tables: ErrorTables
    extra: Mapping[str, Any] = field(default_factory=dict)


def tables_to_dict(tables: ErrorTables) -> dict[str, Any]:
    """Return the tables as plain data in the layout of error_tables.json."""
    motions = {}
    for name in MOTIONS:
        table = tables.motions[name]
        motions[name] = {
            'axis': name[2],
            'unit': unit_of(name),
            'position': table.position.tolist(),
            'value': table.value.tolist(),
            'u': table.u.tolist(),
            'identifiable': table.identifiable,
        }
        if table.node_identifiable is not None:
            motions[name]['node_identifiable'] = table.node_identifiable.tolist()
    return {
        'schema': SCHEMA,
        'machine': tables.machine.to_dict(),
        'motions': motions,
        'squareness': {
            k: {'value': tables.squareness[k].value, 'u': tables.squareness[k].u}
            for k in SQUARENESS
        },
    }


def _array(entry: Mapping[str, Any], key: str, where: str) -> NDArray[np.float64]:
    try:
        values = np.asarray(entry[key], dtype=float)
    except KeyError:
        raise ConfigError(f'{where}: {key}: missing') from None
    except (TypeError, ValueError, OverflowError):
        raise ConfigError(f'{where}: {key}: expected a list of numbers') from None
    if values.ndim != 1 or not values.size or not np.all(np.isfinite(values)):
        raise ConfigError(f'{where}: {key}: expected a list of finite numbers')
    return values


def _motion(entry: Any, name: str, where: str) -> MotionTable:
    if not isinstance(entry, Mapping):
        raise ConfigError(f'{where}: expected position, value and u')
    position, value = _array(entry, 'position', where), _array(entry, 'value', where)
    u = _array(entry, 'u', where) if 'u' in entry else np.zeros_like(value)
    if not position.size == value.size == u.size:
        raise ConfigError(f'{where}: position, value and u differ in length')
    if np.any(u < 0):
        raise ConfigError(f'{where}: u: must not be negative')
    for key, right in (('unit', unit_of(name)), ('axis', name[2])):
        if entry.get(key, right) != right:
            raise ConfigError(f"{where}: {key}: must be '{right}', got {shown(entry[key])}")
    if np.any(np.diff(position) <= 0):
        raise ConfigError(f'{where}: position: must ascend strictly')
    return MotionTable(position, value, u, bool(entry.get('identifiable', True)))


def _squareness(data: Any, name: str, where: str) -> Squareness:
    try:
        unknown = sorted(set(data) - set(SQUARENESS))
        entry = data.get(name) or {}
        result = Squareness(float(entry.get('value', 0.0)), float(entry.get('u', 0.0)))
    except (AttributeError, TypeError, ValueError, OverflowError):
        raise ConfigError(f'{where}: squareness: {name}: expected value and u') from None
    if unknown:
        raise ConfigError(f'{where}: squareness: {unknown[0]}: unknown squareness error')
    if not math.isfinite(result.value) or not math.isfinite(result.u) or result.u < 0:
        raise ConfigError(f'{where}: squareness: {name}: must be finite, u not negative')
    return result


def tables_from_dict(data: Any, where: str) -> TablesFile:
    """Build tables from plain data in the layout of error_tables.json.

    Raises
    ------
    ConfigError
        Names the file, the motion and what is wrong with it.
    """
    if not isinstance(data, Mapping) or data.get('schema') != SCHEMA:
        raise ConfigError(f"{where}: no error tables; expected schema '{SCHEMA}'")
    motions = data.get('motions')
    if not isinstance(motions, Mapping):
        raise ConfigError(f'{where}: motions: missing')
    unknown = sorted(set(motions) - set(MOTIONS))
    missing = sorted(set(MOTIONS) - set(motions))
    if unknown or missing:
        raise ConfigError(
            f'{where}: motions: '
            + (f'{unknown[0]}: unknown motion' if unknown else f'{missing[0]}: missing')
        )
    tables = ErrorTables(
        machine_from_dict(data.get('machine'), f'{where}: machine'),
        {name: _motion(motions[name], name, f'{where}: {name}') for name in MOTIONS},
        {name: _squareness(data.get('squareness') or {}, name, where) for name in SQUARENESS},
    )
    extra = {k: v for k, v in data.items() if k not in tables_to_dict(tables)}
    return TablesFile(tables, extra)


def load_tables(path: str | Path) -> TablesFile:
    """Read an error_tables.json; ConfigError says what is wrong and where."""
    return tables_from_dict(read_json(path), str(path))
