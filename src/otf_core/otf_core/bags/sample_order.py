# SPDX-License-Identifier: Apache-2.0
"""Recorded points to samples with strictly increasing stamps, or a reason why that fails.

Transport may swap, repeat and delay messages; the tracker's own stamp says what was measured when.
What transport explains is repaired with a remark, and points that are no measurements are left out
(``screening``). A clock that begins again is continued where the target shows it (``reception``).
What none explains (two trackers on one topic, several runs, no stamps) is an error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.clock import MAX_OFF_NS, of_one_clock
from otf_core.bags.reception import check_order, continued
from otf_core.bags.screening import MAX_RANGE, MixedSamples, Screening
from otf_core.bags.stamp_words import stamp_words
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath

MAX_CONFLICTS = 1e-3
"""Share of samples that may repeat a stamp with another point; they are dropped."""


def in_time_order(
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
    stamp_ns = continued(stamp_ns, xyz, remarks)
    kept = of_one_clock(stamp_ns, screening.off)
    return (stamp_ns, xyz) if kept is None else (stamp_ns[kept], xyz[kept])


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
        raise MixedSamples(
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
