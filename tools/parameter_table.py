# SPDX-License-Identifier: Apache-2.0
"""Parameter tables of docs/parameters.md, from the fields that declare the parameters of nodes.

``python3 tools/parameter_table.py`` puts them between the marks; a test compares.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / 'docs' / 'parameters.md'
BEGIN = '<!-- parameters: made by python3 tools/parameter_table.py -->'
END = '<!-- end of parameters -->'
FOLDERS = (
    'otf_core',
    'otf_bringup',
    'otf_calibrator',
    'otf_ros',
    'otf_path_planner',
    'otf_compensator',
    'otf_tracker_driver',
    'otf_view',
)


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


def rows(infos: Any) -> Iterator[str]:
    """Yield the lines of one table of parameters."""
    yield '| parameter | default | unit | range | meaning |'
    yield '|---|---|---|---|---|'
    for info in infos:
        cells = (f'`{info.name}`', _shown(info.default), info.unit, _range(info), info.meaning)
        yield '| ' + ' | '.join(cell.replace('|', '\\|') for cell in cells) + ' |'


def tables() -> str:
    """Return the tables of all nodes, and of what only the command line knows."""
    for name in FOLDERS:
        folder = str(ROOT / 'src' / name)
        if folder not in sys.path:
            sys.path.append(folder)
    from otf_bringup.params_file import NODES, infos
    from otf_core.config import (
        DiagnosisConfig,
        ForecastConfig,
        ReadingConfig,
        SimulationConfig,
        WritingConfig,
    )

    shown = {f'`{node}`': infos(node) for node in NODES}
    shown['`--config`: reading a bag'] = ReadingConfig.infos()
    shown['`--config` of `calibrate`: files'] = WritingConfig.infos()
    shown['`--config` of `diagnose`'] = DiagnosisConfig.infos()
    shown['`--config` of `plan`: forecast'] = ForecastConfig.infos()
    shown['`--config` of `simulate`'] = SimulationConfig.infos()
    parts: list[str] = []
    for title, its_infos in shown.items():
        parts += [f'**{title}**', '', *rows(its_infos), '']
    return '\n'.join(parts).strip()


def with_tables(text: str) -> str:
    """Return a text with the tables between the marks."""
    head, _, rest = text.partition(BEGIN)
    _, found, tail = rest.partition(END)
    if not found:
        raise SystemExit(f'the marks {BEGIN} and {END} are missing')
    return f'{head}{BEGIN}\n\n{tables()}\n\n{END}{tail}'


if __name__ == '__main__':
    PAGE.write_text(with_tables(PAGE.read_text(encoding='utf-8')), encoding='utf-8')
