# SPDX-License-Identifier: Apache-2.0
"""The command ``otf VERB ...``, and ``python -m otf_core.cli VERB ...``."""

from __future__ import annotations

import gc
import os
import signal
import sys
from io import TextIOWrapper
from typing import Any, NoReturn

SIGTERM_WAIT = 2.0
"""s after which SIGTERM counts as unheard: code in C may clear what a handler raises."""


class _Terminated(BaseException):
    """SIGTERM, so that what lies aside is removed before the end."""


def _terminate(*_: Any) -> None:
    _end_in(SIGTERM_WAIT, _Terminated)
    raise _Terminated


def _end_in(seconds: float, kind: type[BaseException]) -> None:
    """Raise what ends the command after so many seconds, if it is still there."""

    def again(*_: Any) -> None:
        raise kind

    if hasattr(signal, 'setitimer'):  # not on Windows
        signal.signal(signal.SIGALRM, again)
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _raise_pending_end(unraisable: sys.UnraisableHookArgs) -> None:
    """Raise again, a moment later, an end that came where Python passes exceptions over.

    That is in finalizers, and in what is called around a fork.
    """
    if unraisable.exc_type in (_Terminated, KeyboardInterrupt):
        _end_in(0.01, unraisable.exc_type)
    else:
        sys.__unraisablehook__(unraisable)


def run() -> NoReturn:
    """Run the verb of the command line and leave with its exit code."""
    signal.signal(signal.SIGTERM, _terminate)
    sys.unraisablehook = _raise_pending_end
    gc.set_threshold(1_000_000)  # looking for cycles takes a twelfth of the time otherwise
    # read when NumPy is loaded; idle threads of its library take processor time (otf_core.threads)
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors='replace')  # a console that cannot show a letter
    try:
        from otf_core.cli import main

        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
    except _Terminated:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTERM)
        raise
    finally:
        gc.freeze()  # the end of Python looks through all modules for cycles otherwise: 0.06 s


if __name__ == '__main__':
    run()
