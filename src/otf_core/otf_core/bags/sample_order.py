# SPDX-License-Identifier: Apache-2.0
"""Recorded points to samples with strictly increasing stamps, or the reason why that fails."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.bags.cdr import frame_shown, frame_text
from otf_core.bags.rosbag2_metadata import POINT
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath

# Single wrong stamps, told from a clock that was set and from another tracker's clock.
#
# A stamp that is off is held until it is known what follows. If the clock before goes on, what is
# held was wrong and is left out; if the held clock goes on, it is a pause where it is ahead, and
# another recording where it is behind.

MAX_OFF_NS = 1_000_000_000
"""ns; stamps that are off by more are no matter of transport."""
CLOCK_CHANGE_SAMPLES = 5
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
        return len(self.held) >= CLOCK_CHANGE_SAMPLES

    def take(self, stamp_ns: int, item: T) -> bool:
        """Return whether a stamp of an item goes on with the clock; it is held if it does not."""
        if self.held and not self._follows_held(stamp_ns):
            self.drop()
        newest = self.newest_ns
        if not self.held and (newest is None or abs(stamp_ns - newest) <= MAX_OFF_NS):
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
    """Determine which samples go on with one clock; None: all of them.

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
    rows: list[int] = []
    for i, stamp in enumerate(stamp_ns.tolist()):
        if clock.take(stamp, i):
            rows.append(i)
        elif clock.persists and clock.off_ns > 0:
            rows += [at for _, at in clock.release()]
    if clock.persists and len(rows) < CLOCK_CHANGE_SAMPLES:
        left_out(stamp_ns[rows].tolist(), clock.held[-1][0])
        rows = []
    if clock.persists or clock.off_ns > 0:
        rows += [at for _, at in clock.release()]
    clock.drop()
    return np.array(rows, np.int64)


# How stamps that repeat were made.

REPEATED_SHARE = 0.5
"""Share of repeated stamps from which on they tell how the stamps are made."""


def stamp_words(stamp_ns: NDArray[np.int64]) -> str:
    """State how stamps that repeat were made, as far as they show it.

    Parameters
    ----------
    stamp_ns : ndarray of int64, shape (n,), ns
        Ascending.

    Returns
    -------
    str
        Begins with a verb; empty if they do not repeat.
    """
    count = len(stamp_ns)
    different, size = np.unique(stamp_ns, return_counts=True)
    if len(different) == count:
        return ''
    if len(different) == 1:
        return (
            'are all equal: the driver stamps the whole stream once; it has to give every '
            'sample its own time of measurement'
        )
    block = float(np.median(size))
    if count - len(different) > REPEATED_SHARE * count:
        return (
            f'repeat in blocks of about {block:.0f} samples: the driver stamps packets, not '
            f'samples; it has to give every sample its own time of measurement'
        )
    return (
        'are given to different points: their resolution is too coarse, or two trackers publish '
        'on one topic'
    )


# Order of reception against order of stamps: which of the two is that of the motion.
#
# Transport swaps messages: then the target moves smoothly in the order of the stamps. Where it
# moves smoothly in the order of reception, and to and fro once sorted, the stamps are wrong. A
# counter that wraps and a clock that was set back are continued; what else they may be is refused.

Stamps = NDArray[np.int64]

