# SPDX-License-Identifier: Apache-2.0
"""What the truth of a cell depends on, in the inputs of gap.json, and what it is kin to.

A diagnosis that gives no name is judged by the inputs it names instead.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.model.frames import XYZ

NAMED_AT_MOST = 2
"""Inputs of one structure: what depends on more is right with so many of them."""
SENSES = tuple(f'sense_{a.lower()}' for a in XYZ)
PLACES = tuple(a.lower() for a in XYZ)
BEAM = ('range', 'azimuth', 'elevation')
SPEED = ('feed', 'lap')
"""Not told apart where every lap has a feed of its own."""


@dataclass(frozen=True)
class EffectInputs:
    """Inputs of an effect.

    Attributes
    ----------
    groups : tuple of tuple of str
        Of every group one is an input; those of a group say the same in these runs. Empty where
        no smooth function of inputs comes near the effect.
    besides : tuple of str
        May be named besides.
    """

    groups: tuple[tuple[str, ...], ...] = ()
    besides: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a key."""
        return {'groups': [list(g) for g in self.groups], 'besides': list(self.besides)}


def depends_on(*groups: str | tuple[str, ...], besides: Iterable[str] = ()) -> EffectInputs:
    """Groups of one input each, or of several."""
    each = tuple((g,) if isinstance(g, str) else g for g in groups)
    return EffectInputs(each, tuple(besides))


def named_rightly(named: Sequence[str], groups: Sequence[Sequence[str]], *more: str) -> bool:
    """Whether the groups are named, as many as can be, and nothing but these and ``more``."""
    served = sum(bool(set(g) & set(named)) for g in groups)
    known = {n for g in groups for n in g} | set(more)
    enough = served >= min(len(groups), NAMED_AT_MOST)
    return bool(groups) and enough and set(named) <= known


def _axes_of(applied: AppliedEffect) -> list[str]:
    """Axes that coefficients other than zero are of, in lower case."""
    own = [n for n, v in applied.parameters.items() if v and n not in applied.effect.shape_names]
    return [a.lower() for a in XYZ if any(n.endswith(f'_{a}') for n in own)]


def _moving_axes_of(applied: AppliedEffect) -> list[str]:
    """Axes whose error motions a table of coefficients is of (EXY_1: of Y), in lower case."""
    own = [n for n, v in applied.parameters.items() if v and n not in applied.effect.shape_names]
    return [a.lower() for a in XYZ if any(n[:1] == 'E' and n[2:3] == a for n in own)]


def catalogue_depends(applied: AppliedEffect) -> EffectInputs:
    """What an effect of the catalogue depends on, by the equation in its file."""
    senses = tuple(f'sense_{a}' for a in _axes_of(applied))
    match applied.effect.name:
        case 'backlash':
            return EffectInputs(tuple((s,) for s in senses), SENSES)
        case 'direction_dependent_tables':
            moving = _moving_axes_of(applied)
            groups = tuple(f'sense_{a}' for a in moving), tuple(moving)
            return EffectInputs(groups, (*SENSES, *PLACES))
        case 'thermal_axis_expansion':
            return depends_on('time', tuple(_axes_of(applied)), besides=PLACES)
        case 'thermal_structure_drift':
            return depends_on('time')
        case 'tracker_pose_drift':
            return depends_on('time', besides=(*PLACES, *BEAM))
        case 'servo_mismatch':
            return EffectInputs((senses,), (*SENSES, *SPEED, 'acceleration', 'since_stop'))
        case 'cyclic_error':
            return depends_on(*_axes_of(applied))
        case 'corner_rounding':
            return depends_on(('since_stop', 'acceleration'), besides=SENSES)
        case 'cross_coupling' | 'target_incidence' | 'table_tilt' | 'tracker_angles':
            return EffectInputs(((*PLACES, *BEAM),), (*PLACES, *BEAM))
        case _:
            return EffectInputs()


_STATIC = frozenset({
    'cross_coupling', 'table_tilt', 'target_incidence', 'target_offset', 'tracker_angles',
    'tracker_range_offset', 'tracker_scale',
})  # fmt: skip
KIN = (
    frozenset({'backlash', 'direction_dependent_tables', 'servo_mismatch'}),
    frozenset({'thermal_structure_drift', 'tracker_pose_drift'}),
    _STATIC,
)
"""Effects of which one can be the other: play that changes along an axis is a direction-dependent
table, and play that grows with the feed is a lag; a drift of the structure is one of the tracker;
all that depends on the place alone is, from one place of the tracker, some function of two
positions."""
WITHOUT = (
    'backlash', 'direction_dependent_tables', 'thermal_axis_expansion', 'thermal_structure_drift',
    'cross_coupling', 'servo_mismatch', 'corner_rounding', 'tracker_pose_drift', 'cyclic_error',
    'vibration', 'target_incidence',
)  # fmt: skip
"""Effects that leave a trace from one tracker place, each left out in turn."""


def kin_of(name: str) -> tuple[str, ...]:
    """An effect and those it can be, all to be taken out of the catalogue with it."""
    group = next((k for k in KIN if name in k), frozenset({name}))
    return tuple(n for n in REGISTRY if n in group)


FAULTS: dict[str, str] = {
    'play': 'backlash',
    'late': 'servo_mismatch',
    'gear': 'rotary_cyclic_error',
    'weight': 'load_tilt',
    'bearing': 'bearing_tilt',
    'warm': 'centre_growth',
    'brake': 'axis_clamping',
    'reseating': 'reseated_target',
    'incidence': 'facing_incidence',
}
"""Kinds of faults of machines with rotary axes, with the names that are right for them."""
