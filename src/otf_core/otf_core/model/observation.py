# SPDX-License-Identifier: Apache-2.0
"""Tracker samples as data: stamps of the tracker's own clock and points in its own frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import InputError, ShapeError


@dataclass(frozen=True)
class Samples:
    """Tracker samples in the order they were measured.

    Attributes
    ----------
    stamp_ns : array_like of int64, shape (n,), ns
        Measurement time on the tracker's clock; any epoch.
    xyz : array_like of float64, shape (n, 3), m
        Target position in the tracker frame; the beam starts at its origin.

    Raises
    ------
    ShapeError
        If the arrays have other shapes.
    InputError
        If the stamps are no integers: float64 has no room for nanoseconds since 1970.

    Examples
    --------
    >>> samples = otf_core.Samples([0, 2_000_000], [[0.5, 0.1, 0.0], [0.5, 0.1, 1e-6]])
    >>> len(samples), samples.time.tolist()
    (2, [0.0, 0.002])
    """

    stamp_ns: NDArray[np.int64]
    xyz: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Refuse arrays of other shapes, and stamps that are no integers."""
        stamps, xyz = np.asarray(self.stamp_ns), np.asarray(self.xyz, dtype=float)
        if stamps.dtype.kind not in 'iu':
            raise InputError(f'samples: stamps are integers in ns, got {stamps.dtype}')
        object.__setattr__(self, 'stamp_ns', stamps.astype(np.int64, copy=False))
        object.__setattr__(self, 'xyz', xyz)
        if self.xyz.shape != (self.stamp_ns.size, 3) or self.stamp_ns.ndim != 1:
            raise ShapeError(
                f'samples need stamps (n,) and points (n, 3); '
                f'got {self.stamp_ns.shape} and {self.xyz.shape}'
            )

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.stamp_ns.size)

    @property
    def time(self) -> NDArray[np.float64]:
        """Seconds since the first sample, shape (n,)."""
        return np.asarray((self.stamp_ns - self.stamp_ns[:1]) * 1e-9, dtype=np.float64)

    @cached_property
    def step_ns(self) -> float:
        """Usual time from one sample to the next (median), ns; 0 for a single one."""
        return float(np.median(np.diff(self.stamp_ns))) if len(self) > 1 else 0.0

    @property
    def step(self) -> float:
        """The same in s."""
        return self.step_ns * 1e-9

    def in_order(self) -> Samples:
        """Return the samples by stamp, one of each."""
        if np.all(self.stamp_ns[1:] > self.stamp_ns[:-1]):
            return self
        stamp_ns, first = np.unique(self.stamp_ns, return_index=True)
        return Samples(stamp_ns, self.xyz[first])

    def part(self, start: int, stop: int) -> Samples:
        """Return samples start to stop - 1 (views, no copy)."""
        return Samples(self.stamp_ns[start:stop], self.xyz[start:stop])


class SampleBuffer:
    """Growing store of samples; appending costs constant time, 32 bytes a sample."""

    def __init__(self, capacity: int = 65536) -> None:
        self._stamp_ns = np.empty(capacity, np.int64)
        self._xyz = np.empty((capacity, 3))
        self._size = 0

    def __len__(self) -> int:
        """Return the number of samples held."""
        return self._size

    def append(self, stamp_ns: int, x: float, y: float, z: float) -> None:
        """Add one sample: stamp in ns, position in m in the tracker frame."""
        if self._size == self._stamp_ns.size:
            self._stamp_ns = np.concatenate([self._stamp_ns, np.empty_like(self._stamp_ns)])
            self._xyz = np.concatenate([self._xyz, np.empty_like(self._xyz)])
        self._stamp_ns[self._size] = stamp_ns
        self._xyz[self._size] = (x, y, z)
        self._size += 1

    def clear(self) -> None:
        """Forget all samples."""
        self._size = 0

    def cut(self, size: int) -> None:
        """Forget the samples after the first ``size``."""
        self._size = min(self._size, size)

    def snapshot(self, start: int = 0, stop: int | None = None) -> Samples:
        """Return a copy of the samples from index start on, up to stop."""
        stop = self._size if stop is None else min(stop, self._size)
        return Samples(self._stamp_ns[start:stop].copy(), self._xyz[start:stop].copy())