S, MS, US = 1_000_000_000, 1_000_000, 1_000
PERIODS = {
    'the part of a second alone': S,
    'the seconds of a minute alone': 60 * S,
    'minutes and seconds without the hour': 3600 * S,
    'a 12-hour clock without AM and PM': 43_200 * S,
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
WAY_RATIO = 1.5
"""Ratio of the ways of the target in two orders from which on one of them is none of a motion."""
LONGEST_STEP, SMALL = 3.0, 0.2
"""A target that goes on moves no farther than so many of its usual steps; that has to be a small
share of its range, else there is no telling."""
MOTION_STEP = 1e-4
"""m; steps up to this are no motion."""
WRONG_STAMPS = (
    'the target moves smoothly in the order in which the samples were received, but back and '
    'forth when sorted by stamp: the stamps are wrong'
    ' (seconds and parts of a second joined '
    'without leading zeros, a part of the time left out?); correct them at the source'
)


def continue_stamps(stamp_ns: Stamps, xyz: Array, remarks: list[str]) -> Stamps:
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
        f'stamps go back by {back}, but the target continues from where it was: the clock was set '
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
    if by_stamp > WAY_RATIO * received and by_stamp - received > MOTION_STEP:
        raise InputError(f'{where}: {WRONG_STAMPS}')


def _seams(stamp_ns: Stamps, step: NDArray[np.int64]) -> NDArray[np.int64]:
    """Samples after which a good clock goes on from an earlier time, and is good again."""
    back = np.flatnonzero(step < 0)
    if not back.size or back.size > len(stamp_ns) // (2 * CLOCK_CHANGE_SAMPLES):
        return np.empty(0, np.int64)
    beside = back[:, None] + np.r_[-CLOCK_CHANGE_SAMPLES:0, 1 : CLOCK_CHANGE_SAMPLES + 1]
    inside = (beside >= 0) & (beside < len(step))
    near = step[np.clip(beside, 0, len(step) - 1)]
    clean = (near >= 0) & (near <= MAX_OFF_NS)
    return np.asarray(back[np.all(clean | ~inside, axis=1)])


def _smooth(xyz: Array, seams: NDArray[np.int64]) -> bool:
    """Return whether the target goes on at seams from where it was."""
    step = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    near = max(LONGEST_STEP * float(np.percentile(step, 90)), MOTION_STEP)
    if near > SMALL * float(np.ptp(xyz, axis=0).max()):
        return False
    return bool(np.all(step[seams] <= near))


def _shifted(stamp_ns: Stamps, seams: NDArray[np.int64], by: NDArray[np.int64]) -> Stamps:
    shift = np.zeros(len(stamp_ns), np.int64)
    shift[seams + 1] = by
    return np.asarray(stamp_ns + np.cumsum(shift))


# Which points are measurements, and how the others are reported; recorded and live alike.
#
# Single bad points are left out and counted, whatever they are: no run is lost for them. Where
# there are too many, they are no accident, and the run is refused with the cause.

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


def screen_points(xyz: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Determine what is wrong with points; 0: nothing.

    Parameters
    ----------
    xyz : ndarray, shape (n, 3), m

    Returns
    -------
    ndarray of uint8, shape (n,)
        ``NO_BEAM``, ``NOT_FINITE``, ``FAR`` or 0.
    """
    kinds = np.zeros(len(xyz), np.uint8)
    with np.errstate(invalid='ignore'):  # signalling nan
        x, y, z = xyz.T
        kinds[(x == 0) & (y == 0) & (z == 0)] = NO_BEAM
        if not (xyz.max(initial=0.0) < MAX_RANGE and xyz.min(initial=0.0) > -MAX_RANGE):
            reach = np.abs(xyz).max(axis=1, initial=0.0)
            kinds[~(reach < MAX_RANGE)] = FAR
            kinds[~np.isfinite(reach)] = NOT_FINITE
    return kinds


class Screening:
    """Leaves out what is not a measurement, and counts it.

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
        """Determine which points are measurements; None: all of them.

        Parameters
        ----------
        stamp_ns : ndarray of int64, shape (n,), ns
        xyz : ndarray of float64, shape (n, 3), m
        """
        kinds, before = screen_points(xyz), self.total - self._count[FOREIGN]
        self.total += len(xyz)
        if self._start_ns is None and len(xyz):
            self._start_ns = int(stamp_ns[0])
        if not kinds.any():
            return None
        for kind in (NO_BEAM, NOT_FINITE, FAR):
            (at,) = np.nonzero(kinds == kind)
            if at.size:
                i = int(at[0])
                seconds = (int(stamp_ns[i]) - (self._start_ns or 0)) * 1e-9
                first = f'sample {before + i}, {seconds:.6f} s after the start: {xyz[i].tolist()}'
                self._first.setdefault(kind, first)
                self._count[kind] += at.size
        return np.asarray(kinds == 0)

    def remarks(self) -> list[str]:
        """What was left out, in words."""
        lines = []
        for kind, count in sorted(self._count.items()):
            if not count:
                continue
            first = f'the first is {self._first[kind]}' if kind in self._first else self._shown()
            lines.append(f'dropped {count} of {self.total} points {WORDS[kind]}; {first}')
        return lines

    def check(self, where: str) -> None:
        """Raise InputError where so much was left out that it is no accident."""
        count, total = self._count, self.total
        if count[FOREIGN] > MAX_NO_MEASUREMENT * total:
            text = frame_text(f'{count[FOREIGN]} of {total} points', self._most(), POINT.frame)
            raise InputError(f'{where}: {text}')
        if count[OFF] > MAX_FAR * total:
            raise InputError(
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
                f'as if the beam had been broken most of the time; check target and tracker'
            )

    def _unusable(self, where: str, kind: int, why: str) -> str:
        return (
            f'{where}: {self._count[kind]} of {self.total} points are unusable; the first, '
            f'{self._first[kind]}, is {why}'
        )

    def _most(self) -> str:
        return self._frames.most_common(1)[0][0]

    def _shown(self) -> str:
        named = ', '.join(frame_shown(name) for name, _ in self._frames.most_common(3))
        return f"their frame_id is {named}, expected '{POINT.frame}'"


# Recorded points to samples with strictly increasing stamps, or a reason why that fails.
#
# Transport may swap, repeat and delay messages; the tracker's own stamp says what was measured
# when. What transport explains is repaired with a remark, and points that are not measurements are
# left out (``screening``). A clock that begins again is continued where the target shows it
# (``reception``). What none explains (two trackers on one topic, several runs, no stamps) is an
# error.

MAX_CONFLICTS = 1e-3
"""Share of samples that may repeat a stamp with another point; they are dropped."""


def sort_by_time(
    where: str,
    stamp_ns: NDArray[np.int64],
    xyz: NDArray[np.float64],
    remarks: list[str] | None = None,
    screening: Screening | None = None,
) -> Samples:
    """Return samples with strictly increasing stamps.

    Points out of order by up to 1 s are sorted by stamp (stable), exact repetitions are dropped,
    and so are a second point of the same stamp if that is rare (0.1 %), and points that are no
    measurements or whose stamps are off (``clock``) unless they are too many; each with a remark.
    A counter that wraps or a clock that is set back is continued where the target goes on.

    Parameters
    ----------
    where : str
        Begins every message: the bag and the topic.
    stamp_ns : ndarray of int64, shape (n,), ns
        Measurement times in the order of reception.
    xyz : ndarray of float64, shape (n, 3), m
    remarks : list of str, optional
        Filled with what was left out or put in order.
    screening : Screening, optional
        What has been left out before.

    Raises
    ------
    InputError
        No points or one only, coordinates that no tracker measures, hardly any beam, stamps not
        set, stamps that go back by more than 1 s, different points with the same stamp in many
        places, or stamps by which a smooth motion goes to and fro.
    """
    remarks = [] if remarks is None else remarks
    screening = screening or Screening()
    if stamp_ns.any():
        stamp_ns, xyz = _screened(stamp_ns, xyz, screening, remarks)
    screening.check(where)
    if not stamp_ns.size:
        raise InputError(f'{where}: no points; was the tracker measuring while it was recorded?')
    if stamp_ns.size == 1:
        raise InputError(
            f'{where}: one sample only; was the tracker measuring while it was recorded?'
        )
    if not stamp_ns.any():
        raise InputError(
            f'{where}: header.stamp is not set (all {stamp_ns.size} are zero); '
            f'the driver has to fill in the time of measurement'
        )
    remarks += screening.remarks()
    if np.all(stamp_ns[1:] > stamp_ns[:-1]):
        return Samples(stamp_ns, xyz)
    _check_steps(where, stamp_ns)
    if np.any(np.diff(stamp_ns) < 0):
        late = int(np.count_nonzero(np.diff(stamp_ns) < 0))
        order = np.argsort(stamp_ns, kind='stable')
        check_order(where, order, xyz)
        remarks.append(f'stamps went back {late} times, sorted by stamp')
        stamp_ns, xyz = stamp_ns[order], xyz[order]
    return _without_repetitions(where, stamp_ns, xyz, remarks)


def _screened(
    stamp_ns: NDArray[np.int64],
    xyz: NDArray[np.float64],
    screening: Screening,
    remarks: list[str],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    good = screening.good(stamp_ns, xyz)
    if good is not None:
        stamp_ns, xyz = stamp_ns[good], xyz[good]
    stamp_ns = continue_stamps(stamp_ns, xyz, remarks)
    rows = of_one_clock(stamp_ns, screening.off)
    return (stamp_ns, xyz) if rows is None else (stamp_ns[rows], xyz[rows])


def usable_path(where: str, points: NDArray[np.float64]) -> NominalPath:
    """Return the path through points, shape (n, 3), m; InputError if it is none."""
    with np.errstate(invalid='ignore'):
        far = np.any(np.abs(points) > MAX_RANGE, axis=1)
    if far.any():
        i = int(np.argmax(far))
        raise InputError(
            f'{where}: point {i}, {points[i].tolist()}, is beyond {MAX_RANGE:g} m; the unit is m'
        )
    try:
        return NominalPath(points)
    except InputError as error:
        raise InputError(f'{where}: {error}') from None


def _check_steps(where: str, stamp_ns: NDArray[np.int64]) -> None:
    back = np.maximum.accumulate(stamp_ns) - stamp_ns
    if back.max() > MAX_OFF_NS:
        i = int(np.argmax(back > MAX_OFF_NS))
        raise InputError(
            f'{where}: header.stamp goes back by {back[i] * 1e-9:.3f} s at sample {i}; the clock '
            f'was set back or several runs or trackers are mixed; record each in its own bag'
        )


def _without_repetitions(
    where: str, stamp_ns: NDArray[np.int64], xyz: NDArray[np.float64], remarks: list[str]
) -> Samples:
    again = np.diff(stamp_ns) == 0
    if not again.any():
        return Samples(stamp_ns, xyz)
    keep = np.concatenate([[True], ~again])
    first = xyz[np.maximum.accumulate(np.where(keep, np.arange(keep.size), 0))]
    conflict = np.any(first != xyz, axis=1)
    conflicts = int(np.count_nonzero(conflict))
    if conflicts > MAX_CONFLICTS * keep.size:
        i = int(np.argmax(conflict))
        raise InputError(
            f'{where}: {conflicts} of {keep.size} samples have the stamp of another point, the '
            f'first is sample {i} with stamp {stamp_ns[i]} ns; the stamps {stamp_words(stamp_ns)}'
        )
    repeated = int(np.count_nonzero(~keep)) - conflicts
    remarks.append(
        f'dropped {repeated} repeated samples and {conflicts} with the stamp of another point'
    )
    return Samples(stamp_ns[keep], xyz[keep])
