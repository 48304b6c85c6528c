# SPDX-License-Identifier: Apache-2.0
"""Error tables: motions, squareness and location errors (ISO 230-1), piecewise linear.

A table is linear between its nodes and constant outside them; of an endless axis it repeats.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.files.message_text import shortened
from otf_core.files.strict_yaml import read_json, value_text
from otf_core.model.machine import Machine, machine_from_dict
from otf_core.model.motions import AXES, ErrorMotion, unit_of

SCHEMA, FIRST_SCHEMA = 'otf-error-tables/2', 'otf-error-tables/1'
"""The first one, of three linear axes, is read alone."""
FIT_COUNTS = ('samples', 'used', 'unknowns', 'rank')
FIT_LENGTHS = ('path_mae_before', 'path_mae_after', 'residual_rms')
ORTHONORMAL = 1e-4
"""Largest departure of a rotation matrix in a file, which may be rounded."""
Check = Callable[[Any, str], Any]
"""Takes a value and where it stands; returns it, or raises a ConfigError."""


@dataclass(frozen=True)
class MotionTable:
    """One error motion of one axis.

    Attributes
    ----------
    position : ndarray, shape (k,), m or rad
        Nodes, ascending, as programmed axis positions.
    value : ndarray, shape (k,), m or rad
        Actual minus nominal, target relative to table.
    u : ndarray, shape (k,), m or rad
        Standard uncertainty, k = 1.
    identifiable : bool
        False if the data cannot see the motion; its values are zero then.
    node_identifiable : ndarray of bool, shape (k,), optional
        False where the data do not determine a single node; its value continues smoothly what
        they determine. None where a file does not say.
    """

    position: NDArray[np.float64]
    value: NDArray[np.float64]
    u: NDArray[np.float64]
    identifiable: bool = True
    node_identifiable: NDArray[np.bool_] | None = None

    def at(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the error at axis positions q (any shape, m); constant outside the nodes."""
        return np.interp(q, self.position, self.value)

    @property
    def nodes_seen(self) -> NDArray[np.bool_]:
        """Which nodes the data determine, shape (k,); all where a file does not say."""
        if self.node_identifiable is None:
            return np.full(len(self.position), self.identifiable)
        return self.node_identifiable


@dataclass(frozen=True)
class Squareness:
    """A squareness error: value and standard uncertainty, rad."""

    value: float = 0.0
    u: float = 0.0


@dataclass(frozen=True)
class LocationError:
    """A location error of a rotary axis: value and standard uncertainty, m or rad."""

    value: float = 0.0
    u: float = 0.0
    identifiable: bool = True


@dataclass(frozen=True)
class ErrorTables:
    """Error tables of one machine.

    Attributes
    ----------
    motions : mapping of motion name (EXX ... ECZ) to MotionTable
    squareness : mapping of C0Y, B0Z, A0Z to Squareness
        As far as both axes are there.
    location : mapping of name, such as X0C, to LocationError
        Of the rotary axes; empty without any.

    Examples
    --------
    >>> tables = otf_core.load_tables('bags/y-carries-the-table/truth.json').tables
    >>> q = [-0.15, 0.0, 0.15]
    >>> twice = tables.scaled(2.0)
    >>> bool((twice.motions['EXX'].at(q) == 2 * tables.motions['EXX'].at(q)).all())
    True
    """

    machine: Machine
    motions: Mapping[str, MotionTable]
    squareness: Mapping[str, Squareness]
    location: Mapping[str, LocationError] = field(default_factory=dict)

    def scalar(self, name: str) -> float:
        """Value of a squareness or location error, m or rad."""
        return (self.squareness[name] if name in self.squareness else self.location[name]).value

    def scalar_u(self, name: str) -> float:
        """Its standard uncertainty."""
        return (self.squareness[name] if name in self.squareness else self.location[name]).u

    def scaled(self, factor: float) -> ErrorTables:
        """Return the same tables with every error multiplied by a factor."""
        return replace(
            self,
            motions={k: replace(m, value=m.value * factor) for k, m in self.motions.items()},
            squareness={k: Squareness(s.value * factor, s.u) for k, s in self.squareness.items()},
            location={k: replace(v, value=v.value * factor) for k, v in self.location.items()},
        )

    def on(self, machine: Machine) -> ErrorTables:
        """Return the same errors of a machine that is described anew: target, ranges, tracker.

        Raises
        ------
        ConfigError
            If its chain is another: the errors would mean something else.
        """
        if machine.chain != self.machine.chain:
            raise ConfigError(
                f'tables are of a machine with the chain {self.machine.chain}, '
                f'{machine.name} has {machine.chain}: not one machine'
            )
        return replace(self, machine=machine)


