# SPDX-License-Identifier: Apache-2.0
"""Measured track and nominal curve by their arc lengths, and the order in which one follows the other.

No times are needed: what the reflector has travelled says how far the path is driven, within the
errors of its place, and a monotone assignment of places to places (dynamic time warping) corrects
that once the pose of the tracker is roughly known.
"""  # noqa: E501

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.model.observation import Samples
from otf_core.tracking.curves import Lines

PERIOD = 0.02
"""s; samples are averaged over this time before the arc length is taken."""
LEAST_MOVE = 2e-4
"""m; less is noise and standstill."""
STEP, MOST = 2e-3, 20_000
"""m between places that are assigned to each other, and their largest number."""
GAP = 0.3
"""s without a sample; what happened then is not known."""
LATE = 0.05
"""Price of one step more or less on the curve than on the track, in squared steps."""
LONGEST = 3
"""Steps on the curve that one step on the track may take."""


@dataclass(frozen=True)
class TravelledTrack:
    """Where the reflector was, by the arc length that it has travelled.

    Attributes
    ----------
    xyz : ndarray, shape (k, 3), m
        Tracker frame.
    time : ndarray, shape (k,), s
        Since the first sample of the recording.
    reach : ndarray, shape (k,), m
        Arc length, ascending.
    """

    xyz: Array
    time: Array
    reach: Array

    @classmethod
    def of(cls, samples: Samples, first: int, last: int) -> TravelledTrack:
        """Track of the samples from one up to another."""
        every = max(1, round(PERIOD / max(samples.step, 1e-6)))
        count = (last - first) // every
        xyz = samples.xyz[first : first + count * every].reshape(count, every, 3).mean(axis=1)
        time = samples.time[first : first + count * every].reshape(count, every).mean(axis=1)
        selected = np.append(0, _moved(xyz, xyz[0]))
        reach = np.linalg.norm(np.diff(xyz[selected], axis=0), axis=1).cumsum()
        return cls(xyz[selected], time[selected], np.append(0.0, reach))

    @property
    def length(self) -> float:
        """Arc length, m."""
        return float(self.reach[-1])

    def resampled(self, step: float) -> TravelledTrack:
        """The same at equal steps of arc length."""
        reach = np.arange(0.0, self.length + 0.5 * step, step)
        xyz = np.stack([np.interp(reach, self.reach, own) for own in self.xyz.T], axis=1)
        return TravelledTrack(xyz, np.interp(reach, self.reach, self.time), reach)


def _moved(xyz: Array, last: Array) -> Index:
    """Points (k,) that are ``LEAST_MOVE`` away from the one before among them, first ``last``."""
    selected = []
    for k, point in enumerate(xyz):
        away = point - last
        if away @ away > LEAST_MOVE**2:
            selected.append(k)
            last = point
    return np.array(selected, dtype=np.int64)


class GrowingLength:
    """Arc length of a track that gets longer; only new samples are looked at.

    Attributes
    ----------
    first : int
        Sample at which the track begins.
    counted : int
        Samples up to the last that is in the length.
    """

    def __init__(self, first: int, step: float) -> None:
        self.first = self.counted = first
        self._every = max(1, round(PERIOD / max(step, 1e-6)))
        self._last: Array | None = None
        self._length = 0.0

    def up_to(self, samples: Samples) -> float:
        """Arc length up to the last sample, as ``TravelledTrack.of`` has it, m.

        Parameters
        ----------
        samples : Samples
            All from the beginning of the recording; those before ``counted`` as before.
        """
        count = max(0, len(samples) - self.counted) // self._every
        if count:
            new = samples.xyz[self.counted : self.counted + count * self._every]
            xyz = new.reshape(count, self._every, 3).mean(axis=1)
            last = xyz[0] if self._last is None else self._last
            points = np.concatenate([last[None], xyz[_moved(xyz, last)]])
            self._length += float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            self._last = points[-1]
            self.counted += count * self._every
        return self._length


def by_length(track: TravelledTrack, length: float) -> Array:
    """Arc length on a curve of every place of a track that ends where the curve does, (k,)."""
    share = length / max(track.length, 1e-9)
    return track.reach * (share if 0.9 < share < 1.1 else 1.0)


def assign_places(
    track: TravelledTrack, curve: Lines, points: Array, band: float, start: Array
) -> Array:
    """Assign places of a track to places of a curve, in order.

    Parameters
    ----------
    points : ndarray, shape (k, 3), m
        Places of the track in the frame of the curve.
    band : float
        m; arc length within which of ``start`` the answer lies.
    start : ndarray, shape (k,), m
        Arc length on the curve that is expected.

    Returns
    -------
    ndarray, shape (k,), m
        Arc length on the curve of every place of the track.
    """
    step = float(np.median(np.diff(track.reach))) if len(track.reach) > 1 else STEP
    length = float(curve.run[-1])
    nodes = np.arange(0.0, length + 0.5 * step, step)
    at = curve.at(*curve.chord_at(nodes)[::-1])
    width = 2 * int(np.ceil(band / step)) + 1
    low = np.clip(
        np.rint(start / step).astype(np.int64) - width // 2, 0, max(0, len(nodes) - width)
    )
    low = np.maximum.accumulate(low)
    width = min(width, len(nodes))
    jump = np.append(False, np.diff(track.time) > GAP)
    price = LATE * step**2 * (np.arange(LONGEST + 1) - 1.0) ** 2
    inner = np.arange(width)
    choice = np.zeros((len(points), width), dtype=np.int32)
    # squared distances less that of the point from the origin, which does not decide anything
    square, twice = np.einsum('ij,ij->i', at, at), -2.0 * at
    before, options = np.empty(width + LONGEST), np.empty((LONGEST + 1, width))
    best, last = np.zeros(width), int(low[0])
    for k, (first, point) in enumerate(zip(low.tolist(), points, strict=True)):
        cost = twice[first : first + width] @ point
        cost += square[first : first + width]
        shift, last = first - last, first
        if k == 0:
            best, choice[0] = cost, inner
            continue
        before.fill(np.inf)
        if shift < width:
            before[LONGEST : LONGEST + width - shift] = best[shift:]
            # what lies below the window now may still move into it
            for d in range(1, min(LONGEST, shift) + 1):
                before[LONGEST - d] = best[shift - d]
        if jump[k]:
            lowest = np.minimum.accumulate(before)
            total = lowest[LONGEST:]
            marks = np.where(before == lowest, np.arange(len(before)), 0)
            origin = np.maximum.accumulate(marks)[LONGEST:] - LONGEST
        else:
            for d in range(LONGEST + 1):
                np.add(before[LONGEST - d : LONGEST - d + width], price[d], out=options[d])
            pick = options.argmin(axis=0)
            total = options[pick, inner]
            origin = inner - pick
        choice[k] = origin + shift  # place in the window before
        best = total + cost
        if best[best.argmin()] == np.inf:
            best = cost
            choice[k] = np.clip(inner + shift - 1, 0, width - 1)
    nearest = np.empty(len(points), dtype=np.int64)
    j, most = int(np.argmin(best)), width - 1
    for k in range(len(points) - 1, -1, -1):
        nearest[k] = low[k] + j
        j = min(max(int(choice[k, j]), 0), most)
    return np.asarray(np.minimum(nodes[nearest], length))
