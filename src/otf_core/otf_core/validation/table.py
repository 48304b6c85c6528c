# SPDX-License-Identifier: Apache-2.0
"""The table of a validation: quantity, paper, ours with its interval over the cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import t as student

CONFIDENCE = 0.95
NOTE = (
    'Ours: simulated cells; tracker noise 0.5 um along the beam and 2 urad across, half of the\n'
    'variance correlated over 0.3 s. The direct instrument is simulated too. In 2.2 and 2.3 the\n'
    'paper measured a real machine, with backlash and other effects that these cells lack.'
)


@dataclass(frozen=True)
class Row:
    """One quantity.

    Attributes
    ----------
    section : str
        Of the paper.
    quantity, paper, unit : str
        ``paper`` is what the paper states, in its words; empty if it states nothing.
    values : tuple of float
        One a cell, in ``unit``.
    limit : tuple of float, or None
        Lowest and highest mean that passes; -inf for no lowest one.
    """

    section: str
    quantity: str
    paper: str
    unit: str
    values: tuple[float, ...]
    limit: tuple[float, float] | None = None

    @property
    def mean(self) -> float:
        """Mean over the cells."""
        return float(np.mean(self.values))

    @property
    def half_width(self) -> float:
        """Half the 95 % interval of the mean; nan for a single cell."""
        n = len(self.values)
        if n < 2:
            return float('nan')
        spread = np.std(self.values, ddof=1) / np.sqrt(n)
        return float(student.ppf(0.5 + CONFIDENCE / 2, n - 1) * spread)

    @property
    def passed(self) -> bool | None:
        """Whether the mean lies within the limit; None without one."""
        return None if self.limit is None else self.limit[0] <= self.mean <= self.limit[1]


def rows_to_dict(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the rows as plain data."""
    return [
        {
            'section': r.section,
            'quantity': r.quantity,
            'paper': r.paper,
            'unit': r.unit,
            'mean': r.mean,
            'half_width_95': None if np.isnan(r.half_width) else r.half_width,
            'values': list(r.values),
            'limit': [v if np.isfinite(v) else None for v in r.limit] if r.limit else None,
            'passed': r.passed,
        }
        for r in rows
    ]


def rows_from_dict(data: Sequence[Mapping[str, Any]]) -> tuple[Row, ...]:
    """Return the rows of a validation.json."""
    rows = []
    for entry in data:
        low, high = entry['limit'] or (None, None)
        limit = (-np.inf if low is None else low, np.inf if high is None else high)
        words = {name: str(entry[name]) for name in ('section', 'quantity', 'paper', 'unit')}
        values = tuple(entry['values'])
        rows.append(Row(**words, values=values, limit=limit if entry['limit'] else None))
    return tuple(rows)


def side_by_side(tables: Sequence[Sequence[Row]]) -> tuple[Row, ...]:
    """Return one table of the cells of several.

    Raises
    ------
    ValueError
        If they do not have the same rows.
    """
    rows = []
    for same in zip(*tables, strict=True):
        if len({(r.section, r.quantity, r.unit) for r in same}) != 1:
            raise ValueError(f'rows of different quantities: {[r.quantity for r in same]}')
        rows.append(replace(same[0], values=tuple(v for r in same for v in r.values)))
    return tuple(rows)


def _digits(value: float) -> str:
    if abs(value) >= 1000:
        return f'{value:.0f}'
    return f'{value:.3g}' if abs(value) >= 1 else f'{value:.2f}'


def format_rows(rows: Sequence[Row]) -> str:
    """Return the table as text: of every quantity the mean and the range over the cells."""
    width = max(len(r.quantity) for r in rows) + 2
    paper = max(len(r.paper) for r in rows) + 2
    lines = [f'{"":<6}{"quantity":<{width}}{"paper":<{paper}}ours: mean (smallest to largest)']
    for r in rows:
        low, high = min(r.values), max(r.values)
        constant = high - low <= 1e-9 * abs(r.mean)
        interval = '' if constant else f' ({_digits(low)} to {_digits(high)})'
        verdict = {None: '', True: '  ok', False: '  NOT REACHED'}[r.passed]
        ours = f'{_digits(r.mean)}{interval} {r.unit}'.rstrip()
        lines.append(f'{r.section:<6}{r.quantity:<{width}}{r.paper:<{paper}}{ours}{verdict}')
    return '\n'.join([*lines, '', NOTE])
