# SPDX-License-Identifier: Apache-2.0
"""Registries of effects, of machines of linear axes and of rotary ones: one line each."""

from __future__ import annotations

from otf_core.effects.applied_effect import AppliedEffect
from otf_core.effects.base import BelongsTo, Effect, Shape, State, Terms
from otf_core.effects.catalogue.axis_clamping import AxisClamping
from otf_core.effects.catalogue.backlash import Backlash
from otf_core.effects.catalogue.bearing_tilt import BearingTilt
from otf_core.effects.catalogue.centre_growth import CentreGrowth
from otf_core.effects.catalogue.corner_rounding import CornerRounding
from otf_core.effects.catalogue.cross_coupling import CrossCoupling
from otf_core.effects.catalogue.cyclic_error import CyclicError
from otf_core.effects.catalogue.direction_dependent_tables import DirectionDependentTables
from otf_core.effects.catalogue.facing_incidence import FacingIncidence
from otf_core.effects.catalogue.load_tilt import LoadTilt
from otf_core.effects.catalogue.reseated_target import ReseatedTarget
from otf_core.effects.catalogue.rotary_cyclic_error import RotaryCyclicError
from otf_core.effects.catalogue.servo_mismatch import ServoMismatch
from otf_core.effects.catalogue.table_resolution import TableResolution
from otf_core.effects.catalogue.table_tilt import TableTilt
from otf_core.effects.catalogue.target_incidence import TargetIncidence
from otf_core.effects.catalogue.target_offset import TargetOffset
from otf_core.effects.catalogue.thermal_axis_expansion import ThermalAxisExpansion
from otf_core.effects.catalogue.thermal_structure_drift import ThermalStructureDrift
from otf_core.effects.catalogue.tracker_angles import TrackerAngles
from otf_core.effects.catalogue.tracker_noise import TrackerNoise
from otf_core.effects.catalogue.tracker_pose_drift import TrackerPoseDrift
from otf_core.effects.catalogue.tracker_range_offset import TrackerRangeOffset
from otf_core.effects.catalogue.tracker_scale import TrackerScale
from otf_core.effects.catalogue.vibration import Vibration
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES

REGISTRY: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        Backlash(),
        DirectionDependentTables(),
        ThermalAxisExpansion(),
        ThermalStructureDrift(),
        CrossCoupling(),
        ServoMismatch(),
        CornerRounding(),
        CyclicError(),
        Vibration(),
        TableResolution(),
        TableTilt(),
        TargetOffset(),
        TargetIncidence(),
        TrackerPoseDrift(),
        TrackerScale(),
        TrackerRangeOffset(),
        TrackerAngles(),
        TrackerNoise(),
    )
}


ROTARY: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        RotaryCyclicError(),
        LoadTilt(),
        BearingTilt(),
        CentreGrowth(),
        AxisClamping(),
        ReseatedTarget(),
        FacingIncidence(),
    )
}
"""Effects that only machines with rotary axes have."""
EVERY: dict[str, Effect] = {**REGISTRY, **ROTARY}


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
