# SPDX-License-Identifier: Apache-2.0
"""Order of reception against order of stamps: which of the two is that of the motion.

Transport swaps messages: then the target moves smoothly in the order of the stamps. Where it moves
smoothly in the order of reception, and to and fro once sorted, the stamps are wrong. A counter
that wraps and a clock that was set back are continued; what else they may be is refused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.bags.clock import FEW, MAX_OFF_NS
from otf_core.errors import InputError

Stamps = NDArray[np.int64]

S, MS, US = 1_000_000_000, 1_000_000, 1_000
PERIODS = {
    'the part of a second alone': S,
    'the seconds of a minute alone': 60 * S,
    'minutes and seconds without the hour': 3600 * S,
    'a clock of 12 hours without AM and PM': 43_200 * S,
    'a time of day': 86_400 * S,
    'a time of the week': 604_800 * S,
    'a counter of 2^16 ms': (MS << 16),
    'a counter of 2^16 us': (US << 16),
    'a counter of 2^32 ms': (MS << 32),
    'a counter of 2^32 us': (US << 32),
    'a counter of 2^32 ns': (1 << 32),
    'a counter of 2^31 ms': (MS << 31),
    'a counter of 2^31 us': (US << 31),
    'a counter of 2^31 ns': (1 << 31),
}
"""After how long clocks and counters begin again, ns."""
LARGEST_GAP = 0.1
"""Share of its period that a counter may leave out where it begins again."""
TO_AND_FRO = 1.5
"""Ratio of the ways of the target in two orders from which on one of them is none of a motion."""
LONGEST_STEP, SMALL = 3.0, 0.2
"""A target that goes on moves no farther than so many of its usual steps; that has to be a small
share of its range, else there is no telling."""
STANDING = 1e-4
"""m; steps up to this are no motion."""
WRONG_STAMPS = (
    'the target moves smoothly in the order in which the samples were received, and to and fro '
    'once they are sorted by stamp: the stamps are wrong (seconds and parts of a second joined '
    'without leading zeros, a part of the time left out?); correct them where they are made'
)


def continued(stamp_ns: Stamps, xyz: Array, remarks: list[str]) -> Stamps:
    """Continue stamps where their clock began again or was set back while the target went on.

    Parameters
    ----------
    stamp_ns : ndarray of int64, shape (n,), ns
        In the order of reception.
    xyz : ndarray, shape (n, 3), m
    remarks : list of str
        Filled with what was done.

    Returns
    -------
    ndarray of int64, shape (n,), ns
        As it was where nothing explains that it goes back.
    """
    step = np.diff(stamp_ns)
    seams = _seams(stamp_ns, step)
    if not seams.size:
        return stamp_ns
    ahead = step[step > 0]
    usual = int(np.median(ahead)) if ahead.size else 0
    if usual <= 0:
        return stamp_ns
    for what, period in sorted(PERIODS.items(), key=lambda item: item[1]):
        gaps = step[seams] + period
        if np.all(gaps > 0) and np.all(gaps <= max(LARGEST_GAP * period, usual)):
            if not _smooth(xyz, seams):
                return stamp_ns
            remarks.append(
                f'stamps go back {seams.size} times by about {1e-9 * period:.9g} s, first at '
                f'sample {seams[0] + 1}, as {what} does; they are continued'
            )
            return _shifted(stamp_ns, seams, np.full(seams.size, period, np.int64))
    if step[seams].max() >= -MAX_OFF_NS or not _smooth(xyz, seams):
        return stamp_ns
    back = ', '.join(f'{-1e-9 * step[i]:.3f} s at sample {i + 1}' for i in seams[:3])
    remarks.append(
        f'stamps go back by {back}, but the target goes on from where it was: the clock was set '
        f'back; they are continued with the usual step of {1e-6 * usual:.6g} ms'
    )
    return _shifted(stamp_ns, seams, usual - step[seams])


def check_order(where: str, order: NDArray[np.int64], xyz: Array) -> None:
    """Refuse to sort samples where that makes a smooth motion go to and fro.

    Parameters
    ----------
    where : str
        For the message.
    order : ndarray of int64, shape (n,)
        Samples in the order of their stamps.
    xyz : ndarray, shape (n, 3), m
        In the order of reception.
    """
    moved = order != np.arange(len(order))
    near = moved[1:] | moved[:-1]
    received = np.linalg.norm(np.diff(xyz, axis=0), axis=1)[near].sum()
    by_stamp = np.linalg.norm(np.diff(xyz[order], axis=0), axis=1)[near].sum()
    if by_stamp > TO_AND_FRO * received and by_stamp - received > STANDING:
        raise InputError(f'{where}: {WRONG_STAMPS}')


def _seams(stamp_ns: Stamps, step: NDArray[np.int64]) -> NDArray[np.int64]:
    """Samples after which a good clock goes on from an earlier time, and is good again."""
    back = np.flatnonzero(step < 0)
    if not back.size or back.size > len(stamp_ns) // (2 * FEW):
        return np.empty(0, np.int64)
    beside = back[:, None] + np.r_[-FEW:0, 1 : FEW + 1]
    inside = (beside >= 0) & (beside < len(step))
    near = step[np.clip(beside, 0, len(step) - 1)]
    clean = (near >= 0) & (near <= MAX_OFF_NS)
    return np.asarray(back[np.all(clean | ~inside, axis=1)])


def _smooth(xyz: Array, seams: NDArray[np.int64]) -> bool:
    """Tell whether the target goes on at seams from where it was."""
    step = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    near = max(LONGEST_STEP * float(np.percentile(step, 90)), STANDING)
    if near > SMALL * float(np.ptp(xyz, axis=0).max()):
        return False
    return bool(np.all(step[seams] <= near))


def _shifted(stamp_ns: Stamps, seams: NDArray[np.int64], by: NDArray[np.int64]) -> Stamps:
    shift = np.zeros(len(stamp_ns), np.int64)
    shift[seams + 1] = by
    return np.asarray(stamp_ns + np.cumsum(shift))
