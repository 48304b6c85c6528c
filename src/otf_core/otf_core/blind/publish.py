# SPDX-License-Identifier: Apache-2.0
"""Fragments of Markdown for the docs; ``tools/blind_table.py`` puts them there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from otf_core.blind.seal import sealed
from otf_core.blind.table import Table, as_markdown
from otf_core.files.strict_yaml import read_json
from otf_core.fleet.fleet import STATE

TABLE, PARTICULARS, DIAGRAM = 'table.md', 'particulars.md', 'reliability.svg'


@dataclass(frozen=True)
class Measured:
    """Under what conditions a trial was measured.

    Attributes
    ----------
    key : str
        SHA-256 of the sealed key.
    seconds : tuple of float
        Of every diagnosis.
    """

    cells: int
    seed: int
    date: str
    key: str
    seconds: tuple[float, ...]
    leave_one_out: bool

    @classmethod
    def of(
        cls, folder: Path, entries: Sequence[Mapping[str, Any]], date: str, leave_one_out: bool
    ) -> Measured:
        """Read the conditions from the folder of a trial."""
        ended = [read_json(f)['outcome'] for f in sorted(folder.glob(f'{STATE}/answers*.json'))]
        times = tuple(float(e['seconds']) for e in ended if e['sha256'] is not None)
        return cls(len(entries), entries[0]['seed'], date, sealed(folder), times, leave_one_out)

    @property
    def command(self) -> str:
        """The command that makes the same cells again."""
        option, name = (' --leave-one-out', 'without') if self.leave_one_out else ('', 'blind')
        return f'./otf blind{option} --trials {self.cells} --seed {self.seed} --out {name}'


def fragment(measured: Measured, tables: Sequence[Table]) -> str:
    """Command, conditions and tables."""
    times = measured.seconds
    lasted = (
        f'; a diagnosis took {median(times):.0f} s, at most {max(times):.0f} s' if times else ''
    )
    said = f'Measured on {measured.date}{lasted}. SHA-256 of the key: `{measured.key[:16]}...`.'
    return '\n\n'.join([f'```\n{measured.command}\n```', said, *map(as_markdown, tables)]) + '\n'