def with_uncertainty(tables: ErrorTables, covariance: NDArray[np.float64]) -> ErrorTables:
    """Return the tables with the standard uncertainties of a covariance.

    Parameters
    ----------
    covariance : ndarray, shape (m, m), m and rad
        Of squareness and location errors and the nodes of all motions in that order.
    """
    machine = tables.machine
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    squareness = {
        name: replace(tables.squareness[name], u=float(u[k]))
        for k, name in enumerate(machine.squareness)
    }
    location = {
        name: replace(own, u=float(u[k]) * own.identifiable)
        for k, name in enumerate(machine.location, start=len(machine.squareness))
        for own in [tables.location[name]]
    }
    motions: dict[str, MotionTable] = {}
    start = len(machine.scalars)
    for name in machine.motions:
        table = tables.motions[name]
        stop = start + len(table.position)
        motions[name] = replace(table, u=u[start:stop] if table.identifiable else 0.0 * table.u)
        start = stop
    return replace(tables, motions=motions, squareness=squareness, location=location)


@dataclass(frozen=True)
class TablesFile:
    """Content of an error_tables.json.

    Attributes
    ----------
    extra : mapping of str to object
        All other top-level keys.
    without_value : tuple of str
        Squareness and location errors of which the file says nothing; they are zero.
    without_u : tuple of str
        What the file gives without an uncertainty; it is zero in the tables.
    """

    tables: ErrorTables
    extra: Mapping[str, Any] = field(default_factory=dict)
    without_value: tuple[str, ...] = ()
    without_u: tuple[str, ...] = ()


def tables_to_dict(tables: ErrorTables) -> dict[str, Any]:
    """Return the tables as plain data in the layout of error_tables.json."""
    machine, motions = tables.machine, {}
    for name in machine.motions:
        table = tables.motions[name]
        motions[name] = {
            'axis': name.axis,
            'unit': unit_of(name),
            'position_unit': machine.axes[name.axis].unit,
            'position': table.position.tolist(),
            'value': table.value.tolist(),
            'u': table.u.tolist(),
            'identifiable': table.identifiable,
        }
        if table.node_identifiable is not None:
            motions[name]['node_identifiable'] = table.node_identifiable.tolist()
    return {
        'schema': SCHEMA,
        'machine': machine.to_dict(),
        'motions': motions,
        'squareness': {k: asdict(tables.squareness[k]) for k in machine.squareness},
        'location': {k: asdict(tables.location[k]) for k in machine.location},
    }


def _number(value: Any, where: str) -> float:
    try:
        number = float(value) if isinstance(value, (int, float)) else math.nan
    except OverflowError:
        number = math.nan
    if isinstance(value, bool) or not math.isfinite(number):
        raise ConfigError(f'{where}: expected a finite number, got {value_text(value)}')
    return number


def _not_negative(value: Any, where: str) -> float:
    number = _number(value, where)
    if number < 0:
        raise ConfigError(f'{where}: must not be negative, got {number:g}')
    return number


def _flag(value: Any, where: str) -> bool:
    if not isinstance(value, bool):
        raise ConfigError(f'{where}: expected true or false, got {value_text(value)}')
    return value


def _members(values: Any, where: str, check: Check, size: int = 0) -> list[Any]:
    """Members of a list, each checked; as many as ``size`` says if that is above 0."""
    if not isinstance(values, list) or not values:
        raise ConfigError(f'{where}: expected a list, got {value_text(values)}')
    if size and len(values) != size:
        raise ConfigError(f'{where}: has length {len(values)}, expected {size}')
    return [check(value, f'{where}: entry {k}') for k, value in enumerate(values)]


def _row(values: Any, where: str) -> list[Any]:
    return _members(values, where, _number, 3)


def _array(
    entry: Mapping[str, Any], key: str, where: str, check: Check = _number, size: int = 0
) -> NDArray[Any]:
    if key not in entry:
        raise ConfigError(f'{where}: {key}: missing')
    return np.array(_members(entry[key], f'{where}: {key}', check, size))


def _motion(entry: Any, name: ErrorMotion, machine: Machine, where: str) -> MotionTable:
    if not isinstance(entry, Mapping):
        raise ConfigError(f'{where}: expected position, value and u, got {value_text(entry)}')
    along = machine.axes[name.axis].unit
    for key, right in (('unit', name.unit), ('axis', name.axis), ('position_unit', along)):
        if entry.get(key, right) != right:
            raise ConfigError(f"{where}: {key}: must be '{right}', got {value_text(entry[key])}")
    position = _array(entry, 'position', where)
    if np.any(np.diff(position) <= 0):
        raise ConfigError(f'{where}: position: must ascend strictly')
    size = len(position)
    value = _array(entry, 'value', where, size=size)
    u = _array(entry, 'u', where, _not_negative, size) if 'u' in entry else np.zeros(size)
    known = None
    if 'node_identifiable' in entry:
        known = _array(entry, 'node_identifiable', where, _flag, size)
    seen = _flag(entry.get('identifiable', True), f'{where}: identifiable')
    return MotionTable(position, value, u, seen, known)


