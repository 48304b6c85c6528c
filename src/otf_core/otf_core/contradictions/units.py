# SPDX-License-Identifier: Apache-2.0
"""Path and machine description in different units, or of different machines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.errors import InputError
from otf_core.files.text_table import unit_hint, unit_words
from otf_core.model.machine import Machine
from otf_core.model.path import NominalPath
from otf_core.pieces.runs import Recording, blamed

BEYOND = 30.0
"""Times the range of an axis; a path so large is in another unit."""
OUTSIDE = 1e-3
"""m; beyond the range of an axis by less is rounding."""


def check_path_in_machine(recordings: Sequence[Recording]) -> None:
    """Refuse a path that the machine cannot drive; InputError says why."""
    for recording in recordings:
        with blamed(recording.name):
            check_path(recording.path, recording.machine)


def check_path(path: NominalPath, machine: Machine) -> None:
    """Refuse a path that a machine cannot drive; InputError names the unit or the axis."""
    points = path.points
    low, high = points.min(axis=0), points.max(axis=0)
    travel, size = high - low, machine.upper - machine.lower
    reach = np.abs(points).max() / max(np.abs([machine.lower, machine.upper]).max(), 1e-9)
    if max(float(np.max(travel / size)), float(reach)) > BEYOND:
        worst = int(np.argmax(travel))
        reached = float(np.abs(points).max())
        unit = unit_hint(reached, float(np.abs([machine.lower, machine.upper]).max())) or 'mm'
        raise InputError(
            f'path: spans {travel[worst]:g} m in {machine.axis_names[worst]} where '
            f'{machine.name} travels {size[worst]:g} m; the path seems to be in '
            f'{unit_words(unit)}, expected m'
        )
    outside = np.maximum(machine.lower - low, high - machine.upper)
    worst = int(np.argmax(outside))
    if outside[worst] > OUTSIDE:
        raise InputError(
            f'path: leaves the range of axis {machine.axis_names[worst]} by '
            f'{1e3 * outside[worst]:.1f} mm: it spans {low[worst]:g} to {high[worst]:g} m, '
            f'{machine.name} {machine.lower[worst]:g} to {machine.upper[worst]:g} m; do bag and '
            f'machine description belong together?'
        )
