# SPDX-License-Identifier: Apache-2.0
"""Tables that pages take from the software: presets in machine.md, parameters in graph.md.

``python3 tools/page_tables.py`` puts them between their marks; a test compares.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
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


def _shown(value: Any) -> str:
    if value == ():
        return 'empty'
    if isinstance(value, bool):
        return 'true' if value else 'false'
    return (f'`{value}`' if value else 'empty') if isinstance(value, str) else str(value)


def _range(info: Any) -> str:
    if info.choices:
        return ', '.join(f'`{c}`' for c in info.choices)
    if info.low is None and info.high is None:
        return ''
    low, high = ('' if v is None else f'{v:.10g}' for v in (info.low, info.high))
    return f'{low} to {high}'


def _parameter_rows(infos: Any) -> Iterator[str]:
    yield '| parameter | default | unit | range | meaning |'
    yield '|---|---|---|---|---|'
    for info in infos:
        cells = (f'`{info.name}`', _shown(info.default), info.unit, _range(info), info.meaning)
        yield _row(cell.replace('|', '\\|') for cell in cells)


def parameter_tables() -> str:
    """Parameters of all nodes, and of what only the command line knows."""
    from otf_bringup.params_file import NODES, infos
    from otf_core import config

    shown = {f'`{node}`': infos(node) for node in NODES}
    shown['`--config`: reading a bag'] = config.ReadingConfig.infos()
    shown['`--config` of `calibrate`: files'] = config.WritingConfig.infos()
    shown['`--config` of `diagnose`'] = config.DiagnosisConfig.infos()
    shown['`--config` of `plan`: forecast'] = config.ForecastConfig.infos()
    shown['`--config` of `simulate`'] = config.SimulationConfig.infos()
    parts: list[str] = []
    for title, its_infos in shown.items():
        parts += [f'**{title}**', '', *_parameter_rows(its_infos), '']
    return '\n'.join(parts).strip()


TABLES = {
    ROOT / 'docs/machine.md': ('presets', preset_tables),
    ROOT / 'docs/graph.md': ('parameters', parameter_tables),
}


def with_tables(page: Path) -> str:
    """Return the text of a page with its tables between the marks."""
    for folder in sorted((ROOT / 'src').iterdir()):
        if str(folder) not in sys.path:
            sys.path.append(str(folder))
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
