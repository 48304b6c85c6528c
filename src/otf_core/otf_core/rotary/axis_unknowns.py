# SPDX-License-Identifier: Apache-2.0
"""The unknowns of a calibration with rotary axes and their layout.

A pose correction for every place of the tracker, a correction of the place of every target that is
not known, squareness and location errors, and the spline coefficients of all motions. All motions
of a rotary axis are zero at its zero position; what its line does is left to the location errors,
which are vague before any data, and put into the gauge of the tables afterwards (``tabulation``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.model.machine import Machine
from otf_core.model.motions import unit_of
from otf_core.rotary.periodic import over_turn
from otf_core.solving.unknowns import (
    POSE,
    Basis,
    Unknowns,
    cubic,
    lay_out_blocks,
    motion_gauge,
    pose_block,
)

FEWEST, MOST = 8, 24
"""Parts of the range of an axis that its splines have."""
PLACE = 3


def place_block(target: str) -> str:
    """Name of the block of the place of a target."""
    return f'place {target}'


def lag_block(axis: str) -> str:
    """Name of the block of the time, s, by which an axis is late."""
    return f'lag {axis}'


def smooth_bases(machine: Machine, nodes: Mapping[str, Array], finer: int = 1) -> dict[str, Basis]:
    """Cubic splines over equal parts of the range of every axis, or of a turn."""
    bases: dict[str, Basis] = {}
    for axis, at in nodes.items():
        parts = finer * int(np.clip(len(at) - 1, FEWEST, MOST))
        whole = machine.axes[axis].endless and at[-1] - at[0] > 2.0 * np.pi - 1e-2
        bases[axis] = over_turn(float(at[0]), parts) if whole else cubic(at, parts)
    return bases


def linear_bases(machine: Machine, nodes: Mapping[str, Array]) -> dict[str, Basis]:
    """Functions that are linear between the nodes of every axis, on a turn if smooth ones are."""
    smooth = smooth_bases(machine, nodes)
    return {axis: basis.linear_between(nodes[axis]) for axis, basis in smooth.items()}


def layout(
    machine: Machine,
    bases: Mapping[str, Basis],
    stations: int,
    targets: Sequence[str],
    reversal: Sequence[str] = (),
    lags: Sequence[str] = (),
) -> Unknowns:
    """Lay out the unknowns.

    Parameters
    ----------
    bases : mapping of axis to Basis
    stations : int
        Places of the tracker.
    targets : sequence of str
        Those whose places are not known.
    reversal : sequence of str
        Blocks of the reversal coefficients, those of a motion from its constant on.
    lags : sequence of str
        Axes that are late by a constant time.
    """
    order = sorted(machine.motions, key=lambda m: unit_of(m) != 'm')
    parts: list[tuple[str, Array]] = [(pose_block(k), np.eye(POSE)) for k in range(stations)]
    parts += [(place_block(name), np.eye(PLACE)) for name in targets]
    parts += [(name, np.eye(1)) for name in machine.scalars]
    parts += [(name, motion_gauge(name, bases[name.axis])) for name in order]
    parts += [(name, np.eye(1)) for name in reversal]
    parts += [(lag_block(axis), np.eye(1)) for axis in lags]
    return Unknowns(dict(bases), *lay_out_blocks(parts))
