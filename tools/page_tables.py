# SPDX-License-Identifier: Apache-2.0
"""Tables that pages take from the software: presets in machine.md, options in commands.md.

``python3 tools/page_tables.py`` puts them between their marks; a test compares.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent


def _row(cells: Any) -> str:
    return f'| {" | ".join(cells)} |'


def preset_tables() -> str:
    """Classes of trackers and workshops."""
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
        parts.append('\n'.join(map(_row, rows)))
    return with_micro_sign('\n\n'.join(parts))


def _range(info: Any) -> str:
    known = info.low is not None and info.high is not None
    return f'{info.low:.10g} to {info.high:.10g}' if known else ''


def option_table() -> str:
    """Names in ``--config`` that are no parameters of a node; those are in params.yaml."""
    from otf_core import config

    groups = (config.ReadingConfig, config.WritingConfig, config.DiagnosisConfig)
    rows = [('name in `--config`', 'default', 'unit', 'range', 'meaning'), ['---'] * 5]
    for group in (*groups, config.ForecastConfig):
        for info in group.infos():
            default = str(info.default).lower() if info.default not in ('', ()) else ''
            rows.append((f'`{info.name}`', default, info.unit, _range(info), info.meaning))
    return '\n'.join(map(_row, rows))


TABLES = {
    ROOT / 'docs/machine.md': ('presets', preset_tables),
    ROOT / 'docs/commands.md': ('options', option_table),
}


def with_tables(page: Path) -> str:
    """Return the text of a page with its tables between the marks."""
    core = str(ROOT / 'src/otf_core')
    if core not in sys.path:
        sys.path.append(core)
    name, tables = TABLES[page]
    begin = f'<!-- {name}: made by python3 tools/page_tables.py -->'
    end = f'<!-- end of {name} -->'
    head, _, rest = page.read_text(encoding='utf-8').partition(begin)
    _, found, tail = rest.partition(end)
    if not found:
        raise SystemExit(f'{page}: the marks {begin} and {end} are missing')
    return f'{head}{begin}\n\n{tables()}\n\n{end}{tail}'


if __name__ == '__main__':
    for page in TABLES:
        page.write_text(with_tables(page), encoding='utf-8')
