# SPDX-License-Identifier: Apache-2.0
"""Rotations that hold a share of one that two target offsets do not show.

With the offsets T1 and T2 a rotation r of an axis whose lever arm no other axis changes is a
translation where r x (T2 - T1) = 0: the turn about the line between both targets is not seen. If
that line is along a machine axis it is one motion, which is not identifiable; if not, it is a
mixture of three of which one is taken for zero, and the others take its share.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS

APART = 1e-3
"""m; targets that are nearer than this to a line lie on it."""
ALONG = 0.999
"""Cosine of the angle up to which a line is along a machine axis."""


def mixture_warnings(machines: Sequence[Machine], hidden: Collection[str]) -> list[str]:
    """Name the motions of every axis that are meant with the hidden rotation at zero.

    Parameters
    ----------
    machines : sequence of Machine
        Of the runs, with their target offsets.
    hidden : collection of str
        Motions that are not identifiable.
    """
    offsets = np.array([machine.target_offset for machine in machines])
    size, lines = np.linalg.svd(offsets - offsets.mean(axis=0))[1:]
    if np.count_nonzero(size > APART) != 1 or np.abs(lines[0]).max() > ALONG:
        return []
    found = []
    for axis in machines[0].axis_names:
        rotations = [m for m in MOTIONS if m.axis == axis and not m.is_translation]
        unseen = [m for m in rotations if m in hidden]
        if len(unseen) != 1 or set(machines[0].chain.lever_axes(axis)) - {axis}:
            continue
        others = ' and '.join(m for m in rotations if m not in unseen)
        found.append(
            f'{others} hold a share of {unseen[0]}, which is taken for zero: the target offsets '
            f'do not differ along one machine axis, and no turn of {axis} about the line between '
            f'them is seen; the translations of {axis} hold the rest of it. Predictions at these '
            f'offsets are right. Take offsets that differ along a machine axis, or a third one'
        )
    return found
