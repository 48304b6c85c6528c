# SPDX-License-Identifier: Apache-2.0
"""Table of presets in docs/uncertainty.md, from the presets of the software.

``python3 tools/preset_table.py`` puts it between the marks; a test compares.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / 'docs' / 'uncertainty.md'
BEGIN = '<!-- presets: made by python3 tools/preset_table.py -->'
END = '<!-- end of presets -->'


def with_table(text: str) -> str:
    """Return a text with the table between the marks."""
    folder = str(ROOT / 'src' / 'otf_core')
    if folder not in sys.path:
        sys.path.append(folder)
    from otf_core.model.presets import preset_table

    head, _, rest = text.partition(BEGIN)
    _, found, tail = rest.partition(END)
    if not found:
        raise SystemExit(f'the marks {BEGIN} and {END} are missing')
    return f'{head}{BEGIN}\n\n{preset_table()}\n\n{END}{tail}'


if __name__ == '__main__':
    PAGE.write_text(with_table(PAGE.read_text(encoding='utf-8')), encoding='utf-8')
