# SPDX-License-Identifier: Apache-2.0
"""The path that an NC program drives: where the axes stand, block after block, and its corners.

Positions are decimal fractions of a metre, so a corner is the decimal that the program prints.
An arc becomes chords whose joints lie on it, so short that they are as good as the arc.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import NoReturn

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.files.message_text import shortened

Position = dict[str, Decimal | None]
"""By axis, m; None: not stated by the program."""

CHORD, CHORD_TURN = 1e-3, math.radians(5.0)
"""m and rad; chords of an arc are no longer and turn no more, so they leave it by at most a
hundredth of their length."""
SHORTEST_CHORD = 1e-4
"""m; shorter chords are below what curves are recognised by."""
SAGITTA = 2e-7
"""m; by which chords of that length or more leave their arc at most."""
MAX_RADIUS_STEP = 25e-6
"""m; end points of an arc may lie so much nearer to its centre than its start, by rounding."""
LONGEST_ARC, MOST_CORNERS = 1000.0, 5_000_000
"""m; no machine drives a longer arc. Corners of a path, its chords included."""
APPROACH = 5
"""Moves before the first program stop that may be the approach to the start of the path."""
MACHINE = 'machine coordinates'
CURE = 'give the plan.json of otf plan or a CSV x,y,z of the corner points instead'


@dataclass
class DrivenPath:
    """Corners of the moves of a program, in driving order.

    Attributes
    ----------
    where : str
        The file, for messages.
    block : tuple of int and str
        Line and text of what is read, for messages.
    at : dict of str to Decimal or None
        Where the axes stand, m.
    corners : list of tuple of 3 float
        m; none is repeated at once.
    lines, arcs, slanted_rapids : int
        Moves of each kind; rapid moves of several axes at once.
    frames : Counter of str
        Moves by what their positions refer to: a work offset, or ``MACHINE``.
    remarks : list of str
        What of the motion is not in the path.
    """

    where: str
    block: tuple[int, str] = (0, '')
    at: Position = field(default_factory=lambda: dict.fromkeys('XYZ'))
    corners: list[tuple[float, float, float]] = field(default_factory=list)
    lines: int = 0
    arcs: int = 0
    slanted_rapids: int = 0
    frames: Counter[str] = field(default_factory=Counter)
    remarks: list[str] = field(default_factory=list)
    _moves: int = 0
    _unseen: int = 0
    _lost: tuple[int, str] | None = None
    _stopped: bool = False

    def refuse(self, why: str, word: str = '') -> NoReturn:
        """Refuse the program for a word of its block, or for all of it."""
        line, text = self.block
        raise ConfigError(
            f'{self.where}: line {line}: {shortened(word or text, 60)!r} {why}; an NC program is '
            f'read as a path of straight lines and arcs of X, Y, Z alone: {CURE}'
        )

    def line_to(self, goal: Mapping[str, Decimal | None], frame: str) -> None:
        """Drive straight to where some axes are given; None: to where the program does not say."""
        self._frame(frame)
        self.lines += 1
        self._moves += 1
        self.at |= goal
        if self._is_known():
            self._found_again()
            self._add(self._point())
        else:
            self._lose()

    def arc_to(
        self,
        goal: Mapping[str, Decimal | None],
        frame: str,
        plane: str,
        centre: Mapping[str, Decimal] | None,
        radius: Decimal | None,
        *,
        clockwise: bool,
    ) -> None:
        """Drive along an arc.

        Parameters
        ----------
        goal : mapping of str to Decimal
            Where it ends, m; axes that are not given stay.
        plane : str
            First and second axis; an arc that is not clockwise turns from the first to the second.
        centre : mapping of str to Decimal, optional
            Of both axes of the plane, m.
        radius : Decimal, optional
            m; where no centre is given; negative: more than half a turn.
        """
        start = dict(self.at)
        end = {**start, **goal}
        if None in (*start.values(), *end.values()):
            self.refuse('begins before the program has stated X, Y and Z')
        self._frame(frame)
        self._add(self._point())
        self.arcs += 1
        self._moves += 1
        first = np.array([float(start[a] or 0) for a in 'XYZ'])
        last = np.array([float(end[a] or 0) for a in 'XYZ'])
        u, v = ('XYZ'.index(a) for a in plane)
        if centre is None:
            assert radius is not None
            middle = self._centre_of(first[[u, v]], last[[u, v]], float(radius), clockwise)
        else:
            middle = np.array([float(centre[a]) for a in plane])
        for point in self._chords(first, last, (u, v), middle, clockwise):
            self._add((float(point[0]), float(point[1]), float(point[2])))
        self.at = end
        self._add(self._point())

    def stop(self) -> None:
        """Program stop: what was driven before the first may have been the approach."""
        if not self._stopped and 0 < self._moves <= APPROACH and self._is_known():
            self.remarks.append(
                f'{self._moves} moves before the first program stop are treated as the approach'
            )
            self.corners = [self._point()]
        self._stopped = True

    def finish(self) -> Array:
        """Corner points, shape (n, 3), m."""
        if self._lost is not None:
            line, word = self._lost
            self.remarks.append(
                f'what follows from line {line} on ({word}) is treated as a retract'
            )
        missing = [axis for axis, value in self.at.items() if value is None]
        if not self.corners and missing:
            raise ConfigError(
                f'{self.where}: is an NC program that never states where {", ".join(missing)} '
                f'stands; state X, Y and Z of the start of the path in it, or {CURE}'
            )
        if len(self.corners) < 2:
            raise ConfigError(f'{self.where}: is an NC program without any motion of X, Y, Z')
        return np.array(self.corners)

    def _point(self) -> tuple[float, float, float]:
        x, y, z = (float(self.at[axis] or 0) + 0.0 for axis in 'XYZ')
        return x, y, z

    def _is_known(self) -> bool:
        return None not in self.at.values()

    def _add(self, point: tuple[float, float, float]) -> None:
        if not self.corners or self.corners[-1] != point:
            self.corners.append(point)

    def _frame(self, frame: str) -> None:
        self.frames[frame] += 1
        offsets = [name for name in self.frames if name != MACHINE]
        if len(offsets) > 1:
            self.refuse(
                f'moves in {offsets[1]} after moves in {offsets[0]}, and the program does not '
                f'state how they are related',
            )  # fmt: skip

    def _lose(self) -> None:
        """Count a move to where the program does not say."""
        if self.corners:
            self._lost = self._lost or self.block
            return
        self._unseen += 1
        if self._unseen > APPROACH:
            missing = ' and '.join(a for a, value in self.at.items() if value is None)
            self.refuse(
                f'is move {self._unseen} of the program, which has not stated yet where {missing} '
                f'stands',
            )  # fmt: skip

    def _found_again(self) -> None:
        if self._lost is not None:
            self.block = self._lost
            self.refuse('goes to a position that is not in the program')

    def _centre_of(self, start: Array, end: Array, radius: float, clockwise: bool) -> Array:
        """Centre of an arc of given radius between two points of its plane."""
        chord = end - start
        half = 0.5 * math.hypot(*chord)
        if half == 0.0:
            self.refuse('is an arc of given radius that ends where it begins')
        if half > abs(radius) + MAX_RADIUS_STEP:
            self.refuse('is an arc whose ends lie farther apart than 2 R')
        away = math.sqrt(max(radius * radius - half * half, 0.0))
        normal = np.array([-chord[1], chord[0]]) / (2.0 * half)
        return 0.5 * (start + end) + normal * away * (-1 if clockwise else 1) * (
            -1 if radius < 0 else 1
        )

    def _chords(
        self, start: Array, end: Array, plane: tuple[int, int], middle: Array, clockwise: bool
    ) -> Array:
        """Points of an arc after its start, shape (n, 3), m; the last but one is the last."""
        to_start, to_end = start[list(plane)] - middle, end[list(plane)] - middle
        radius = math.hypot(*to_start)
        if radius <= 0.0 or abs(math.hypot(*to_end) - radius) > MAX_RADIUS_STEP:
            self.refuse(
                f'is an arc whose ends lie {1e3 * radius:.4f} and {1e3 * math.hypot(*to_end):.4f} '
                f'mm from its centre',
            )  # fmt: skip
        begin = math.atan2(to_start[1], to_start[0])
        turn = (math.atan2(to_end[1], to_end[0]) - begin) % (2.0 * math.pi)
        if clockwise:
            turn -= 2.0 * math.pi
        if np.array_equal(start[list(plane)], end[list(plane)]):
            turn = -2.0 * math.pi if clockwise else 2.0 * math.pi
        length = radius * abs(turn)
        if not length <= LONGEST_ARC:
            self.refuse(f'is an arc of {length:.3g} m, which no machine can drive')
        if len(self.corners) > MOST_CORNERS:
            self.refuse(f'is an arc after {MOST_CORNERS} chords: too many')
        chord = min(CHORD, math.sqrt(8.0 * radius * SAGITTA))
        count = max(math.ceil(length / chord), math.ceil(abs(turn) / CHORD_TURN), 3)
        count = max(1, min(count, int(length / SHORTEST_CHORD)))
        share = np.arange(1, count) / count
        points = start + share[:, None] * (end - start)
        reach = radius + share * (math.hypot(*to_end) - radius)
        points[:, plane[0]] = middle[0] + reach * np.cos(begin + share * turn)
        points[:, plane[1]] = middle[1] + reach * np.sin(begin + share * turn)
        return points
