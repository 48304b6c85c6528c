# SPDX-License-Identifier: Apache-2.0
"""manifest.json (``otf-manifest/1``): which files of a folder this program wrote, by their hash.

A file that is not listed, or was changed since, is somebody else's and is never deleted. A folder
inside may have a manifest of its own. ``missing`` names files that did not fit on the disk.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from otf_core.files.writing import write_text
from otf_core.version import __version__

MANIFEST = 'manifest.json'
SCHEMA = 'otf-manifest/1'


def file_digest(path: str | Path) -> str:
    """SHA-256 of the bytes of a file, as sha256sum prints it."""
    digest = hashlib.sha256()
    with open(path, 'rb') as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def write_manifest(
    manifest: Path, files: Iterable[Path], verb: str, missing: Mapping[str, str] | None = None
) -> None:
    """List files that lie in the folder of the manifest or below it, and what is missing there."""
    folder = manifest.parent
    entries = {f.relative_to(folder).as_posix(): file_digest(f) for f in sorted(files)}
    data = {'schema': SCHEMA, 'verb': verb, 'version': __version__, 'sha256': entries}
    if missing:
        data['missing'] = dict(missing)
    write_text(manifest, json.dumps(data, indent=1) + '\n')


def listed(manifest: Path) -> dict[Path, str]:
    """Files that a manifest lists, with their hashes; empty if there is none or it is damaged."""
    try:
        data: Any = json.loads(manifest.read_text(encoding='utf-8'))
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(data, dict) or data.get('schema') != SCHEMA:
        return {}
    entries = data.get('sha256')
    if not isinstance(entries, dict):
        return {}
    return {manifest.parent / name: str(digest) for name, digest in entries.items()}


def is_as_listed(path: Path, entries: dict[Path, str]) -> bool:
    """Tell whether a file is listed and still what it was then."""
    return path in entries and path.is_file() and file_digest(path) == entries[path]


def written_files(folder: Path) -> list[Path]:
    """All files and links below a folder, manifests left out."""
    found = (p for p in folder.rglob('*') if p.is_symlink() or not p.is_dir())
    return sorted(p for p in found if p.name != MANIFEST)


def foreign(folder: Path) -> list[Path]:
    """Files below a folder that no manifest in it lists as they are."""
    entries: dict[Path, str] = {}
    for manifest in folder.rglob(MANIFEST):
        entries |= listed(manifest)
    strange = [m for m in folder.rglob(MANIFEST) if not listed(m)]
    return strange + [
        p for p in written_files(folder) if p.is_symlink() or not is_as_listed(p, entries)
    ]
