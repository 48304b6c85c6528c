# SPDX-License-Identifier: Apache-2.0
"""How near the reflectors of the spindle come to the nests on the table and to the tracker.

Points are judged, not bodies: a spindle, a fixture and a tracker are larger than their points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.model.axis_path import along_legs, position_at
from otf_core.model.joints import Sight
from otf_core.model.machine import SPINDLE, TABLE, Machine
from otf_core.planning.rotary_paths import PlannedPart

FROM_NEST, FROM_TRACKER = 0.06, 0.25
"""m between centres below which a part is named."""
STEP, TURN = 0.01, 0.05
"""m and rad between the positions that are judged."""


def near_misses(machine: Machine, parts: Sequence[PlannedPart], place: Array) -> list[str]:
    """Sentences for parts in which a reflector of the spindle comes near to something.

    Parameters
    ----------
    place : ndarray, shape (3,), m
        Beam origin of the tracker in the frame of its link.
    """
    nests = {n: np.array(t.place) for n, t in machine.targets.items() if t.link == TABLE}
    spindle = [n for n, t in machine.targets.items() if t.link == SPINDLE]
    sentences = []
    for number, part in enumerate(parts, start=1):
        q = position_at(part.path.positions, along_legs(part.path.positions, STEP, TURN))
        mounted = [part.path.target] if part.path.target in spindle else spindle
        things = {n: (TABLE, p, FROM_NEST) for n, p in nests.items()}
        things['the tracker'] = (machine.tracker.link, np.asarray(place), FROM_TRACKER)
        for name, (link, at, least) in things.items():
            points = np.concatenate(
                [
                    Sight(machine, link, SPINDLE, np.array(machine.targets[n].place)).nominal(q)
                    for n in mounted
                ]
            )
            near = float(np.linalg.norm(points - at, axis=1).min())
            if near < least:
                sentences.append(
                    f'part {number} brings the reflector of the spindle to {1e3 * near:.0f} mm of '
                    f'{name}: take it out of the way, or narrow the ranges of the axes'
                )
    return sentences
