# SPDX-License-Identifier: Apache-2.0
"""Memory that is free, given back to the operating system.

Large arrays that come and go leave a heap of which half is free but still counts as used; between
the steps of a calibration of many samples that is as much as the samples themselves.
"""

from __future__ import annotations

import sys


def give_back() -> None:
    """Give back what is free; does nothing where the C library has no ``malloc_trim``."""
    if sys.platform != 'linux':
        return
    import ctypes  # a few ms

    trim = getattr(ctypes.CDLL(None), 'malloc_trim', None)
    if trim is not None:
        trim(0)
