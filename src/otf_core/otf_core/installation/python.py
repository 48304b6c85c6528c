# SPDX-License-Identifier: Apache-2.0
"""The interpreter."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator

from otf_core.installation.state import ERROR, OK, WARNING, State

LOWEST, HIGHEST = (3, 10), (3, 13)


def check() -> Iterator[State]:
    """Ask for version and width of addresses."""
    version = '.'.join(map(str, sys.version_info[:3]))
    found = f'Python {version}, {sys.executable}'
    if sys.version_info[:2] < LOWEST:
        yield State('python', ERROR, found, f'use Python {LOWEST[0]}.{LOWEST[1]} or later')
    elif struct.calcsize('P') < 8:
        yield State('python', ERROR, f'{found}, 32 bit', 'use a 64 bit Python')
    elif sys.version_info[:2] > HIGHEST:
        yield State(
            'python', WARNING, found,
            f'tried up to Python {HIGHEST[0]}.{HIGHEST[1]}; take that if something fails',
        )  # fmt: skip
    else:
        yield State('python', OK, found)
