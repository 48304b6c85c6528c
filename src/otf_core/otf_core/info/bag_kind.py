# SPDX-License-Identifier: Apache-2.0
"""Recordings."""

from __future__ import annotations

from pathlib import Path

from otf_core.bags.bag_reading import BagReading, path_of
from otf_core.bags.bag_source import is_storage
from otf_core.bags.topics import PATH, POINT
from otf_core.errors import OtfError
from otf_core.info.kind import Explained, Kind
from otf_core.inputs.columns import find_columns, read_table
from otf_core.inputs.text_points import TextReading, is_text
from otf_core.model.provenance import moment


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return (path / 'metadata.yaml').is_file() or any(map(is_storage, path.iterdir()))
    return is_storage(path) or path.suffix == '.bag'


def _explain(path: Path) -> Explained:
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
    'recording', 'samples of a tracker; check, calibrate, diagnose read it', _is_bag, _explain
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
