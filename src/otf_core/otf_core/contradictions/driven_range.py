# SPDX-License-Identifier: Apache-2.0
"""A driven range far below the one that machine.yaml declares."""

from __future__ import annotations

from otf_core.contradictions.quick_model import Model
from otf_core.pieces.finding import WARNING, Finding

LEAST = 0.8
"""Share of the range of an axis that is to be driven."""


def check_driven_range(model: Model) -> list[Finding]:
    """Say which axes were driven over a part of their range only."""
    machine, q = model.rows.machine, model.rows.q
    low, high = q.min(axis=0), q.max(axis=0)
    size = machine.upper - machine.lower
    short = [k for k in range(3) if high[k] - low[k] < LEAST * size[k]]
    if not short:
        return []
    parts = ', '.join(
        f'{machine.axis_names[k]} over {1e3 * (high[k] - low[k]):.0f} of {1e3 * size[k]:.0f} mm '
        f'({100 * (high[k] - low[k]) / size[k]:.0f} %, {1e3 * low[k]:.0f} to '
        f'{1e3 * high[k]:.0f} mm)'
        for k in short
    )
    return [Finding('driven range', WARNING, (
        f'only part of the range was driven: {parts}; the tables end there, and beyond them '
        f'nothing is known: drive the whole range, or state the range in use in machine.yaml'
    ))]  # fmt: skip
