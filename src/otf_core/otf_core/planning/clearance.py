# SPDX-License-Identifier: Apache-2.0
"""How near bodies come to each other along a plan, and what stands in the beam.

Bodies are the reflectors of the spindle and of the table, the beam origin of the tracker, and the
boxes of machine.yaml (``surroundings``). Reflectors and tracker are points with a distance to
keep; a spindle, a fixture or a tracker that is larger has to be a box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from otf_core.arrays import Array
from otf_core.model.axis_path import along_legs, position_at
from otf_core.model.chain import Sight
from otf_core.model.machine import BED, SPINDLE, TABLE, Machine
from otf_core.model.plan import Part
from otf_core.model.surroundings import Box

FROM_REFLECTOR, FROM_TRACKER, FROM_BOX = 0.06, 0.25, 0.02
"""m that others keep from the centre of a reflector, from the beam origin and from a box."""
STEP, TURN = 0.01, 0.05
"""m and rad between the positions that are judged."""
HIDDEN = 0.01
"""Share of a part in which a box may stand in the beam without a word."""


@dataclass(frozen=True)
class Body:
    """A box, or a point as a box without size; ``keep`` in m."""

    name: str
    box: Box
    keep: float


def in_frame(machine: Machine, link: str, points: Array, frame: str, q: Array) -> Array:
    """Points (m, 3) of a link, all axes at zero, in the frame of another link, (n, m, 3), m."""
    if link == frame:
        return np.broadcast_to(points, (len(q), *points.shape))
    if link == BED or frame == SPINDLE:  # against the way of the transforms
        seen = Sight(machine, link, frame, np.zeros(3)).at(q)
        off = np.asarray(points - seen.position[:, None])
        return off if seen.inner is None else np.asarray(off @ seen.inner)
    own = [Sight(machine, frame, link, p).nominal(q) for p in points]
    return np.stack(own, axis=1)


def bodies(machine: Machine, place: Array, mounted: Sequence[str]) -> list[Body]:
    """Bodies while the reflectors ``mounted`` are in the spindle; those of the table always are.

    Parameters
    ----------
    place : ndarray, shape (3,), m
        Beam origin of the tracker in the frame of its link.
    """
    own = []
    for link, words in ((SPINDLE, 'the reflector of the spindle ({})'), (TABLE, '{}')):
        for name, target in machine.targets.items():
            if target.nest not in ('', name):  # another facing of the same reflector
                continue
            if target.link == link and (link == TABLE or name in mounted):
                own.append(Body(words.format(name), _point(link, target.place), FROM_REFLECTOR))
    boxes = machine.surroundings.boxes
    own += [Body(f'box {name}', box, FROM_BOX) for name, box in boxes.items()]
    return [*own, Body('the tracker', _point(machine.tracker.link, place), FROM_TRACKER)]


def _point(link: str, place: Sequence[float] | Array) -> Box:
    x, y, z = (float(v) for v in place)
    return Box(link, (x, y, z), (x, y, z))


def near_misses(machine: Machine, parts: Sequence[Part], place: Array) -> list[str]:
    """Sentences for parts in which bodies of two links come near, or a box hides a reflector.

    Parameters
    ----------
    place : ndarray, shape (3,), m
        Beam origin of the tracker in the frame of its link.
    """
    spindle = [n for n, t in machine.targets.items() if t.link == SPINDLE]
    sentences = []
    for number, part in enumerate(parts, start=1):
        path, target = part.path, part.path.target
        q = position_at(path.positions, along_legs(path.axes, path.positions, STEP, TURN))
        own = bodies(machine, place, [target] if target in spindle else spindle)
        for one, other in combinations(own, 2):
            if one.box.link == other.box.link:
                continue
            near = _distance(machine, one.box, other.box, q)
            if near < max(one.keep, other.keep):
                sentences.append(
                    f'part {number} brings {one.name} to {1e3 * near:.0f} mm of {other.name}: '
                    f'take one out of the way, or narrow the ranges of the axes'
                )
        for name, share in _in_the_beam(machine, target, place, q).items():
            sentences.append(
                f'part {number}: box {name} stands in the beam to {target} in {100 * share:.0f} % '
                f'of the positions'
            )
    return sentences


def _distance(machine: Machine, one: Box, other: Box, q: Array) -> float:
    """Least distance of the points of one box from the other, both ways, m."""
    first = other.distances(in_frame(machine, one.link, _spread(one), other.link, q))
    second = one.distances(in_frame(machine, other.link, _spread(other), one.link, q))
    return float(min(first.min(), second.min()))


def _spread(box: Box) -> Array:
    return box.points[:1] if box.low == box.high else box.points


def _in_the_beam(machine: Machine, target: str, place: Array, q: Array) -> dict[str, float]:
    """Share of positions in which each box stands between tracker and reflector."""
    spec, tracker = machine.targets[target], machine.tracker.link
    hidden = {}
    for name, box in machine.surroundings.boxes.items():
        start = in_frame(machine, tracker, np.asarray(place)[None], box.link, q)[:, 0]
        end = in_frame(machine, spec.link, np.array(spec.place)[None], box.link, q)[:, 0]
        holds = box.distances(np.array([spec.place if box.link == spec.link else place]))[0] == 0.0
        if holds and box.link in (spec.link, tracker):  # a box about the reflector or the tracker
            continue
        share = float(np.mean(box.crossed(start, end)))
        if share > HIDDEN:
            hidden[name] = share
    return hidden
