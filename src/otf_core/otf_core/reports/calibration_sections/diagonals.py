# SPDX-License-Identifier: Apache-2.0
"""Body and face diagonals as the tables predict them, after the fashion of ISO 230-6.

Deviation at a point of a diagonal: the part of the error vector along the diagonal, less that at
its start. No rigid motion changes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from otf_core.model.expanded import figure, significant
from otf_core.model.frames import XYZ
from otf_core.prediction.volumetric import table_rows, table_values
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.section import Section, Table

Array = NDArray[np.float64]

POINTS = 21


@dataclass(frozen=True)
class Diagonal:
    """A diagonal from a to b, shape (3,), m."""

    kind: str
    name: str
    a: Array
    b: Array


def diagonals(low: Array, high: Array) -> list[Diagonal]:
    """Four body diagonals and six face diagonals, two in the middle plane of each pair of axes."""
    found = []
    for y, z in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        sign = np.array([1, y, z])
        ends = np.where(sign > 0, low, high), np.where(sign > 0, high, low)
        found.append(Diagonal('body', _name(sign), *ends))
    for one, two in combinations(range(3), 2):
        for turn in (1, -1):
            sign = np.zeros(3, dtype=int)
            sign[one], sign[two] = 1, turn
            middle = 0.5 * (low + high)
            a = np.where(sign > 0, low, np.where(sign < 0, high, middle))
            b = np.where(sign > 0, high, np.where(sign < 0, low, middle))
            found.append(Diagonal('face', _name(sign), a, b))
    return found


def _name(sign: NDArray[np.int64]) -> str:
    marks = {1: '+', -1: '\N{MINUS SIGN}'}
    return ' '.join(f'{marks[int(s)]}{axis}' for s, axis in zip(sign, XYZ, strict=True) if s)


def deviations(facts: Facts, one: Diagonal) -> tuple[Array, Array]:
    """Deviation along a diagonal and its standard uncertainty, shape (POINTS,), m."""
    q = one.a + np.linspace(0.0, 1.0, POINTS)[:, None] * (one.b - one.a)
    unit = (one.b - one.a) / np.linalg.norm(one.b - one.a)
    rows = np.einsum('k,nkm->nm', unit, table_rows(facts.tables, q))
    rows = rows - rows[:1]
    variance = np.einsum('nm,nm->n', rows @ facts.result.covariance, rows)
    return rows @ table_values(facts.tables), np.sqrt(np.maximum(variance, 0.0))


def section(facts: Facts) -> Section:
    """Return the section."""
    rows, data, k = [], [], facts.k_volume
    for one in diagonals(facts.machine.lower, facts.machine.upper):
        value, u = deviations(facts, one)
        span, wide = float(np.ptp(value)), k * float(u[-1])
        length = float(np.linalg.norm(one.b - one.a))
        end, u_end = 1e6 * float(value[-1]), 1e6 * wide
        rows.append((one.kind, one.name, f'{1e3 * length:.0f}', figure(1e6 * span, u_end),
                     figure(end, u_end), significant(u_end)))  # fmt: skip
        data.append({'kind': one.kind, 'direction': one.name, 'length': length, 'span': span,
                     'end': float(value[-1]), 'U_end': wide})  # fmt: skip
    words = (
        'Predicted from the error tables, not measured along the diagonals: deviation along each '
        'diagonal from its start. Face diagonals lie in the middle planes of the volume.',
    )
    head = (
        'Predicted',
        'Direction',
        'Length (mm)',
        'Span (um)',
        'At the end (um)',
        'U, 95 % (um)',
    )
    table = Table(head, tuple(rows), numbers=(2, 3, 4, 5))
    return Section('diagonals', 'Diagonals, predicted', words, {'predicted': data}, (table,))
