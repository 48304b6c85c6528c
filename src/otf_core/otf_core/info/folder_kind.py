# SPDX-License-Identifier: Apache-2.0
"""Folders of results."""

from __future__ import annotations

from pathlib import Path

from otf_core.files.json_file import read_json
from otf_core.files.manifest import MANIFEST, is_as_listed, listed
from otf_core.info.json_kinds import JSON_KINDS
from otf_core.info.kind import Explained, Kind


def _explain(path: Path) -> Explained:
    entries = listed(path / MANIFEST)
    verb = str(read_json(path / MANIFEST).get('verb'))
    changed = [str(f.relative_to(path)) for f in entries if not is_as_listed(f, entries)]
    names = sorted(f.name for f in entries)
    rows = [('by', f'otf {verb}'), ('files', ', '.join(names))]
    rows += [('CHANGED', f'{name}: is not as it was written') for name in changed]
    facts: dict[str, object] = {'by': verb, 'files': names, 'changed': changed}
    for file in sorted(f for f in entries if f.parent == path and f.suffix == '.json'):
        kind = next((k for k in JSON_KINDS if k.is_one(file)), None)
        if kind is not None:
            found = kind.explain(file)
            rows += [(file.name, kind.what), *((f'  {a}', b) for a, b in found.rows)]
            facts[file.name] = dict(found.facts)
    return Explained(tuple(rows), facts)


FOLDER = Kind(
    'folder of results',
    'what one command wrote, with the hash of every file',
    lambda path: path.is_dir() and bool(listed(path / MANIFEST)),
    _explain,
)
