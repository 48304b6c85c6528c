# SPDX-License-Identifier: Apache-2.0
"""Drift between start and end of a run, as the residuals show it.

In parts of the run, equal in time, the mean displacement d of all residuals r = a . d across the
path is estimated by least squares; legs are the independent units of its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.calibration.result import RunResult
from otf_core.model.frames import XYZ
from otf_core.model.path import leg_bounds
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.drawing.panel import Panel
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.quantities import listed
from otf_core.reports.section import Picture, Section, Table

Array = NDArray[np.float64]

PARTS, FEWEST = 8, 6
"""Parts of a run; legs of a part from which it is used."""
FLAT = 1e-3
"""Smallest share of the information of a direction that has to be there."""


def drift(run: RunResult) -> tuple[Array, Array, Array]:
    """Time (n,), s, mean displacement and its standard uncertainty (n, 3), m, by part."""
    bounds, pieces = leg_bounds(run.pieces.leg), run.pieces
    gram = np.array([np.einsum('cpi,cpj->ij', *[run.axes[:, a:b]] * 2) for a, b in bounds])
    right = np.array(
        [np.einsum('cpi,cp->i', run.axes[:, a:b], run.residual[:, a:b]) for a, b in bounds]
    )
    middle = np.array([pieces.time[a:b].mean() for a, b in bounds])
    edges = np.linspace(0.0, float(pieces.time.max()) + 1e-9, PARTS + 1)
    found = []
    for low, high in pairwise(edges):
        own = (middle >= low) & (middle < high)
        total = gram[own].sum(axis=0)
        strength = np.linalg.eigvalsh(total)
        if own.sum() < FEWEST or strength[0] <= FLAT * strength[-1]:
            continue
        value = np.linalg.solve(total, right[own].sum(axis=0))
        rest = right[own] - gram[own] @ value
        cover = np.linalg.inv(total)
        cover = cover @ (rest.T @ rest) @ cover * own.sum() / (own.sum() - 1)
        found.append((float(middle[own].mean()), value, np.sqrt(np.diag(cover))))
    if not found:
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
    time, value, u = (np.array(part) for part in zip(*found, strict=True))
    return time, value, u


def section(facts: Facts) -> Section:
    """Return the section."""
    rows: list[tuple[str, ...]] = []
    data, found = [], []
    for number, run in enumerate(facts.result.runs, start=1):
        time, value, u = drift(run)
        name = f'{number} {run.name}'.strip()
        if len(time) < 2:
            rows.append((name, 'too few legs', '', '', ''))
            continue
        change, wide = value[-1] - value[0], 2.0 * np.hypot(u[-1], u[0])
        parts = [f'{1e6 * c:.2f} +/- {1e6 * w:.2f}' for c, w in zip(change, wide, strict=True)]
        rows.append((name, *parts, f'{time[-1] - time[0]:.0f}'))
        found += [f'{a} in run {name}' for a, c, w in zip(XYZ, change, wide, strict=True)
                  if abs(c) > w]  # fmt: skip
        data.append({'run': run.name, 'change': change.tolist(), 'U': wide.tolist(),
                     'time': float(time[-1] - time[0])})  # fmt: skip
    said = f'Larger than U: along {listed(found)}.' if found else 'No drift beyond U.'
    words = (
        said,
        _moved(facts),
        'Change of the mean residual from the first to the last part of the run (closure of start '
        'and end), with U (k = 2). It also holds what the model lacks at the places driven then; '
        'a steady drift shows as a slope in the picture.',
    )
    head = ('Run', 'Along X (um)', 'Along Y (um)', 'Along Z (um)', 'Over (s)')
    table = Table(head, tuple(rows), numbers=(1, 2, 3, 4))
    return Section('drift', 'Drift between start and end', words, {'runs': data}, (table,),
                   draw=lambda: _pictures(facts.result.runs))  # fmt: skip


def _moved(facts: Facts) -> str:
    """Whether tracker or target moved against the machine in mid-run."""
    result = facts.result
    said = [w for w in (*result.warnings, *result.failed_gates) if w.startswith('moved: ')]
    return ' '.join(f'{w[:1].upper()}{w[1:]}.' for w in said) or (
        'Not moved: no step of tracker or target was found during a run. Steps below about 5 um, '
        'and right at start and end, would not be seen.'
    )


def _pictures(runs: Sequence[RunResult]) -> Sequence[Picture]:
    time, value, u = drift(runs[0])
    if len(time) < 2:
        return ()
    along = Scale(0.0, float(runs[0].pieces.time.max()), 'time since the first sample (s)')
    parts = []
    for k, axis in enumerate(XYZ):
        y, wide = 1e6 * value[:, k], 2e6 * u[:, k]
        scale = around(np.concatenate([y - wide, y + wide, [0.0]]), 'mean residual (µm)')
        panel = Panel(along, scale)
        kind = axis.lower()
        marks = [panel.level(0.0, 'soft'), panel.ranges(time, y - wide, y + wide, f'{kind} thin'),
                 panel.line(time, y, kind), panel.dots(time, y, kind)]  # fmt: skip
        parts.append(panel.draw(marks, f'drift along {axis}', f'along {axis}'))
    return [Picture(tuple(parts), 'Mean residual by part of the first run; strokes: U (k = 2).',
                    columns=3)]  # fmt: skip
