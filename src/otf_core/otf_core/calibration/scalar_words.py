# SPDX-License-Identifier: Apache-2.0
"""Squareness and location errors in words, in both habits of sign."""

from __future__ import annotations

import math

import numpy as np

from otf_core.model.expanded import figure, micro_with_expanded, with_expanded
from otf_core.model.frames import XYZ
from otf_core.model.machine import Machine
from otf_core.model.motions import unit_of

DIRECTIONS_OF = {'C0Y': ('+X', '+Y'), 'B0Z': ('+X', '+Z'), 'A0Z': ('+Y', '+Z')}
SQUARENESS_SIGN = {'C0Y': 1.0, 'B0Z': -1.0, 'A0Z': 1.0}
"""Directions between which a squareness error changes the angle, and the sign of the change:
C0Y > 0 tilts +Y to -X, B0Z > 0 tilts +Z to +X, A0Z > 0 tilts +Z to -Y."""
ARCSEC = math.pi / 648000


def squareness_words(name: str, value: float, wide: float) -> str:
    """State a squareness error and its U, rad, as an angle, to the last stated digit of U."""
    one, other = DIRECTIONS_OF[name]
    change = SQUARENESS_SIGN[name] * value
    return (
        f'angle between {one} and {other} is 90 deg {"-" if change < 0 else "+"} '
        f'{figure(1e6 * abs(change), 1e6 * wide)} urad '
        f'({figure(abs(change) / ARCSEC, wide / ARCSEC)} arcsec)'
    )


def location_words(machine: Machine, name: str, value: float, wide: float) -> str:
    """State which way the line of a rotary axis lies, in both habits of sign."""
    axis, unit = name[2], unit_of(name)
    found, size = (micro_with_expanded(v, wide, unit) for v in (value, abs(value)))
    if unit == 'm':
        side = f'{"+" if value >= 0 else "-"}{name[0]}'
        return (
            f'{name} = {found}: the average line of {axis} lies {size} towards {side} of its '
            f'nominal place. A control that stores the centre of {axis} is to add '
            f'{with_expanded(1e3 * value, 1e3 * wide)} mm to its {name[0]}; a table of '
            f'corrections holds the opposite sign.'
        )
    turn = np.eye(3)['ABC'.index(name[0])] * np.sign(value or 1.0)
    direction = np.array(machine.axes[axis].direction)
    end, side = (
        f'{"+" if vector[k] >= 0 else "-"}{XYZ[k]}'
        for vector in (direction, np.cross(turn, direction))
        for k in [int(np.argmax(np.abs(vector)))]
    )
    return (
        f'{name} = {found} ({abs(value) / ARCSEC:.2f} arcsec): the average line of {axis} leans '
        f'{size} from {end} towards {side}; the correction has the opposite sign.'
    )
