# SPDX-License-Identifier: Apache-2.0
"""A node's process from its start to its end: Ctrl-C ends it in order at any moment.

Libraries that are still loading are left at once; once the node has ended, a second
Ctrl-C does not change its exit code any more.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from importlib import import_module


def main(module: str, interrupted: int = 0) -> int:
    """Load a module and run its ``main``, which has signal handlers of its own.

    Parameters
    ----------
    interrupted : int
        Exit code of a process that is ended while it loads.

    Returns
    -------
    int
        Exit code.
    """
    return _served(lambda: int(import_module(module).main()), interrupted)


def node(module: str, kind: str) -> Callable[[], int]:
    """Return the main function of the process of a node, which is loaded when it is called.

    Parameters
    ----------
    kind : str
        Class of the node in the module.
    """

    def run() -> int:
        loaded = import_module(module)
        return import_module('otf_ros.app').run(getattr(loaded, kind))  # type: ignore[no-any-return]

    return lambda: _served(run, interrupted=0)


def _served(run: Callable[[], int], interrupted: int) -> int:
    """Run with the signals, and the threads of NumPy, that a process of the graph has."""

    def leave(number: int, frame: object) -> None:
        os._exit(interrupted)  # nothing has begun that could be ended in order

    numbers = (signal.SIGINT, signal.SIGTERM)
    for number in numbers:
        signal.signal(number, leave)
    # read when NumPy is loaded, here and in processes begun here; see otf_core.threads
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    code = run()
    for number in numbers:  # Python would go back to the default while it ends
        signal.signal(number, signal.SIG_IGN)
    return code
