# SPDX-License-Identifier: Apache-2.0
"""Values that hold at one target offset only: those that contain a rotation nobody saw.

A rotation r(q_a) along d of an axis a moves a target at the offset T by r d x T more than one at
the machine zero that the axes carry along. Where the data do not show r, this part of it is a
translation like any other: it is in the straightness, the positioning and the squareness that
were determined, and with another tool it would be another one. Which values take it up follows
from the model: the displacement d x T of smooth functions r is split into what squareness errors
and translations that are seen, in their gauge, and a rigid motion of the whole can make.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.documents import Document, stated
from otf_core.model.chain import Sight, nominal_position
from otf_core.model.evaluation import rigid_columns
from otf_core.model.machine import Machine
from otf_core.model.motions import ErrorMotion

COUNT = 5
"""Places per axis at which displacements are compared; as many as a cubic needs, and one."""
LEAST = 1e-6
"""Share of the displacement below which a value takes up nothing of it."""


def offset_words(offset: Array) -> str:
    """A target offset: '(0, 0, -150) mm'."""
    return f'({", ".join(f"{1e3 * v + 0.0:.6g}" for v in offset)}) mm'


@dataclass(frozen=True)
class OffsetBound(Document):
    """Values that contain rotations which the data do not show."""

    offset: Array = stated('target offset at which they hold', 'm', shape=(3,))
    contains: Mapping[str, tuple[str, ...]] = stated(
        'rotations that a motion or squareness error contains', factory=dict
    )
    sentence: str = stated('all of them in one sentence; may be empty', default='')

    def __post_init__(self) -> None:
        """Say them in one sentence."""
        object.__setattr__(self, 'sentence', self._sentence())

    def words(self, name: str) -> str:
        """What stands beside a value; empty for one that holds at any target offset."""
        rotations = self.contains.get(name)
        if not rotations:
            return ''
        return f'at target offset {offset_words(self.offset)}, contains {", ".join(rotations)}'

    def _sentence(self) -> str:
        if not self.contains:
            return ''
        unseen = dict.fromkeys(r for rotations in self.contains.values() for r in rotations)
        return (
            f'measured with one target offset, {offset_words(self.offset)}: '
            f'{", ".join(self.contains)} include {", ".join(unseen)} times the lever arm; measure '
            f'a second offset to separate them'
        )


def offset_bound(machine: Machine, hidden: Collection[str]) -> OffsetBound:
    """Find the values that hold at the target offset of the measurement only.

    Parameters
    ----------
    machine : Machine
        With the target offset that was measured with.
    hidden : collection of str
        Motions and squareness errors that the data cannot see.

    Notes
    -----
    Of linear axes: where axes turn, the place of every reflector is an unknown.
    """
    if machine.location:  # u of the tables holds what was taken for zero
        return OffsetBound(machine.target_offset)
    places = [np.linspace(-1.0, 1.0, COUNT)] * len(machine.axis_names)
    s = np.stack([g.ravel() for g in np.meshgrid(*places, indexing='ij')], axis=1)
    q = 0.5 * (machine.lower + machine.upper) + 0.5 * s * (machine.upper - machine.lower)
    names, columns = _seen_columns(machine, hidden, s, q)
    rigid = rigid_columns(nominal_position(machine, q))
    basis = np.concatenate([rigid, *columns], axis=2).reshape(3 * len(q), -1)
    scale = np.linalg.norm(basis, axis=0)
    used = scale > 0
    contained: dict[str, list[str]] = {}
    for rotation in (m for m in machine.motions if m in hidden and not m.is_translation):
        functions = _shapes(rotation, s[:, machine.column(rotation.axis)])
        moved = np.cross(np.eye(3)[rotation.along], machine.target_offset)
        moved = (moved[:, None] * functions[:, None, :]).reshape(3 * len(q), -1)
        if not np.abs(moved).max() > 0:
            continue
        weights = np.zeros((basis.shape[1], moved.shape[1]))
        weights[used] = np.linalg.lstsq(basis[:, used] / scale[used], moved, rcond=None)[0]
        size = np.abs(weights).max(axis=1) / np.linalg.norm(moved, axis=0).max()
        start = 6
        for name, own in zip(names, columns, strict=True):
            stop = start + own.shape[2]
            if size[start:stop].max() > LEAST:
                contained.setdefault(name, []).append(rotation)
            start = stop
    order = (*machine.squareness, *machine.motions)
    return OffsetBound(
        machine.target_offset, {n: tuple(contained[n]) for n in order if n in contained}
    )


def _seen_columns(
    machine: Machine, hidden: Collection[str], s: Array, q: Array
) -> tuple[list[str], list[Array]]:
    """Names of what can take it up, and the displacements (n, 3, m) of each at q (n, k)."""
    names: list[str] = [n for n in machine.squareness if n not in hidden]
    view = Sight.of_tool(machine).at(q)
    columns = [view.scalars[n][:, :, None] for n in names]
    for motion in (m for m in machine.motions if m.is_translation and m not in hidden):
        shapes = _shapes(motion, s[:, machine.column(motion.axis)])
        names.append(motion)
        columns.append(view.influence(motion)[:, :, None] * shapes[:, None, :])
    return names, columns


def _shapes(motion: ErrorMotion, s: Array) -> Array:
    """Smooth functions (n, k) of -1 <= s <= 1 in the gauge of a motion."""
    if motion.is_straightness:
        return np.stack([1.0 - s**2, s - s**3], axis=1)
    return np.stack([1.0 + s, 1.0 - s**2, s - s**3], axis=1)
