# SPDX-License-Identifier: Apache-2.0
"""Pairs of nominal and measured positions from a table, as measuring software exports them.

The header names the coordinates of both: ``x,y,z,x_measured,y_measured,z_measured``, or
``Nom X  Nom Y  Meas X  Meas Y``; rotary axes by their letters. What was not measured has no
column, or an empty field. Columns ``target`` and ``run`` are optional.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Index
from otf_core.errors import InputError
from otf_core.files.text_table import (
    ANGLES,
    LENGTHS,
    NumberColumn,
    TextTable,
    fault_words,
    known_lengths,
    number_columns,
    read_text_table,
    reason_counts,
    split_heading,
)
from otf_core.inputs.columns import Column, coordinate_of, unit_of_head, units_below
from otf_core.inputs.text_points import length_unit, refuse_many
from otf_core.model.machine import TOOL, Machine, load_machine
from otf_core.model.motions import AXES, ROTARY
from otf_core.pieces.point_pairs import PointPairs

HEADER = 'x,y,z,x_measured,y_measured,z_measured'


def read_point_pairs(path: str | Path, machine: Machine | str | Path) -> list[PointPairs]:
    """Read pairs of nominal and measured positions, one ``PointPairs`` for every run.

    Raises
    ------
    ConfigError
        If the file cannot be read, or machine.yaml is wrong.
    InputError
        If it holds no pairs of this machine; says what is missing.

    Examples
    --------
    >>> x, y, z = np.random.default_rng(1).uniform(-0.1, 0.0, (3, 50)).round(3)
    >>> names = ['x', 'y', 'z', 'x_measured', 'y_measured', 'z_measured']
    >>> rows = np.stack([x, y, z, x + 2e-5 * x, y, z], axis=1)
    >>> np.savetxt('pairs.csv', rows, delimiter=',', header=','.join(names), comments='')
    >>> pairs = otf_core.read_point_pairs('pairs.csv', machine)
    >>> [len(run.measured) for run in pairs]
    [50]
    """
    machine = machine if isinstance(machine, Machine) else load_machine(machine)
    table = read_text_table(path, lambda names: bool(_pairs_of(names)[1]))
    nominal, measured = _pairs_of(table.names or ())
    if not measured:
        raise InputError(
            f'{path}: no header names nominal and measured coordinates; write one such as {HEADER}'
        )
    if wanted := [a for a in machine.axis_names if a not in nominal]:
        raise InputError(
            f'{path}: has no column of nominal {", ".join(wanted)}; {machine.name} has the chain '
            f'{machine.chain}'
        )
    headings = units_below([*nominal.values(), *measured.values()], table.units)
    numbers, _ = number_columns(
        table.where, table.lines, [(h.name, table.columns[h.place]) for h in headings]
    )
    unit, words = _unit_of_length(table, headings, numbers)
    given = dict(zip(nominal, numbers, strict=False))
    xyz = np.full((len(table.lines), 3), np.nan)
    for axis, column in zip(measured, numbers[len(nominal) :], strict=True):
        xyz[:, AXES.index(axis)] = unit * column.values
    xyz[~np.isfinite(xyz)] = np.nan
    bad = {row: why for one in given.values() for row, why in one.faults.items()}
    for heading, column in zip(measured.values(), numbers[len(nominal) :], strict=True):
        texts = table.columns[heading.place]  # an empty field was not measured
        bad |= {row: why for row, why in column.faults.items() if texts[row].strip()}
    bad |= {int(k): 'nothing was measured' for k in np.flatnonzero(np.isnan(xyz).all(axis=1))}
    faults = dict(table.faults) | {table.lines[row]: why for row, why in bad.items()}
    refuse_many(table, faults, len(table.lines) - len(bad))
    rows = np.delete(np.arange(len(table.lines)), sorted(bad))
    factors = {a: _factor(h, unit) for a, h in zip(nominal, headings, strict=False)}
    values = {a: c.values[rows] * factors[a] for a, c in given.items()}
    for axis in values.keys() - {*machine.axis_names}:
        if np.ptp(values[axis]) > 0.0:
            raise InputError(
                f'{path}: the nominal points move along {axis}, which the chain {machine.chain} '
                f'of {machine.name} does not'
            )
    q = np.stack([values[a] for a in machine.axis_names], axis=1)
    runs, targets = (_labels(table, name, rows) for name in ('run', 'target'))
    remarks = [words] if words else []
    if faults:
        remarks.append(f'left out {len(faults)} lines that are no pairs: {fault_words(faults)}')
    return [
        PointPairs(
            machine, q[runs == run], xyz[rows][runs == run],
            tuple(name or TOOL for name in targets[runs == run].tolist()),
            f'{path}: {run}' if run else str(path), tuple(remarks), tuple(reason_counts(faults)),
        )
        for run in dict.fromkeys(runs.tolist())
    ]  # fmt: skip


def _pairs_of(names: Sequence[str]) -> tuple[dict[str, Column], dict[str, Column]]:
    """Columns of the nominal and of the measured coordinates by axis; none if there are no pairs.

    What is not stated to be either is the other of the two.
    """
    found: dict[str, dict[str, Column]] = defaultdict(dict)
    for place, heading in enumerate(names):
        name, unit = split_heading(heading)
        seen, letter = coordinate_of(name), name.strip().upper()
        role = 'rotary' if letter in ROTARY else seen.role if seen else 'none'
        axis = letter if letter in ROTARY or seen is None else seen.axis.upper()
        if role != 'none' and axis in found[role]:
            return {}, {}  # of several points
        found[role][axis] = Column(place, unit, heading)
    plain = found[''] if found['nominal'] or found['measured'] else {}
    nominal, measured = found['nominal'] or plain, found['measured'] or plain
    if not nominal or not measured:
        return {}, {}
    return {**nominal, **found['rotary']}, measured


def _unit_of_length(
    table: TextTable, headings: Sequence[Column], numbers: Sequence[NumberColumn]
) -> tuple[float, str]:
    """Unit of the lengths, m, and in words how it was found where nothing states it."""
    lengths = [k for k, heading in enumerate(headings) if not _is_rotary(heading)]
    stated = {headings[k].unit for k in lengths} - {None} or {unit_of_head(table)}
    if len(stated) > 1:
        given = ' and '.join(sorted(map(repr, stated)))
        raise InputError(f'{table.where}: lengths are in {given}; expected {known_lengths()}')
    one = stated.pop()
    values = np.array([numbers[k].values for k in lengths])
    unit, words = length_unit(table.where, one, values)
    return LENGTHS[unit], '' if one else f'{table.where}: lengths in {words}'


def _is_rotary(column: Column) -> bool:
    """Whether a heading is the letter of a rotary axis."""
    return split_heading(column.name)[0].strip().upper() in ROTARY


def _factor(column: Column, unit: float) -> float:
    """Factor to m, or to rad where a heading is the letter of a rotary axis."""
    if not _is_rotary(column):
        return unit
    if (column.unit or 'rad') not in ANGLES:
        raise InputError(f'{column.name}: {column.unit!r} is no unit of angle')
    return ANGLES[column.unit or 'rad']


def _labels(table: TextTable, name: str, rows: Index) -> NDArray[np.str_]:
    """Texts (n,) of a column of labels; empty ones where there is none."""
    names = [n.strip().lower() for n in table.names or ()]
    texts = table.columns[names.index(name)] if name in names else ('',) * len(table.lines)
    return np.array([text.strip() for text in texts])[rows]
