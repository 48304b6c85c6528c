# SPDX-License-Identifier: Apache-2.0
"""What people bring: recordings, tables, programs, YAML; and which kind of all a file is."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path

import numpy as np

from otf_core.bags.bag_reading import BagReading, path_of
from otf_core.bags.bag_source import is_storage
from otf_core.bags.topics import PATH, POINT
from otf_core.errors import ConfigError, OtfError
from otf_core.files.strict_yaml import read_yaml
from otf_core.files.writing import unreadable
from otf_core.info.kind import Explained, Kind, begins
from otf_core.info.result_kinds import EXPORT, FOLDER, JSON_KINDS, OTHER, RESIDUALS
from otf_core.inputs.columns import find_columns, read_table
from otf_core.inputs.nc_program import is_program, read_program
from otf_core.inputs.points_file import read_points
from otf_core.inputs.text_points import TextReading, is_text
from otf_core.model.machine import load_machine
from otf_core.model.provenance import moment

YAML_SUFFIXES = ('.yaml', '.yml')


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return (path / 'metadata.yaml').is_file() or any(map(is_storage, path.iterdir()))
    return is_storage(path) or path.suffix == '.bag'


def _explain_bag(path: Path) -> Explained:
    reading = BagReading(path)
    rows = [('topic', f'{name}, {kind}') for name, kind in sorted(reading.topics.items())]
    facts: dict[str, object] = {'topics': dict(reading.topics)}
    if POINT.name in reading.topics:
        stamps = reading.received().stamp_ns
        seconds = 1e-9 * float(stamps.max() - stamps.min()) if len(stamps) else 0.0
        first = moment(int(stamps.min())) if len(stamps) else None
        rows.append(('samples', f'{len(stamps)} over {seconds:.1f} s'))
        rows += [('first', first)] if first else []
        facts |= {'samples': len(stamps), 'duration_s': seconds, 'first_stamp': first}
    if PATH.name in reading.topics:
        path_driven = path_of(str(path), [reading])
        points = len(path_driven.points)
        rows.append(('path', f'{points} corner points, {path_driven.length:.2f} m'))
        facts |= {'path_points': points, 'path_length': path_driven.length}
    rows += [('INCOMPLETE', text) for text in reading.remarks]
    rows.append(('usable?', 'otf check says it'))
    return Explained(tuple(rows), facts)


BAG = Kind(
    'recording', 'samples of a tracker; check, calibrate, diagnose read it', _is_bag, _explain_bag
)


def _is_table(path: Path) -> bool:
    if not is_text(path):
        return False
    try:
        return bool(find_columns(read_table(path), None).point)
    except OtfError:
        return False


def _explain_table(path: Path) -> Explained:
    table = read_table(path)
    reading = TextReading(path, rate=None if find_columns(table, None).time else 1.0)
    raw = reading.received()
    rows = [('read as', text) for text in reading.said]
    low, high = raw.xyz.min(axis=0), raw.xyz.max(axis=0)
    rows += [(axis, f'{a:.4f} to {b:.4f} m') for axis, a, b in zip('xyz', low, high, strict=True)]
    facts = {'samples': len(raw.xyz), 'lower': low.tolist(), 'upper': high.tolist()}
    return Explained(tuple(rows), facts)


TABLE = Kind(
    'table of samples',
    'points of a tracker as text; check, calibrate, diagnose read it with --path',
    _is_table,
    _explain_table,
)


def _explain_direct(path: Path) -> Explained:
    with path.open(encoding='utf-8-sig', newline='') as file:
        lines = [line for line in file if line.strip() and not line.startswith('#')]
    table = list(csv.DictReader(lines))
    counts = Counter(row['axis'] for row in table)
    columns = [name for name in table[0] if name] if table else []
    rows = (
        ('readings', ', '.join(f'{n} along {axis}' for axis, n in counts.items()) or 'none'),
        ('columns', ', '.join(columns)),
    )
    return Explained(rows, {'readings': dict(counts), 'columns': columns})


def _explain_points(path: Path) -> Explained:
    points = read_points(path)[0]
    low, high = points.min(axis=0), points.max(axis=0)
    rows = [('points', str(len(points)))]
    ends = zip('xyz', low, high, strict=True)
    rows += [(axis, f'{1e3 * a:g} to {1e3 * b:g} mm') for axis, a, b in ends]
    facts = {'points': len(points), 'lower': low.tolist(), 'upper': high.tolist()}
    return Explained(tuple(rows), facts)


DIRECT = Kind(
    'direct measurement',
    'readings of an instrument along single axes; otf compare reads it',
    lambda path: path.suffix.lower() == '.csv' and begins(path, 'axis,run,direction,'),
    _explain_direct,
)
POINTS = Kind(
    'points',
    'positions x,y,z in m; otf predict, plan --path and simulate --path read it',
    lambda path: path.suffix.lower() == '.csv' and begins(path, 'x,y,z'),
    _explain_points,
)


def _explain_program(path: Path) -> Explained:
    program = read_program(path)
    points = program.points
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    low, high = points.min(axis=0), points.max(axis=0)
    rows = [
        ('read as', program.said),
        ('path', f'{len(points)} corner points, {length:.2f} m'),
    ]
    ends = zip('XYZ', low, high, strict=True)
    rows += [(axis, f'{1e3 * a:g} to {1e3 * b:g} mm') for axis, a, b in ends]
    facts = {
        'form': program.form, 'path_points': len(points), 'path_length': length,
        'lines': program.lines, 'arcs': program.arcs, 'positions_in': list(program.frames),
        'lower': low.tolist(), 'upper': high.tolist(),
    }  # fmt: skip
    return Explained(tuple(rows), facts)


PROGRAM = Kind(
    'NC program',
    'a path; check, calibrate, diagnose, plan, simulate read it with --path',
    is_program,
    _explain_program,
)


def _is_yaml_of(path: Path, kind: type) -> bool:
    if path.suffix.lower() not in YAML_SUFFIXES or not path.is_file():
        return False
    try:
        return isinstance(read_yaml(path), kind)
    except ConfigError:
        return kind is dict  # whoever reads it as machine.yaml says what is wrong


def _explain_machine(path: Path) -> Explained:
    machine = load_machine(path)
    level = 1e6 * machine.tracker.u_range, 1e6 * machine.tracker.u_angle
    rows = [('machine', f'{machine.name}, chain {machine.chain}')]
    for name in machine.axis_names:
        axis = machine.axes[name]
        rows.append((
            f'axis {name}', f'{1e3 * axis.min:g} to {1e3 * axis.max:g} mm, a node every '
            f'{1e3 * axis.table_pitch:g} mm',
        ))  # fmt: skip
    offset = ', '.join(f'{1e3 * v:g}' for v in machine.target_offset)
    rows += [
        ('target', f'offset ({offset}) mm'),
        ('tracker', f'{level[0]:g} um along, {level[1]:g} urad across the beam'),
        ('uncertainty', 'declared' if machine.uncertainty else
         'nothing declared but the noise of the tracker: u will be too small'),
    ]  # fmt: skip
    return Explained(tuple(rows), machine.to_dict())


def _explain_effects(path: Path) -> Explained:
    data = read_yaml(path)
    rows = []
    for entry in data:
        named = entry if isinstance(entry, dict) else {}
        values = named.get('parameters') or {}
        shown = ', '.join(f'{k} = {v}' for k, v in values.items())
        rows.append((str(named.get('effect', '?')), shown or 'no parameters'))
    return Explained(tuple(rows), {'effects': data})


MACHINE = Kind(
    'machine description',
    'axes, chain, target and tracker of a machine; every verb with --machine reads it',
    lambda path: _is_yaml_of(path, dict),
    _explain_machine,
)
EFFECTS = Kind(
    'effects',
    'effects with their parameters; otf simulate --effects and calibrate --effects read it',
    lambda path: _is_yaml_of(path, list),
    _explain_effects,
)


KINDS: tuple[Kind, ...] = (
    BAG,
    FOLDER,
    EXPORT,
    *JSON_KINDS,
    OTHER,
    EFFECTS,
    MACHINE,
    RESIDUALS,
    DIRECT,
    POINTS,
    PROGRAM,
    TABLE,
)
"""The first that fits counts."""


def explain(name: str | Path) -> tuple[Kind, Explained]:
    """Say what a file is and says.

    Raises
    ------
    ConfigError
        If it cannot be read or is of no kind that otf knows.
    InputError
        If it is a bag that cannot be read.
    """
    path = Path(name)
    try:
        path.stat()
    except OSError as error:
        raise unreadable(path, error) from None
    for kind in KINDS:
        if kind.is_one(path):
            return kind, kind.explain(path)
    known = ', '.join(kind.name for kind in KINDS)
    raise ConfigError(f'{path}: is nothing that otf writes or reads; known: {known}')
