# SPDX-License-Identifier: Apache-2.0
"""Single wrong stamps, told from a clock that was set and from another tracker's clock.

A stamp that is off is held until it is known what follows. If the clock before goes on, what is
held was wrong and is left out; if the held clock goes on, it is a pause where it is ahead, and
another recording where it is behind.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

MAX_OFF_NS = 1_000_000_000
"""ns; stamps that are off by more are no matter of transport."""
FEW = 5
"""Samples in a row whose stamps are off so that they are no accident any more."""
T = TypeVar('T')


class Clock(Generic[T]):
    """The clock of the samples that arrive.

    Parameters
    ----------
    left_out : callable
        Told the stamps that turned out to be wrong, ns, and the newest that is right.

    Attributes
    ----------
    newest_ns : int or None
        Newest stamp of the clock.
    held : list of (int, T)
        Stamps that are off, and what they belong to.
    """

    def __init__(self, left_out: Callable[[list[int], int], None]) -> None:
        self._left_out = left_out
        self.newest_ns: int | None = None
        self.held: list[tuple[int, T]] = []

    @property
    def off_ns(self) -> int:
        """How far the first one held is ahead of the newest; negative: behind; 0 without any."""
        if not self.held or self.newest_ns is None:
            return 0
        return self.held[0][0] - self.newest_ns

    @property
    def persists(self) -> bool:
        """Whether what is held is no accident."""
        return len(self.held) >= FEW

    def take(self, stamp_ns: int, item: T, back_ns: int = MAX_OFF_NS) -> bool:
        """Tell whether a stamp goes on with the clock; it is held if it does not.

        Parameters
        ----------
        stamp_ns : int
        item : T
            What it belongs to.
        back_ns : int
            ns; it may go back by so much.
        """
        if self.held and not self._follows_held(stamp_ns):
            self.drop()
        newest = self.newest_ns
        if not self.held and (newest is None or -back_ns <= stamp_ns - newest <= MAX_OFF_NS):
            self.newest_ns = stamp_ns if newest is None else max(newest, stamp_ns)
            return True
        self.held.append((stamp_ns, item))
        return False

    def drop(self) -> None:
        """Leave out what is held."""
        if self.held and self.newest_ns is not None:
            self._left_out([stamp for stamp, _ in self.held], self.newest_ns)
        self.held = []

    def release(self) -> list[tuple[int, T]]:
        """Return what is held; the clock is now that of it."""
        held, self.held = self.held, []
        self.newest_ns = max(stamp for stamp, _ in held)
        return held

    def _follows_held(self, stamp_ns: int) -> bool:
        since_held = stamp_ns - self.held[-1][0]
        if abs(since_held) <= MAX_OFF_NS:
            return True
        ahead, first = self.off_ns > 0, self.held[0][0]
        return since_held > 0 and (ahead or stamp_ns < first - self.off_ns - MAX_OFF_NS)


def of_one_clock(
    stamp_ns: NDArray[np.int64], left_out: Callable[[list[int], int], None]
) -> NDArray[np.int64] | None:
    """Tell which samples go on with one clock; None: all of them.

    A clock that is behind at the end is not left out unless it is of a few samples; if only a few
    came before, those are.

    Parameters
    ----------
    stamp_ns : ndarray of int64, shape (n,), ns
        In the order of reception.
    left_out : callable
        See ``Clock``.

    Returns
    -------
    ndarray of int64, shape (k,), or None
        Indices, increasing.
    """
    if not np.any(np.maximum.accumulate(stamp_ns) - stamp_ns > MAX_OFF_NS):
        return None
    clock: Clock[int] = Clock(left_out)
    kept: list[int] = []
    for i, stamp in enumerate(stamp_ns.tolist()):
        if clock.take(stamp, i):
            kept.append(i)
        elif clock.persists and clock.off_ns > 0:
            kept += [at for _, at in clock.release()]
    if clock.persists and len(kept) < FEW:
        left_out(stamp_ns[kept].tolist(), clock.held[-1][0])
        kept = []
    if clock.persists or clock.off_ns > 0:
        kept += [at for _, at in clock.release()]
    clock.drop()
    return np.array(kept, np.int64)
