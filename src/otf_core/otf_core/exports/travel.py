# SPDX-License-Identifier: Apache-2.0
"""How positioning differs between forward and backward travel, from ``reversal`` of a file.

The reversal value of a motion is its error in forward travel less that in backward travel;
tables hold the mean. Along the middle line of an axis its own motions act alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.exports.line_terms import middle_line
from otf_core.model.kinematics import displacement
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import MotionTable, Squareness, TablesFile


def reversal_motions(content: TablesFile) -> dict[str, MotionTable]:
    """Reversal values by motion, forward less backward; empty if the file holds none.

    Raises
    ------
    ConfigError
        If it holds some that are no numbers at ascending positions.
    """
    reversal = content.extra.get('reversal')
    motions = reversal.get('motions') if isinstance(reversal, Mapping) else None
    if not isinstance(motions, Mapping):
        return {}
    tables = {}
    for name, entry in motions.items():
        try:
            position, value = (np.asarray(entry[k], dtype=float) for k in ('position', 'value'))
        except (KeyError, TypeError, ValueError):
            raise ConfigError(f'reversal: {name}: expected position and value, lists') from None
        ascending = position.ndim == 1 and bool(np.all(np.diff(position) > 0))
        if name not in MOTIONS or not ascending or position.shape != value.shape:
            raise ConfigError(f'reversal: {name}: no table of an error motion')
        tables[name] = MotionTable(position, value, 0.0 * value)
    return tables


def half_reversal(content: TablesFile, axis: int, position: Array) -> Array:
    """Half of the positioning in forward less that in backward travel, shape (k,), m.

    Parameters
    ----------
    content : TablesFile
    axis : int
    position : ndarray, shape (k,), m
        Along the line of the axis through the middle of the volume.
    """
    tables, known = content.tables, reversal_motions(content)
    none = MotionTable(np.zeros(1), np.zeros(1), np.zeros(1))
    own: dict[str, MotionTable] = {
        m: known.get(m, none) if m.place == axis else none for m in MOTIONS
    }
    q = middle_line(tables, axis, position)
    only = replace(tables, motions=own, squareness={k: Squareness() for k in SQUARENESS})
    return np.asarray(0.5 * displacement(only, q)[:, axis])
