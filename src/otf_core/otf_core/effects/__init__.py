# SPDX-License-Identifier: Apache-2.0
"""Effects that make a real cell differ from the rigid-body simulation, by their names."""

from __future__ import annotations

from otf_core.effects.base import AppliedEffect, Effect
from otf_core.effects.catalogue import machine as _machine
from otf_core.effects.catalogue import rotary as _rotary
from otf_core.effects.catalogue import tracker as _tracker
from otf_core.effects.terms import BelongsTo, Shape, State, Terms
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES

EVERY: dict[str, Effect] = {
    effect.name: effect
    for module in (_machine, _tracker, _rotary)
    for effect in vars(module).values()
    if isinstance(effect, Effect)
}
"""Every effect of the catalogue, in the order of its modules."""
REGISTRY = {n: e for n, e in EVERY.items() if not e.of_rotary_axes}
ROTARY = {n: e for n, e in EVERY.items() if e.of_rotary_axes}
"""Effects that only machines with rotary axes have, and all others."""


def catalogue(machine: Machine) -> dict[str, Effect]:
    """Effects that a machine may have: of rotary axes only where it has some.

    All others need three linear axes and no other, but for those whose formula is for any axes.
    """
    if machine.axis_names == AXES:
        return REGISTRY
    own = ROTARY if machine.rotary_names else {}
    return {n: e for n, e in EVERY.items() if n in own or e.any_axes}


def names_of(part: BelongsTo) -> frozenset[str]:
    """Names of the effects that a part of a calibration takes up."""
    return frozenset(n for n, e in REGISTRY.items() if e.belongs_to is part)


__all__ = [
    'EVERY',
    'REGISTRY',
    'ROTARY',
    'AppliedEffect',
    'BelongsTo',
    'Effect',
    'Shape',
    'State',
    'Terms',
    'catalogue',
    'names_of',
]
