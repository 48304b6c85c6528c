# SPDX-License-Identifier: Apache-2.0
"""The table of a blind trial in docs/blind-trial.md, as commands wrote it.

``python3 tools/blind_table.py TRIAL [FIVE_AXES] LEAVE_ONE_OUT`` takes the folders of
``./otf blind`` without an option, with ``--five-axes`` and with ``--leave-one-out``, puts their
rows between the marks as one table, and the reliability diagram of the first into docs/images.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE, TABLE = ROOT / 'docs/blind-trial.md', 'table.md'
DIAGRAM, IMAGES = 'reliability.svg', ROOT / 'docs/images'
BEGIN = '<!-- blind trial: put here by python3 tools/blind_table.py -->'
END = '<!-- end of blind trial -->'


def with_table(text: str, table: str) -> str:
    """Return a text with a table between the marks."""
    head, _, rest = text.partition(BEGIN)
    _, found, tail = rest.partition(END)
    if not found:
        raise SystemExit(f'the marks {BEGIN} and {END} are missing')
    return f'{head}{BEGIN}\n\n{table.strip()}\n\n{END}{tail}'


def joined(*tables: str) -> str:
    """One table of several: commands, conditions, rows, and what follows each."""
    every = [text.strip().split('\n\n') for text in tables]
    head = [part for one in every for part in one[:2]]
    rows = [every[0][2], *(one[2].split('\n', 2)[2] for one in every[1:])]
    return '\n\n'.join([*head, '\n'.join(rows), *(part for one in every for part in one[3:])])


def main(folders: list[str]) -> None:
    """Write the page."""
    if len(folders) not in (2, 3):
        raise SystemExit('usage: python3 tools/blind_table.py TRIAL [FIVE_AXES] LEAVE_ONE_OUT')
    tables = [(Path(f) / TABLE).read_text(encoding='utf-8') for f in folders]
    text = with_table(PAGE.read_text(encoding='utf-8'), joined(*tables))
    PAGE.write_text(text, encoding='utf-8')
    shutil.copyfile(Path(folders[0]) / DIAGRAM, IMAGES / DIAGRAM)


if __name__ == '__main__':
    main(sys.argv[1:])
