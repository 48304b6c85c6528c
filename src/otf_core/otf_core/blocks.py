# SPDX-License-Identifier: Apache-2.0
"""Samples some at a time: what is made of all at once would be large."""

from collections.abc import Iterator

BLOCK = 65536
"""Samples worked on at a time."""


def blocks(count: int) -> Iterator[slice]:
    """Slices of samples."""
    return (slice(low, min(low + BLOCK, count)) for low in range(0, count, BLOCK))
