# SPDX-License-Identifier: Apache-2.0
"""Tables of a blind trial in docs/blind-trial.md and docs/diagnosis.md, as commands wrote them.

``python3 tools/blind_table.py TRIAL LEAVE_ONE_OUT`` takes the folders of ``./otf blind`` with and
without ``--leave-one-out`` and puts their tables between the marks, and the reliability diagram
of the first into docs/images.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / 'docs'
PAGES = {DOCS / 'blind-trial.md': 'table.md', DOCS / 'diagnosis.md': 'particulars.md'}
DIAGRAM, IMAGES = 'reliability.svg', DOCS / 'images'
MARKS = ('blind trial', 'leave one out')


def begin(name: str) -> str:
    """Mark before a table."""
    return f'<!-- {name}: put here by python3 tools/blind_table.py -->'


def end(name: str) -> str:
    """Mark after it."""
    return f'<!-- end of {name} -->'


def with_table(text: str, name: str, table: str) -> str:
    """Return a text with a table between its marks."""
    head, _, rest = text.partition(begin(name))
    _, found, tail = rest.partition(end(name))
    if not found:
        raise SystemExit(f'the marks {begin(name)} and {end(name)} are missing')
    return f'{head}{begin(name)}\n\n{table.strip()}\n\n{end(name)}{tail}'


def main(folders: list[str]) -> None:
    """Write both pages."""
    if len(folders) != len(MARKS):
        raise SystemExit('usage: python3 tools/blind_table.py TRIAL LEAVE_ONE_OUT')
    for page, file in PAGES.items():
        text = page.read_text(encoding='utf-8')
        for name, folder in zip(MARKS, folders, strict=True):
            text = with_table(text, name, (Path(folder) / file).read_text(encoding='utf-8'))
        page.write_text(text, encoding='utf-8')
    shutil.copyfile(Path(folders[0]) / DIAGRAM, IMAGES / DIAGRAM)


if __name__ == '__main__':
    main(sys.argv[1:])
