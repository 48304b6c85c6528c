# SPDX-License-Identifier: Apache-2.0
"""A node's process from its start to its end: Ctrl-C ends it in order at any moment.

Libraries that are still loading are left with exit code 0; once the node has ended, a second
Ctrl-C does not change its exit code any more.
"""

from __future__ import annotations

import os
import signal
from importlib import import_module


def _leave(number: int, frame: object) -> None:
    os._exit(0)  # nothing has begun that could be ended in order


def main(module: str) -> int:
    """Load a module and run its ``main``, which has signal handlers of its own.

    Parameters
    ----------
    module : str

    Returns
    -------
    int
        Exit code.
    """
    numbers = (signal.SIGINT, signal.SIGTERM)
    for number in numbers:
        signal.signal(number, _leave)
    code = int(import_module(module).main())
    for number in numbers:  # Python would go back to the default while it ends
        signal.signal(number, signal.SIG_IGN)
    return code
