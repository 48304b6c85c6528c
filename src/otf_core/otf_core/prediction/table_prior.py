# SPDX-License-Identifier: Apache-2.0
"""Rotations that the data do not see, for another tool: the block ``prior`` of the tables.

A rotation r_a that the data do not see (``identifiable: false``) is written as zero. At the
target offset T that was measured with it needs no place in u: r_a x L_a is there what other
motions can do as well, and their tables hold it. With another offset T' the tables lack

    r_a(q_a) x (T' - T)

``prior: {MOTION: {"sd": r}}`` holds the standard deviation r (rad) of what it may be.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.kinematics import turn_arms
from otf_core.model.motions import MOTIONS

NO_LEVER = 1e-9
"""m; shorter levers are rounding."""


def prior_from_dict(data: Any, where: str) -> dict[str, float]:
    """Read the block ``prior`` of an error_tables.json.

    Parameters
    ----------
    data : object
        None if the file holds none. Keys that are no motion and other parts are left alone: extra
        fields are welcome.
    where : str
        For messages.

    Returns
    -------
    mapping of motion to float
        Standard deviations, m or rad; empty if there is none.

    Raises
    ------
    ConfigError
        Names the motion whose ``sd`` is not a number from zero on.
    """
    if data is None:
        return {}
    if not isinstance(data, Mapping):
        raise ConfigError(f'{where}: prior: expected motions with sd')
    sizes = {}
    for name in (m for m in MOTIONS if m in data):
        entry = data[name]
        value = entry.get('sd', 0.0) if isinstance(entry, Mapping) else entry
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not isinstance(entry, Mapping) or not number or not math.isfinite(value) or value < 0:
            raise ConfigError(
                f'{where}: prior: {name}: sd: expected a number from 0 on, got {value!r}'
            )
        sizes[str(name)] = float(value)
    return sizes


def unseen_columns(names: Iterable[str], change: Array) -> dict[str, Array]:
    """Rotations that were not seen and act at another target offset all the same.

    Parameters
    ----------
    names : iterable of str
        What was not seen; only rotations have a lever.
    change : ndarray, shape (3,), m
        T' - T.

    Returns
    -------
    mapping of name to ndarray, shape (3,), m/rad
        Displacement per rad that the tables do not hold; without those that have none.
    """
    rotations = (m for m in MOTIONS if m in tuple(names) and not m.is_translation)
    columns = {str(m): turn_arms(m.along, change[None])[0] for m in rotations}
    return {n: own for n, own in columns.items() if np.any(np.abs(own) > NO_LEVER)}
