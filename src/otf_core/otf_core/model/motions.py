# SPDX-License-Identifier: Apache-2.0
"""Error motions, squareness and location errors by their ISO 230-1 symbols."""

from __future__ import annotations

AXES = ('X', 'Y', 'Z')
"""Linear axes, in the order of the columns of positions.

For this room alone: all others ask the machine for its own (``axis_names``); the directions of
space are ``frames.XYZ``.
"""
ROTARY = ('A', 'B', 'C')
"""Rotary axes, nominally about X, Y, Z."""
LETTERS = (*AXES, *ROTARY)
DIRECTIONS = ('X', 'Y', 'Z', 'A', 'B', 'C')
"""Translations along and rotations about X, Y, Z."""


class ErrorMotion(str):
    """An error motion: its symbol, E + direction + axis, that knows its parts.

    Equal to the plain symbol, so that it is a key of tables and files as it stands.

    Parameters
    ----------
    direction : str
        X, Y, Z: translation along; A, B, C: rotation about X, Y, Z.
    axis : str
        The axis that moves.
    """

    direction: str
    axis: str

    def __new__(cls, direction: str, axis: str) -> ErrorMotion:
        """Put the symbol together."""
        self = super().__new__(cls, f'E{direction}{axis}')
        self.direction, self.axis = direction, axis
        return self

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        """Arguments from which a copy is made."""
        return self.direction, self.axis

    @classmethod
    def of(cls, symbol: str) -> ErrorMotion:
        """Read a symbol such as EXX."""
        return cls(symbol[1], symbol[2])

    @property
    def is_translation(self) -> bool:
        """True for EXX, EYX ..., false for EAX ..."""
        return self.direction in DIRECTIONS[:3]

    @property
    def is_positioning(self) -> bool:
        """Return whether this is a positioning error such as EXX or ECC."""
        return self.direction == self.axis

    @property
    def is_straightness(self) -> bool:
        """Return whether this is a straightness error such as EYX."""
        return self.is_translation and not self.is_positioning and self.axis in AXES

    @property
    def unit(self) -> str:
        """'m' for a translation, 'rad' for a rotation."""
        return 'm' if self.is_translation else 'rad'

    @property
    def along(self) -> int:
        """Number of the machine axis that the error moves along or turns about."""
        return DIRECTIONS.index(self.direction) % 3

    @property
    def place(self) -> int:
        """Number of the linear axis that moves: its column in positions (n, 3)."""
        return AXES.index(self.axis)


MOTIONS = tuple(ErrorMotion(direction, axis) for axis in AXES for direction in DIRECTIONS)
"""Of three linear axes; those of a machine are ``Machine.motions``."""
SQUARENESS = ('C0Y', 'B0Z', 'A0Z')
"""Of three linear axes; those of a machine are ``Machine.squareness``."""


def location_names(axis: str) -> tuple[str, ...]:
    """Location errors of a rotary axis: X0C, Y0C, A0C, B0C; none along and about it."""
    along = ROTARY.index(axis)
    return tuple(f'{d}0{axis}' for k, d in enumerate(DIRECTIONS) if k % 3 != along)


def is_motion(name: str) -> bool:
    """Return whether a symbol is an error motion of any axis, such as EXX or ECC."""
    return len(name) == 3 and name[0] == 'E' and name[1] in DIRECTIONS and name[2] in LETTERS


def is_location(name: str) -> bool:
    """Return whether a symbol is a location error of a rotary axis, such as X0C."""
    return len(name) == 3 and name[1] == '0' and name[2] in ROTARY and name[0] in DIRECTIONS


def unit_of(name: str) -> str:
    """Unit of an error by its symbol: squareness errors are angles."""
    if name in SQUARENESS:
        return 'rad'
    if is_location(name):
        return 'm' if name[0] in AXES else 'rad'
    return ErrorMotion.of(name).unit
