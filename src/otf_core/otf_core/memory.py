# SPDX-License-Identifier: Apache-2.0
"""Little memory: arrays worked on some values at a time, and what is free given back.

Large arrays that come and go leave a heap of which half is free but still counts as used; between
the steps of a calibration of many samples that is as much as the samples themselves. Every thread
has such a heap of its own unless they are told to share one.

Looking for cycles frees little, and takes a twelfth of the time of a calibration.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""Parameters of ``mallopt`` (malloc.h of the GNU C library): bytes above which free memory is
given back by itself, bytes above which an array is mapped on its own, number of heaps."""
_LARGE, _NEVER = 32 << 20, 1 << 30
"""Bytes."""
BLOCK = 65536
"""Samples worked on at a time."""
GARBAGE = 1_000_000
"""Objects after which cycles are looked for: more than the start of the longest command makes."""


def blocks(count: int) -> Iterator[slice]:
    """Samples, some at a time: what is made of all at once would be large."""
    return (slice(low, min(low + BLOCK, count)) for low in range(0, count, BLOCK))


def give_back() -> None:
    """Give back what is free; does nothing where the C library has no ``malloc_trim``."""
    trim = of_c('malloc_trim')
    if trim is not None:
        trim(0)


def collect() -> None:
    """Free cycles and give back what is free: between steps after which much is of no more use."""
    gc.collect()
    give_back()


@contextmanager
def giving_back() -> Iterator[None]:
    """Give back what is free at the end of this context, however it ends."""
    try:
        yield
    finally:
        give_back()


def one_heap() -> None:
    """Let threads that begin later share one heap, and use what is free of it again.

    Memory that goes back to the system with every array comes back page by page, which takes
    longer than much of the work on it. Does nothing where the C library has no ``mallopt``.
    """
    option = of_c('mallopt')
    if option is not None:
        option(_M_ARENA_MAX, 1)
        option(_M_MMAP_THRESHOLD, _LARGE)
        option(_M_TRIM_THRESHOLD, _NEVER)


def seldom_look_for_cycles() -> None:
    """Let a process that works on one thing do so; one that goes on collects them in between."""
    gc.set_threshold(GARBAGE)


def of_c(name: str) -> Any:
    """Give a function of the C library; None if it has none of that name."""
    if sys.platform != 'linux':
        return None
    import ctypes  # a few ms

    return getattr(ctypes.CDLL(None), name, None)
