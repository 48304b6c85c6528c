# SPDX-License-Identifier: Apache-2.0
"""Limits in machine.yaml under ``limits``: what a calibration is judged by.

All keys are optional. ``volumetric_error``: largest length of the error vector in the volume;
``uncertainty``: largest expanded uncertainty of that vector, which is what remains to be expected
after compensation; an error motion: span of its table; a squareness error: its size.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from otf_core.files.strict_yaml import Fields

VOLUMETRIC, UNCERTAINTY = 'volumetric_error', 'uncertainty'
_LENGTHS = (VOLUMETRIC, UNCERTAINTY, *(f'E{d}{a}' for a in 'XYZ' for d in 'XYZ'))
_ANGLES = (*(f'E{d}{a}' for a in 'XYZ' for d in 'ABC'), 'C0Y', 'B0Z', 'A0Z')
KEYS: dict[str, tuple[str, float]] = {
    **dict.fromkeys(_LENGTHS, ('m', 1e-2)),
    **dict.fromkeys(_ANGLES, ('rad', 1e-2)),
}
"""Unit and largest value of every key."""


@dataclass(frozen=True)
class Limits:
    """Limits by the keys and in the units of ``KEYS``."""

    values: Mapping[str, float]


def limits_from_fields(fields: Fields) -> Limits:
    """Read the section.

    Raises
    ------
    ConfigError
        Names the key that is unknown, mistyped or out of range.
    """
    values = {
        key: fields.number(key, low=0.0, high=high, unit=unit)
        for key, (unit, high) in KEYS.items()
        if fields.has(key)
    }
    fields.done(known=KEYS)
    return Limits(values)
