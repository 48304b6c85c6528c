# SPDX-License-Identifier: Apache-2.0
"""Samples of several publishers on one topic, and those of one of them.

They are told apart by what the recording keeps of them: channels of an MCAP file, else the clocks
of their stamps where these lie more than 1 s apart, else the places of two targets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.bag_reading import Reading, Received
from otf_core.bags.clock import FEW, MAX_OFF_NS
from otf_core.errors import ConfigError
from otf_core.model.provenance import moment

Labels = NDArray[np.int64]

MOST = 20
"""Clocks; more are wrong stamps, not publishers."""
APART = 20.0
"""Two targets are at least so many steps of each of them apart."""


@dataclass(frozen=True)
class Publishers:
    """Who published which sample.

    Attributes
    ----------
    label : ndarray of int64, shape (n,)
        Number of the publisher, from 1; 0: of none, its stamp is off.
    by : str
        What tells them apart.
    words : tuple of str
        What each of them published.
    """

    label: Labels
    by: str
    words: tuple[str, ...]

    def __str__(self) -> str:
        """List them with the option that takes each."""
        return '; '.join(f'--publisher {k}: {text}' for k, text in enumerate(self.words, start=1))


def publishers_of(received: Received) -> Publishers | None:
    """Tell publishers apart; None if there is one only, or no telling."""
    for by, labels in (
        ('their channels', _by_channel(received)),
        ('their clocks', _by_clock(received.stamp_ns)),
        ('the places of their targets', _by_place(received.xyz)),
    ):
        if labels is not None and labels.max() > 1:
            count = range(1, int(labels.max()) + 1)
            return Publishers(labels, by, tuple(_words(received, labels == k) for k in count))
    return None


def received_of(part: Reading, where: str, remarks: list[str]) -> Received:
    """Return the samples of the publisher that was asked for, of all if none was.

    Raises
    ------
    ConfigError
        If there is no such publisher; lists those there are.
    """
    received = part.received()
    if part.publisher is None:
        return received
    found = publishers_of(received)
    if found is None:
        raise ConfigError(
            f'--publisher: {where}: {part.point.name} has one publisher, or several that neither '
            f'channels nor clocks nor places tell apart; leave the option out'
        )
    if not 1 <= part.publisher <= len(found.words):
        raise ConfigError(f'--publisher {part.publisher}: {where}: there are {found}')
    mine = found.label == part.publisher
    remarks.append(
        f'{len(found.words)} publishers on {part.point.name}, told apart by {found.by}; taken is '
        f'{part.publisher}: {found.words[part.publisher - 1]}'
    )
    channel = None if received.channel is None else received.channel[mine]
    return Received(received.stamp_ns[mine], received.xyz[mine], received.log_time[mine], channel)


def advice_of(parts: Sequence[Received]) -> str:
    """Return what to type where publishers are mixed; empty where none are told apart."""
    found = publishers_of(parts[0]) if len(parts) == 1 else None
    return f'; told apart by {found.by}, {found}' if found else ''


def _words(received: Received, mine: NDArray[np.bool_]) -> str:
    stamps = received.stamp_ns[mine]
    low, high = int(stamps.min()), int(stamps.max())
    first, last = moment(low), moment(high)
    span = f'{first} to {last}' if first else f'stamps {1e-9 * low:.3f} s to {1e-9 * high:.3f} s'
    return f'{len(stamps)} samples, {span}'


def _by_channel(received: Received) -> Labels | None:
    if received.channel is None:
        return None
    different, labels = np.unique(received.channel, return_inverse=True)
    count = np.bincount(labels)
    if len(different) < 2 or count.min() < FEW:
        return None
    return np.asarray(labels + 1, np.int64)


def _by_clock(stamp_ns: Labels) -> Labels | None:
    """Give every sample to the clock that it goes on with, in the order of reception."""
    if not np.any(np.maximum.accumulate(stamp_ns) - stamp_ns > MAX_OFF_NS):
        return None
    newest: list[int] = []
    bounds: list[tuple[int, int, int]] = []
    labels = np.empty(len(stamp_ns), np.int64)
    for i, stamp in enumerate(stamp_ns.tolist()):
        off = [abs(stamp - known) for known in newest]
        k = int(np.argmin(off)) if off else 0
        if not off or off[k] > MAX_OFF_NS:
            k = len(newest)
            newest.append(stamp)
            bounds.append((i, i, stamp))
            if k > MOST * FEW:
                return None
        newest[k] = max(newest[k], stamp)
        bounds[k] = (bounds[k][0], i, bounds[k][2])
        labels[i] = k
    count = np.bincount(labels)
    often = [k for k in range(len(newest)) if count[k] >= FEW]
    group = _joined([(k, *bounds[k], newest[k]) for k in often])
    number = np.zeros(len(newest), np.int64)
    for k, one in group.items():
        number[k] = one + 1
    return number[labels] if 0 < number.max() <= MOST else None


def _joined(clocks: Sequence[tuple[int, int, int, int, int]]) -> dict[int, int]:
    """Publisher of every clock: one that begins ahead of where another ended goes on with it.

    A clock is its number, first and last sample, first and newest stamp.
    """
    ends: list[tuple[int, int]] = []
    found: dict[int, int] = {}
    for k, first, last, begin, newest in sorted(clocks, key=lambda clock: clock[1]):
        before = [
            (begin - end, g) for g, (at, end) in enumerate(ends) if at < first and end <= begin
        ]
        g = min(before)[1] if before else len(ends)
        if not before:
            ends.append((last, newest))
        ends[g] = (last, newest)
        found[k] = g
    return found


def _by_place(xyz: NDArray[np.float64]) -> Labels | None:
    """Give every sample to the target that it lies nearer to, where two are followed."""
    step = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    if not step.size:
        return None
    large = float(np.percentile(step, 95))
    start = int(np.argmax(step > 0.5 * large))
    if np.mean(step > 0.5 * large) < 0.1 or large <= 0.0:
        return None
    labels = np.ones(len(xyz), np.int64)
    tips = [xyz[start], xyz[start + 1]]
    labels[start + 1] = 2
    moved: list[list[float]] = [[], []]
    for i in range(start + 2, len(xyz)):
        far = [float(np.linalg.norm(xyz[i] - tip)) for tip in tips]
        near = int(far[1] < far[0])
        moved[near].append(far[near])
        tips[near] = xyz[i]
        labels[i] = near + 1
    fewest = 0.1 * len(xyz)
    if min(map(len, moved)) < fewest:
        return None
    short = max(float(np.percentile(steps, 99)) for steps in moved)
    return labels if APART * short < large else None
