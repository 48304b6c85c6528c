# SPDX-License-Identifier: Apache-2.0
"""What a driver that is killed leaves to the next one: stream, number of samples, last stamp.

A few bytes of a file that is mapped into memory: they are there however the process ends, and cost
a microsecond a sample. A kill between a sample and the note of it leaves that one out. An orderly
end of the stream empties them.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import struct
from pathlib import Path
from typing import NamedTuple

LAYOUT = struct.Struct('<12sqq')
"""stream_id, samples published, stamp of the last one (ns)."""
LONGEST = 600 * 10**9
"""ns; what is left of a stream that has ended earlier has nothing to do with the next one."""


class DriverRemains(NamedTuple):
    """What the driver before has left.

    Attributes
    ----------
    samples : int
        That it had published.
    last_ns : int, ns
        Stamp of the last of them.
    """

    stream_id: str
    samples: int
    last_ns: int


NOTHING_LEFT = DriverRemains('', 0, 0)


def place(name: str) -> Path:
    """Return the file of a node.

    Parameters
    ----------
    name : str
        Its full name.
    """
    home = os.environ.get('ROS_HOME') or Path.home() / '.ros'
    domain = os.environ.get('ROS_DOMAIN_ID', '0')
    return Path(home) / 'otf_tracker_driver' / f'{domain}{name.replace("/", "-")}.stream'


class Handover:
    """The bytes; where they cannot be kept, nothing is left, and nothing else changes."""

    def __init__(self, file: Path) -> None:
        self._bytes: mmap.mmap | bytearray = bytearray(LAYOUT.size)
        with contextlib.suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
            with open(os.open(file, os.O_RDWR | os.O_CREAT, 0o600), 'r+b') as opened:
                opened.truncate(LAYOUT.size)
                self._bytes = mmap.mmap(opened.fileno(), LAYOUT.size)
        name, samples, last_ns = LAYOUT.unpack(self._bytes[:])
        self._left = DriverRemains(name.rstrip(b'\0').decode('ascii', 'replace'), samples, last_ns)

    def take(self, first_ns: int) -> DriverRemains | None:
        """Return, once, what was left by a stream that a sample of this stamp goes on with."""
        handed_over, self._left = self._left, NOTHING_LEFT
        going_on = handed_over.stream_id and 0 < first_ns - handed_over.last_ns < LONGEST
        return handed_over if going_on else None

    def note(self, stream_id: str, samples: int, last_ns: int) -> None:
        """Note how many samples of a stream are published, and the stamp of the last one, ns."""
        self._bytes[:] = LAYOUT.pack(stream_id.encode('ascii'), samples, last_ns)

    def clear(self) -> None:
        """Note that nothing is left."""
        self._bytes[:] = bytes(LAYOUT.size)
