# SPDX-License-Identifier: Apache-2.0
"""A path from a file: plan.json of otf plan, the NC program that was driven, or corner points."""

from __future__ import annotations

from pathlib import Path

from otf_core.arrays import Array
from otf_core.inputs.nc_program import is_program, read_program
from otf_core.inputs.plan_json import looks_like_json, read_plan
from otf_core.inputs.points_file import read_points


def read_path(name: str | Path) -> tuple[Array, str]:
    """Corner points of a path, shape (n, 3), m, and what the file was read as.

    A text of points holds x, y, z in m, or in the unit that its head states. The words are empty
    for a plan and for a plain CSV.

    Raises
    ------
    ConfigError
        If the file cannot be read, is no plan, holds a line that is no point, or is an NC program
        that drives otherwise than along lines and arcs of X, Y, Z.
    InputError
        If the text holds no points.
    """
    if looks_like_json(name):
        return read_plan(name).plan.path.points, ''
    if is_program(name):
        program = read_program(name)
        return program.points, f'{name}: {program.said}'
    return read_points(name)
