# SPDX-License-Identifier: Apache-2.0
"""NC programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from otf_core.info.kind import Explained, Kind
from otf_core.inputs.nc_program import is_program, read_program


def _explain(path: Path) -> Explained:
    program = read_program(path)
    points = program.points
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    low, high = points.min(axis=0), points.max(axis=0)
    rows = [
        ('read as', program.said),
        ('path', f'{len(points)} corner points, {length:.2f} m'),
    ]
    ends = zip('XYZ', low, high, strict=True)
    rows += [(axis, f'{1e3 * a:g} to {1e3 * b:g} mm') for axis, a, b in ends]
    facts = {
        'form': program.form, 'path_points': len(points), 'path_length': length,
        'lines': program.lines, 'arcs': program.arcs, 'positions_in': list(program.frames),
        'lower': low.tolist(), 'upper': high.tolist(),
    }  # fmt: skip
    return Explained(tuple(rows), facts)


PROGRAM = Kind(
    'NC program',
    'a path; check, calibrate, diagnose, plan, simulate read it with --path',
    is_program,
    _explain,
)