def _squareness(data: Mapping[str, Any], name: str, where: str) -> Squareness:
    entry = _mapping(data, name, where)
    return Squareness(
        _number(entry.get('value', 0.0), f'{where}: {name}: value'),
        _not_negative(entry.get('u', 0.0), f'{where}: {name}: u'),
    )


def _location(data: Mapping[str, Any], name: str, where: str) -> LocationError:
    entry = _mapping(data, name, where)
    return LocationError(
        _number(entry.get('value', 0.0), f'{where}: {name}: value'),
        _not_negative(entry.get('u', 0.0), f'{where}: {name}: u'),
        _flag(entry.get('identifiable', True), f'{where}: {name}: identifiable'),
    )


def _mapping(data: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    """Mapping under a key; empty where there is none."""
    mapping = data.get(key)
    if mapping is None:
        return {}
    if not isinstance(mapping, Mapping):
        raise ConfigError(f'{where}: {key}: expected a mapping, got {value_text(mapping)}')
    return mapping


def _named(
    data: Mapping[str, Any], key: str, names: Collection[str], where: str
) -> Mapping[str, Any]:
    """The same, with keys that are all among ``names``."""
    mapping = _mapping(data, key, where)
    unknown = sorted(set(mapping) - set(names))
    if unknown:
        raise ConfigError(
            f'{where}: {key}: {shortened(unknown[0])}: unknown; known for this chain: '
            f'{", ".join(names) or "none"}'
        )
    return mapping


def tables_from_dict(data: Any, where: str) -> TablesFile:
    """Build tables from plain data in the layout of error_tables.json.

    ``u``, ``identifiable``, ``node_identifiable``, ``axis``, ``unit``, squareness, alignment and
    fit may be missing; what is there has to be of its type.

    Raises
    ------
    ConfigError
        Names the file, the motion and what is wrong with it.
    """
    if not isinstance(data, Mapping) or data.get('schema') not in (SCHEMA, FIRST_SCHEMA):
        raise ConfigError(f"{where}: not error tables; expected schema '{SCHEMA}'")
    machine = machine_from_dict(data.get('machine'), f'{where}: machine')
    if data['schema'] == FIRST_SCHEMA and machine.axis_names != AXES:
        raise ConfigError(f"{where}: schema: must be '{SCHEMA}' for the chain {machine.chain}")
    motions = _named(data, 'motions', machine.motions, where)
    missing = [name for name in machine.motions if name not in motions]
    if missing:
        raise ConfigError(f'{where}: motions: {missing[0] if motions else "all"} missing')
    squareness = _named(data, 'squareness', machine.squareness, where)
    location = _named(data, 'location', machine.location, where)
    tables = ErrorTables(
        machine,
        {name: _motion(motions[name], name, machine, f'{where}: {name}')
         for name in machine.motions},
        {name: _squareness(squareness, name, f'{where}: squareness')
         for name in machine.squareness},
        {name: _location(location, name, f'{where}: location') for name in machine.location},
    )  # fmt: skip
    _check_alignment(_mapping(data, 'alignment', where), f'{where}: alignment')
    _check_fit(_mapping(data, 'fit', where), f'{where}: fit')
    known = tables_to_dict(tables)
    extra = {k: v for k, v in data.items() if k not in known}
    angles = {name: _mapping(squareness, name, where) for name in machine.squareness}
    angles |= {name: _mapping(location, name, where) for name in machine.location}
    silent = tuple(name for name, entry in angles.items() if 'value' not in entry)
    given = {**{n: e for n, e in angles.items() if n not in silent}, **motions}
    return TablesFile(tables, extra, silent, tuple(n for n, e in given.items() if 'u' not in e))


def _check_alignment(entry: Mapping[str, Any], where: str) -> None:
    """Refuse an alignment that is no rotation with a translation; either may be missing."""
    if 'translation' in entry:
        _array(entry, 'translation', where, size=3)
    if 'rotation' in entry:
        rotation = _array(entry, 'rotation', where, _row, 3)
        turned = np.abs(rotation @ rotation.T - np.eye(3)).max()
        if turned > ORTHONORMAL or np.linalg.det(rotation) < 0:
            raise ConfigError(f'{where}: rotation: not a rotation matrix')


def _check_fit(entry: Mapping[str, Any], where: str) -> None:
    """Refuse a fit whose counts are no counts or whose lengths are no lengths."""
    for key in FIT_COUNTS:
        value = entry.get(key, 0)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise ConfigError(f'{where}: {key}: expected a count, got {value_text(value)}')
    for key in FIT_LENGTHS:
        _not_negative(entry.get(key, 0.0), f'{where}: {key}')


def load_tables(path: str | Path) -> TablesFile:
    """Read an error_tables.json.

    Raises
    ------
    ConfigError
        Says what is wrong and where.

    Examples
    --------
    >>> content = otf_core.load_tables('bags/y-carries-the-table/truth.json')
    >>> content.tables.squareness['C0Y'].value == 0
    False
    """
    return tables_from_dict(read_json(path), str(path))
