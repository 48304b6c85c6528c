# SPDX-License-Identifier: Apache-2.0
"""docs/schema.md: the fields of every result file, from the dataclasses that read and write them.

``python3 tools/schema_page.py`` writes it; a test compares.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / 'docs' / 'schema.md'
WIDTH = 130
DOCUMENTS = (
    ('prediction.calibration_document', 'CalibrationDocument'),
    ('diagnosis.document', 'GapDocument'),
    ('planning.document', 'PlanDocument'),
    ('noise.report', 'NoiseReport'),
    ('comparison.document', 'ComparisonDocument'),
    ('history.document', 'HistoryDocument'),
    ('fleet.document', 'FleetDocument'),
    ('checking.checks', 'CheckReport'),
    ('sim.bag_files', 'SimulationDocument'),
)
INTRODUCTION = """<!-- made by python3 tools/schema_page.py -->
# Fields of the result files

Each result is one JSON object. SI units; `u` is a standard uncertainty (k = 1) with everything
that is stated, `u_run` that of noise and misfit of the run alone. Each entry is an object with its
fields: name, type, unit, meaning. `[]` stands for the entries of a list, `NAME` for the names of a
mapping; a type with `?` may be `null`: not known. Readers ignore further fields.
"""


def listed(rows: Iterable[tuple[str, str, str, str]]) -> Iterator[str]:
    """Yield the lines of a list: an entry for every object, with its fields."""
    heads, fields = {}, {}
    for path, kind, unit, meaning in rows:
        place, _, name = path.rpartition('.')
        if kind.endswith('object'):
            heads[path] = f' {meaning}'
        else:
            known = kind.removeprefix('or null, ') + ('?' if kind.startswith('or null') else '')
            facts = f'{known}, {unit}' if unit else known
            fields.setdefault(place, []).append(f'`{name}` ({facts}) {meaning}')
    for place in dict.fromkeys([*fields, *heads]):
        head = f'**`{place}`**{heads.get(place, "")}' if place else '**at the top**'
        text = '; '.join(fields.get(place, ()))
        yield from textwrap.wrap(
            f'- {head}: {text}' if text else f'- {head}', WIDTH, subsequent_indent='  ',
            break_long_words=False, break_on_hyphens=False,
        )  # fmt: skip


def schema_page() -> str:
    """The page in Markdown."""
    folder = str(ROOT / 'src' / 'otf_core')
    if folder not in sys.path:
        sys.path.append(folder)
    from otf_core.documents import schema_rows
    from otf_core.files.message_text import with_micro_sign

    parts = [INTRODUCTION]
    for module, name in DOCUMENTS:
        document = getattr(import_module(f'otf_core.{module}'), name)
        file = document.file or 'otf check --json'
        first, *_ = (document.__doc__ or '').partition('\n')
        parts.append('\n'.join([f'## {file}', '', first, '', *listed(schema_rows(document)), '']))
    return with_micro_sign('\n'.join(parts))


if __name__ == '__main__':
    PAGE.write_text(schema_page(), encoding='utf-8')
