# SPDX-License-Identifier: Apache-2.0
"""Recordings."""

from __future__ import annotations

from pathlib import Path

from otf_core.bags.bag_reading import BagReading
from otf_core.bags.topics import PATH, POINT
from otf_core.info.kind import Explained, Kind
from otf_core.model.provenance import moment

SUFFIXES = ('.mcap', '.db3', '.bag')


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return (path / 'metadata.yaml').is_file() or any(path.glob('*.mcap'))
    return path.suffix in SUFFIXES


def _explain(path: Path) -> Explained:
    reading = BagReading(path, (POINT, PATH))
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
        path_driven = reading.path()
        points = len(path_driven.points)
        rows.append(('path', f'{points} corner points, {path_driven.length:.2f} m'))
        facts |= {'path_points': points, 'path_length': path_driven.length}
    rows.append(('usable?', 'otf check says it'))
    return Explained(tuple(rows), facts)


BAG = Kind(
    'recording', 'samples of a tracker; check, calibrate, diagnose read it', _is_bag, _explain
)
