# SPDX-License-Identifier: Apache-2.0
"""Start of a node's process: Ctrl-C ends it with 0 also while its libraries are still loading."""

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
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    return int(import_module(module).main())
