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


def preset_table() -> str:
    """Presets as tables in Markdown."""
    folder = str(ROOT / 'src' / 'otf_core')
    if folder not in sys.path:
        sys.path.append(folder)
    from otf_core.files.message_text import with_micro_sign
    from otf_core.model.presets import TRACKERS, WORKSHOPS

    parts = []
    for section, presets in (('tracker', TRACKERS), ('uncertainty', WORKSHOPS)):
        listed = list(presets.values())
        rows = [
            [f'`{section}: preset:`', *(f'`{name}`' for name in presets)],
            ['---'] * (1 + len(presets)),
            ['what', *(p.what for p in listed)],
            *([f'`{k}`', *(f'{p.values[k]:.3g}' for p in listed)] for k in listed[0].values),
            ['from', *('; '.join(p.sources) for p in listed)],
        ]
        parts.append('\n'.join(f'| {" | ".join(row)} |' for row in rows))
    return with_micro_sign('\n\n'.join(parts))


def with_table(text: str) -> str:
    """Return a text with the table between the marks."""
    head, _, rest = text.partition(BEGIN)
    _, found, tail = rest.partition(END)
    if not found:
        raise SystemExit(f'the marks {BEGIN} and {END} are missing')
    return f'{head}{BEGIN}\n\n{preset_table()}\n\n{END}{tail}'


if __name__ == '__main__':
    PAGE.write_text(with_table(PAGE.read_text(encoding='utf-8')), encoding='utf-8')
