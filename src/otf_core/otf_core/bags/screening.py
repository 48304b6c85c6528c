# SPDX-License-Identifier: Apache-2.0
"""Which points are measurements, and what is said of the others; recorded and live alike.

Single bad points are left out and counted, whatever they are: no run is lost for them. Where there
are too many, they are no accident, and the run is refused with the cause.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.cdr import frame_shown, frame_text
from otf_core.bags.clock import MAX_OFF_NS
from otf_core.bags.topics import POINT
from otf_core.errors import InputError

MAX_RANGE = 1000.0
"""m; beyond the reach of any laser tracker, so the unit is wrong or the data are damaged."""
MAX_NO_MEASUREMENT = 0.5
"""Share of points without a measurement, as trackers give them while the beam is broken (in their
origin, or not finite), and of points in another frame, up to which they are left out."""
MAX_FAR = 0.01
"""The same for points out of reach, and for points whose stamps are off."""
NO_BEAM, NOT_FINITE, FAR, FOREIGN, OFF = range(1, 6)
WORDS = {
    NO_BEAM: 'in the origin of the tracker (no beam)',
    NOT_FINITE: 'that are not finite',
    FAR: f'beyond {MAX_RANGE:g} m',
    FOREIGN: 'in another frame',
    OFF: f'whose stamps are off by more than {1e-9 * MAX_OFF_NS:g} s',
}


class MixedSamples(InputError):
    """Stamps of several clocks: of publishers, runs, or one that was set back."""


def judged(xyz: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Tell what is wrong with points; 0: nothing.

    Parameters
    ----------
    xyz : ndarray, shape (n, 3), m

    Returns
    -------
    ndarray of uint8, shape (n,)
        ``NO_BEAM``, ``NOT_FINITE``, ``FAR`` or 0.
    """
    found = np.zeros(len(xyz), np.uint8)
    with np.errstate(invalid='ignore'):  # signalling nan
        x, y, z = xyz.T
        found[(x == 0) & (y == 0) & (z == 0)] = NO_BEAM
        if not (xyz.max(initial=0.0) < MAX_RANGE and xyz.min(initial=0.0) > -MAX_RANGE):
            reach = np.abs(xyz).max(axis=1, initial=0.0)
            found[~(reach < MAX_RANGE)] = FAR
            found[~np.isfinite(reach)] = NOT_FINITE
    return found


class Screening:
    """Leaves out what is no measurement, and counts it.

    Attributes
    ----------
    total : int
        Points looked at.
    """

    def __init__(self) -> None:
        self.total = 0
        self._count: Counter[int] = Counter()
        self._first: dict[int, str] = {}
        self._frames: Counter[str] = Counter()
        self._start_ns: int | None = None

    @property
    def left_out(self) -> int:
        """Points left out so far."""
        return sum(self._count.values())

    def foreign(self, frames: Counter[str]) -> None:
        """Count points that were left out because of their frames."""
        self._frames.update(frames)
        self._count[FOREIGN] += frames.total()
        self.total += frames.total()

    def off(self, stamps_ns: list[int], newest_ns: int) -> None:
        """Count points that were left out because of their stamps; looked at they have been."""
        first = f'stamped {1e-9 * stamps_ns[0]:.6f} s, after {1e-9 * newest_ns:.6f} s'
        self._first.setdefault(OFF, first)
        self._count[OFF] += len(stamps_ns)

    def good(
        self, stamp_ns: NDArray[np.int64], xyz: NDArray[np.float64]
    ) -> NDArray[np.bool_] | None:
        """Tell which points are measurements; None: all of them.

        Parameters
        ----------
        stamp_ns : ndarray of int64, shape (n,), ns
        xyz : ndarray of float64, shape (n, 3), m
        """
        found, before = judged(xyz), self.total - self._count[FOREIGN]
        self.total += len(xyz)
        if self._start_ns is None and len(xyz):
            self._start_ns = int(stamp_ns[0])
        if not found.any():
            return None
        for kind in (NO_BEAM, NOT_FINITE, FAR):
            (at,) = np.nonzero(found == kind)
            if at.size:
                i = int(at[0])
                seconds = (int(stamp_ns[i]) - (self._start_ns or 0)) * 1e-9
                first = f'sample {before + i}, {seconds:.6f} s after the start: {xyz[i].tolist()}'
                self._first.setdefault(kind, first)
                self._count[kind] += at.size
        return np.asarray(found == 0)

    def remarks(self) -> list[str]:
        """What was left out, in words."""
        said = []
        for kind, count in sorted(self._count.items()):
            if not count:
                continue
            first = f'the first is {self._first[kind]}' if kind in self._first else self._shown()
            said.append(f'dropped {count} of {self.total} points {WORDS[kind]}; {first}')
        return said

    def check(self, where: str) -> None:
        """Raise InputError where so much was left out that it is no accident."""
        count, total = self._count, self.total
        if count[FOREIGN] > MAX_NO_MEASUREMENT * total:
            text = frame_text(f'{count[FOREIGN]} of {total} points', self._most(), POINT.frame)
            raise InputError(f'{where}: {text}')
        if count[OFF] > MAX_FAR * total:
            raise MixedSamples(
                f'{where}: header.stamp of {count[OFF]} of {total} points is off by more than '
                f'{1e-9 * MAX_OFF_NS:g} s, the first is {self._first[OFF]}; the clock was set '
                f'back or several runs or trackers are mixed; record each in its own bag'
            )
        if count[FAR] > MAX_FAR * total:
            raise InputError(self._unusable(where, FAR, f'beyond {MAX_RANGE:g} m; the unit is m'))
        if count[NOT_FINITE] > MAX_NO_MEASUREMENT * total:
            why = 'not finite; do not publish points without a valid measurement'
            raise InputError(self._unusable(where, NOT_FINITE, why))
        if count[NO_BEAM] > MAX_NO_MEASUREMENT * total:
            raise InputError(
                f'{where}: {count[NO_BEAM]} of {total} points lie in the origin of the tracker, '
                f'as if the beam had been broken for most of the time; check target and tracker'
            )

    def _unusable(self, where: str, kind: int, why: str) -> str:
        return (
            f'{where}: {self._count[kind]} of {self.total} points are unusable; the first is '
            f'{self._first[kind]} is {why}'
        )

    def _most(self) -> str:
        return self._frames.most_common(1)[0][0]

    def _shown(self) -> str:
        named = ', '.join(frame_shown(name) for name, _ in self._frames.most_common(3))
        return f"their frame_id is {named}, expected '{POINT.frame}'"
