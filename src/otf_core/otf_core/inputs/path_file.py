# SPDX-License-Identifier: Apache-2.0
"""A path from a file: plan.json of otf plan, or corner points as text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import InputError
from otf_core.inputs.columns import LENGTHS, find_columns
from otf_core.inputs.plan_json import looks_like_json, read_plan
from otf_core.inputs.text_table import read_text_table

Array = NDArray[np.float64]


def read_path(name: str | Path) -> Array:
    """Corner points of a path, shape (n, 3), m.

    Text holds x, y, z in m, or in the unit that its head states.

    Raises
    ------
    ConfigError
        If the file cannot be read or is no plan.
    InputError
        If the text holds no points.
    """
    if looks_like_json(name):
        return read_plan(name).plan.path.points
    table = read_text_table(name)
    found = find_columns(table, None)
    texts = [[table.number(row[c.place]) for c in found.point] for row in table.rows]
    units = {c.unit for c in found.point} - {None}
    if len(units) > 1 or not units <= set(LENGTHS):
        raise InputError(f'{name}: x, y, z are in {units}; expected m or mm')
    scale = 10.0 ** LENGTHS[units.pop() or 'm'] if units else 1.0
    return np.array(texts, dtype=np.float64) * scale
