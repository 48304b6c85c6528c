# SPDX-License-Identifier: Apache-2.0
"""A path from a file: plan.json of otf plan, or corner points as text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.inputs.plan_json import looks_like_json, read_plan
from otf_core.inputs.points_file import read_points

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
    return read_points(name)[0]
