# SPDX-License-Identifier: Apache-2.0
"""Files that ``otf export`` wrote for a control or another program, of whatever format."""

from __future__ import annotations

import re
from pathlib import Path

from otf_core.exports.base import MARK, NEAR, is_export
from otf_core.info.kind import Explained, Kind

HEAD = re.compile(
    MARK + r' (?P<format>[\w-]+): machine (?P<machine>.*), chain (?P<chain>\S+), run (?P<run>\S+)'
)
LINES = {
    'measured at the target offset ': 'target offset',
    'sign: ': 'sign',
    'values: ': 'values',
    'not in this file: ': 'not in it',
    'zero because the calibration does not show them: ': 'not seen',
}
"""Beginnings of the further lines of a head, and what they are about."""


def _is_one(path: Path) -> bool:
    return path.is_file() and is_export(path)


def _explain(path: Path) -> Explained:
    content = path.read_bytes()
    both = content if len(content) <= 2 * NEAR else content[:NEAR] + b'\n' + content[-NEAR:]
    text = both.decode('utf-8', errors='replace')
    found = HEAD.search(text)
    if found is None:
        return Explained((('export', 'its head has been changed: format and run are not known'),))
    facts = found.groupdict()
    rows = [
        ('export', f'format {facts["format"]}'),
        ('machine', f'{facts["machine"]}, chain {facts["chain"]}'),
        ('run', f'{facts["run"]}: run_id of the error_tables.json it comes from'),
    ]
    for line in text[found.end() :].splitlines():
        said = line.lstrip(' #;/<!-').removesuffix('-->').strip()
        for start, name in LINES.items():
            if said.startswith(start) and name not in dict(rows):
                rows.append((name, said.removeprefix(start)))
    return Explained(tuple(rows), facts)


EXPORT = Kind(
    'export',
    'error tables in the format of a control or another program, written by otf export',
    _is_one,
    _explain,
)
