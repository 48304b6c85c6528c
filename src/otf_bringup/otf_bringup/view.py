# SPDX-License-Identifier: Apache-2.0
"""Shows the page of the live view to whoever sits at this computer."""

from __future__ import annotations

import os
import re
import sys
import time
import webbrowser

from otf_bringup.processes import NodeProcess

PATIENCE = 30.0
"""s until the page has to be there."""
TO_READ = 1.0
"""s; so long the end of a run is shown where nobody can press a key."""


def open_page(page: NodeProcess) -> str:
    """Wait for the page, open it in a browser if there is a screen, and return its address.

    Parameters
    ----------
    page : NodeProcess
        The node that serves it.

    Returns
    -------
    str
        Empty if the node has ended or says nothing.
    """
    deadline = time.monotonic() + PATIENCE
    while page.exit_code is None and time.monotonic() < deadline:
        announcement = re.search(r'live view at (http://\S+)', page.last_lines())
        if announcement:
            if _has_screen():
                webbrowser.open(announcement[1])
            return announcement[1]
        time.sleep(0.1)
    return ''


def keep_open(address: str) -> None:
    """Leave the page as it is until Enter or Ctrl-C; where no terminal is, for a moment only."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        time.sleep(TO_READ)
        return
    place = f'The page stays at {address}, the report at {address}report.html'
    sys.stdout.write(f'\n{place}; Enter ends it.\n')
    sys.stdout.flush()
    try:
        sys.stdin.readline()
    except KeyboardInterrupt:
        sys.stdout.write('\n')


def _has_screen() -> bool:
    """Whether a browser would have a window of its own: a text browser takes the terminal."""
    named = any(os.environ.get(name) for name in ('DISPLAY', 'WAYLAND_DISPLAY'))
    return named or sys.platform == 'darwin'
