# SPDX-License-Identifier: Apache-2.0
"""Finds reflectors on the table that were re-seated between two parts that name them alike.

What a solution with one place leaves of the parts is fitted with a place of its own for each. With
rows a, rotations R of the link and residuals r, weighted by the inverse covariance W of the noise,

    (A^T W A) d = A^T W r,    A = a . R
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from otf_core.arrays import Array
from otf_core.model.machine import TABLE
from otf_core.rotary.axis_solution import SolvedAxisRun
from otf_core.rotary.axis_unknowns import place_block
from otf_core.rotary.rows import AxisRun

SIGNIFICANT = 6.0
"""Standard uncertainties of a difference that count."""
LEAST = 4e-6
"""m; smaller differences do not matter beside the places of reflectors themselves."""


def find_reseated(solved: SolvedAxisRun) -> list[str]:
    """Words on targets whose place differs from part to part of a run."""
    messages = []
    for name, parts in _repeated(solved.run):
        places = {k: _own_place(solved, name, k) for k in parts}
        first = parts[0]
        for k in parts[1:]:
            step = places[k][0] - places[first][0]
            u = np.sqrt(np.diag(places[k][1] + places[first][1]))
            if np.linalg.norm(step) > LEAST and np.any(np.abs(step) > SIGNIFICANT * u):
                text = ', '.join(f'{1e6 * v:.1f}' for v in step)
                messages.append(
                    f"target '{name}': in part {k + 1} it lies {1e6 * np.linalg.norm(step):.1f} "
                    f'um from where it was in part {first + 1} ({text} um): it was re-seated or '
                    f'has moved. Name it differently in that part, in bag and machine.yaml'
                )
    return messages


def _repeated(run: AxisRun) -> Iterator[tuple[str, list[int]]]:
    """Targets on the table whose place is sought and that several parts name."""
    for name in run.free:
        if run.machine.targets[name].link != TABLE:
            continue
        parts = [k for k, p in enumerate(run.parts) if p.path.target == name]
        parts = [k for k in parts if np.any(run.pieces.part == k)]
        if len(parts) > 1:
            yield name, parts


def _own_place(solved: SolvedAxisRun, name: str, part: int) -> tuple[Array, Array]:
    """Displacement (3,), m, of a target in one part, and its covariance (3, 3)."""
    columns = solved.system.rows.fixed[place_block(name)].copy()
    columns[:, solved.run.pieces.part != part] = 0.0
    weighted = solved.whitener.weighted(columns)
    normal = np.einsum('cpi,cpj->ij', columns, weighted)
    cover = np.linalg.inv(normal + 1e-6 * np.trace(normal) * np.eye(3))
    return cover @ np.einsum('cpi,cp->i', weighted, solved.residual), cover
