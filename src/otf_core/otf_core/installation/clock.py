# SPDX-License-Identifier: Apache-2.0
"""The clock of this computer: dates of results, stamps of recorders."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator

from otf_core.installation.state import OK, WARNING, State

RELEASED = 1_767_225_600.0
"""s since 1970, 2026-01-01: no earlier than this program was written."""
APART = 5.0
"""s; between this computer and the disk that it writes to."""


def check() -> Iterator[State]:
    """Ask whether the clock can be right and whether somebody keeps it so."""
    now = time.time()
    date = time.strftime('%Y-%m-%d %H:%M:%S UTC', time.gmtime(now))
    if now < RELEASED:
        yield State('clock', WARNING, f'{date}: in the past', 'set the clock of this computer')
        return
    with tempfile.TemporaryFile() as file:
        late = os.fstat(file.fileno()).st_mtime - time.time()
    if abs(late) > APART:
        yield State(
            'clock', WARNING, f'{date}, but the disk says {late:+.0f} s',
            'let both computers keep time by NTP',
        )  # fmt: skip
    synchronised = _synchronised()
    if synchronised is False:
        yield State(
            'clock', WARNING, f'{date}, not kept by NTP',
            'timedatectl set-ntp true; a clock that is set while recording spoils bags that '
            'are stamped by this computer',
        )  # fmt: skip
    else:
        yield State('clock', OK, date + (', kept by NTP' if synchronised else ''))


def _synchronised() -> bool | None:
    """Whether the clock is kept; None where the system does not say."""
    program = shutil.which('timedatectl')
    if program is None:
        return None
    command = [program, 'show', '-p', 'NTPSynchronized', '--value']
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=2, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return {'yes': True, 'no': False}.get(done.stdout.strip())
