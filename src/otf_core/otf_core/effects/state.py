# SPDX-License-Identifier: Apache-2.0
"""The state of measured points: of path pieces for the fit, of samples for the simulation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from otf_core.effects.base import State
from otf_core.frames import RigidTransform
from otf_core.machine import Machine

Array = NDArray[np.float64]


def state_on_path(
    machine: Machine,
    corners: Array,
    leg: NDArray[np.int64],
    q: Array,
    speed: Array,
    time: Array,
    T_machine_tracker: RigidTransform,  # noqa: N803 - frame notation
    nodes: Mapping[str, Array],
) -> State:
    """Describe points of a path.

    Parameters
    ----------
    machine : Machine
    corners : ndarray, shape (m + 1, 3), m
        Leg j runs from corner j to corner j + 1.
    leg : ndarray of int64, shape (n,)
    q : ndarray, shape (n, 3), m
        Nominal positions on those legs.
    speed : ndarray, shape (n,), m/s
    time : ndarray, shape (n,), s
    T_machine_tracker : RigidTransform
    nodes : mapping of axis to ndarray, m
    """
    step = np.diff(corners, axis=0)
    length = np.linalg.norm(step, axis=1)
    unit = step / length[:, None]
    along = np.clip(np.einsum('ij,ij->i', q - corners[leg], unit[leg]), 0.0, length[leg])
    return State(
        machine=machine,
        q=q,
        direction=unit[leg],
        speed=speed,
        time=time,
        from_corner=along,
        to_corner=length[leg] - along,
        before=unit[np.maximum(leg - 1, 0)],
        after=unit[np.minimum(leg + 1, len(unit) - 1)],
        beam=q - T_machine_tracker.translation,
        R_machine_tracker=T_machine_tracker.rotation,
        nodes=nodes,
    )
