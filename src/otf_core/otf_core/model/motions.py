# SPDX-License-Identifier: Apache-2.0
"""Error motions of linear axes and squareness errors by their ISO 230-1 symbols."""

from __future__ import annotations

from otf_core.model.machine import AXES

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
        """Tell whether this is a linear positioning error such as EXX."""
        return self.direction == self.axis

    @property
    def is_straightness(self) -> bool:
        """Tell whether this is a straightness error such as EYX."""
        return self.is_translation and not self.is_positioning

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
        """Number of the axis that moves: its column in positions (n, 3)."""
        return AXES.index(self.axis)


MOTIONS = tuple(ErrorMotion(direction, axis) for axis in AXES for direction in DIRECTIONS)
SQUARENESS = ('C0Y', 'B0Z', 'A0Z')


def unit_of(name: str) -> str:
    """Unit of an error by its symbol: squareness errors are angles."""
    return 'rad' if name in SQUARENESS else ErrorMotion.of(name).unit
