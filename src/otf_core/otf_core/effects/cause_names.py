# SPDX-License-Identifier: Apache-2.0
"""Names of causes by what they depend on and how they act.

A function of these inputs that acts in this way is the effect of that name, whatever its form: a
table that tilts with the square of a position tilts. What depends on other inputs, or acts in
another way, has no name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from otf_core.effects.action import RIGID_TABLE, RIGID_TRACKER, VECTOR, Acting, Along, acting_name
from otf_core.effects.inputs import SIGNAL
from otf_core.model.frames import XYZ

POSITIONS = tuple(axis.lower() for axis in XYZ)
RIGID = (RIGID_TRACKER, RIGID_TABLE)
ALMOST = 0.95
"""Component of a unit vector from which it counts as along an axis."""


def _positions(count: int) -> Callable[[Sequence[str]], bool]:
    return lambda inputs: len(inputs) == count and set(inputs) <= set(POSITIONS)


def _course(inputs: Sequence[str]) -> bool:
    (first, *others) = inputs
    return not others and (first in ('time', 'lap') or first.startswith(SIGNAL))


def _of_axis(*heads: str) -> Callable[[Sequence[str]], bool]:
    """Inputs of one axis: these heads, each followed by its name."""
    return lambda inputs: any(set(inputs) == {head + a for head in heads} for a in POSITIONS)


@dataclass(frozen=True)
class NameRule:
    """One line of the table.

    Attributes
    ----------
    name : str
        Of the catalogue.
    inputs : callable
        Whether some inputs are its own.
    acts_as : tuple of str
        Ways to act.
    along : bool
        True if it displaces along the axis that its inputs name.
    words : str
        How it departs from the formula.
    """

    name: str
    inputs: Callable[[Sequence[str]], bool]
    acts_as: tuple[str, ...]
    along: bool
    words: str


NAMES = (
    NameRule('table_tilt', _positions(1), RIGID, False,
          'the tilt is not proportional to the position'),
    NameRule('tracker_pose_drift', _course, RIGID, False,
          'the drift does not follow an exponential in time'),
    NameRule('cross_coupling', _positions(2), (VECTOR, 'direction'), False,
          'the error is not a low-order polynomial of the positions'),
    NameRule('backlash', _of_axis('sense_'), ('direction',), True,
          'it differs between the senses of travel'),
    NameRule('backlash', _of_axis('since_reversal_'), ('direction',), True,
          'the backlash is traversed over some distance after a reversal'),
    NameRule('direction_dependent_tables', _of_axis('sense_', ''), ('direction',), True,
          'the reversal depends on the position'),
    NameRule('thermal_axis_expansion', lambda inputs: 'time' in inputs and len(inputs) == 2
          and set(inputs) - {'time'} <= set(POSITIONS), ('direction',), True,
          'the expansion is not proportional to the distance from the zero position of the axis'),
)  # fmt: skip
"""What (inputs, way to act) belongs to which name."""


def name_of(inputs: Sequence[str], acts: Acting) -> tuple[str, str]:
    """Name of what depends on inputs and acts in a way, and how it departs from its formula.

    Both are empty where nothing in the catalogue depends and acts so.
    """
    for line in NAMES:
        if acting_name(acts) not in line.acts_as or not line.inputs(inputs):
            continue
        if not line.along or _is_along(acts, inputs):
            return line.name, line.words
    return '', ''


def _is_along(acts: Acting, inputs: Sequence[str]) -> bool:
    axes = {name[-1] for name in inputs if name[-1] in POSITIONS and name != 'time'}
    if not isinstance(acts, Along) or len(axes) != 1:
        return False
    return bool(abs(acts.direction[POSITIONS.index(axes.pop())]) > ALMOST)
