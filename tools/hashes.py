# SPDX-License-Identifier: Apache-2.0
"""Hashes of the archives that are installed: a file of a known name has to have its content.

``requirements/hashes.txt`` lists archives by name with their SHA-256, as they were when they were
pinned. pip's own --require-hashes refuses every archive that is not listed, so that a processor or
a Python that nobody has pinned for could not set anything up; here such archives are counted.

Usage: python3 tools/hashes.py REPORT.json ...    adds what pip install --report has written
"""

from __future__ import annotations

import json
import sys
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

LIST = Path(__file__).resolve().parents[1] / 'requirements' / 'hashes.txt'
HEAD = (
    '# SHA-256 of the archives of constraints.txt; written by tools/hashes.py, read by set-up.\n'
)


def known() -> dict[str, str]:
    """SHA-256 by the name of the archive."""
    lines = LIST.read_text().splitlines() if LIST.is_file() else []
    pairs = (line.split() for line in lines if line and not line.startswith('#'))
    return {name: sha256 for sha256, name in pairs}


def archives(report: Path) -> dict[str, str]:
    """What a report of pip install says that it has taken: SHA-256 by the name of the archive."""
    found = {}
    for item in json.loads(report.read_text())['install']:
        source = item['download_info']
        name = PurePosixPath(unquote(urlsplit(source['url']).path)).name
        kind, _, value = source.get('archive_info', {}).get('hash', '').partition('=')
        if kind == 'sha256':
            found[name] = value
    return found


def changed(report: Path) -> list[str]:
    """Names of archives that have another content than the one they were pinned with."""
    pinned = known()
    return [
        name for name, sha256 in archives(report).items() if pinned.get(name, sha256) != sha256
    ]


def unlisted(report: Path) -> list[str]:
    """Names of archives that no hash is known of."""
    return sorted(archives(report).keys() - known().keys())


def main() -> int:
    """Add the archives of reports to the list."""
    both = known()
    for report in sys.argv[1:]:
        both.update(archives(Path(report)))
    lines = [f'{sha256}  {name}\n' for name, sha256 in sorted(both.items(), key=_by_name)]
    LIST.write_text(HEAD + ''.join(lines))
    return 0


def _by_name(item: tuple[str, str]) -> str:
    return item[0].lower()


if __name__ == '__main__':
    sys.exit(main())
