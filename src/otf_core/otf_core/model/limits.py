# SPDX-License-Identifier: Apache-2.0
"""Limits in machine.yaml under ``limits``: what a calibration is judged by.

All keys are optional. ``volumetric_error``: largest length of the error vector in the volume;
``uncertainty``: largest expanded uncertainty of that vector, which is what remains to be expected
after compensation; an error motion: span of its table; a squareness or location error: its size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from otf_core.files.strict_yaml import Fields
from otf_core.model.motions import DIRECTIONS, ErrorMotion, location_names, unit_of

VOLUMETRIC, UNCERTAINTY = 'volumetric_error', 'uncertainty'
_LENGTHS = (VOLUMETRIC, UNCERTAINTY, *(f'E{d}{a}' for a in 'XYZ' for d in 'XYZ'))
_ANGLES = (*(f'E{d}{a}' for a in 'XYZ' for d in 'ABC'), 'C0Y', 'B0Z', 'A0Z')
KEYS: dict[str, tuple[str, float]] = {
    **dict.fromkeys(_LENGTHS, ('m', 1e-2)),
    **dict.fromkeys(_ANGLES, ('rad', 1e-2)),
}
"""Unit and largest value of every key of a machine of three linear axes."""


@dataclass(frozen=True)
class Limits:
    """Limits by the keys and in the units of ``KEYS``."""

    values: Mapping[str, float]


def limit_keys(rotary: Sequence[str] = ()) -> dict[str, tuple[str, float]]:
    """Unit and largest value of every key of a machine with these rotary axes."""
    names: list[str] = []
    for axis in rotary:
        names += [ErrorMotion(d, axis) for d in DIRECTIONS]
        names += location_names(axis)
    return KEYS | {str(name): (unit_of(name), 1e-2) for name in names}


def limits_from_fields(fields: Fields, rotary: Sequence[str] = ()) -> Limits:
    """Read the section of a machine with these rotary axes.

    Raises
    ------
    ConfigError
        Names the key that is unknown, mistyped or out of range.
    """
    keys = limit_keys(rotary)
    values = {
        key: fields.number(key, low=0.0, high=high, unit=unit)
        for key, (unit, high) in keys.items()
        if fields.has(key)
    }
    fields.done(known=keys)
    return Limits(values)
