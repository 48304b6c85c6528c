# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes of their own: started, watched and ended together, their logs kept."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

GRACE = 15.0
"""s; a node that has not ended so long after SIGINT is killed."""
MODULES = {'viewer': 'otf_view.run_viewer', 'page': 'otf_view.run_page'}
"""Of nodes that have not a package of their own."""
_PR_SET_PDEATHSIG = 1


def module_of(name: str) -> str:
    """Return the module that a node is run with."""
    return MODULES.get(name, f'otf_{name}')


def _end_with_parent() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class NodeProcess:
    """One node.

    Parameters
    ----------
    name : str
        Names the log file.
    module : str
        Run with ``python -m``.
    parameters : mapping
        ROS parameters.
    environment : mapping of str to str
        Added to the present variables, such as ROS_DOMAIN_ID.
    arguments : list of str
        Further ROS arguments.
    """

    def __init__(
        self,
        name: str,
        module: str,
        parameters: Mapping[str, object],
        log_folder: Path,
        environment: Mapping[str, str],
        arguments: list[str] | None = None,
    ) -> None:
        self.name, self.log = name, log_folder / f'{name}.log'
        given = [w for k, v in parameters.items() for w in ('-p', f'{k}:={as_yaml(v)}')]
        with open(self.log, 'wb') as log:
            self.process = subprocess.Popen(
                [sys.executable, '-m', module, '--ros-args', *given, *(arguments or [])],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, 'PYTHONUNBUFFERED': '1', **environment},
                start_new_session=True,  # Ctrl-C reaches the parent only, which ends all in order
                preexec_fn=_end_with_parent,
            )

    @property
    def exit_code(self) -> int | None:
        """Exit code; None while it runs."""
        return self.process.poll()

    def interrupt(self, number: signal.Signals = signal.SIGINT) -> None:
        """Ask it to end."""
        if self.exit_code is None:
            self.process.send_signal(number)

    def wait(self, timeout: float = GRACE) -> int:
        """Wait for its end and return the exit code; it is killed after the timeout."""
        try:
            return self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def last_lines(self, count: int = 8) -> str:
        """Return the end of its log."""
        text = self.log.read_text(encoding='utf-8', errors='replace')
        return '\n'.join(text.splitlines()[-count:])


def as_yaml(value: object) -> str:
    """Write a parameter as ROS reads it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | Path):
        quoted = str(value).replace("'", "''")
        return f"'{quoted}'"
    return str(value)


@contextmanager
def end_together(nodes: list[NodeProcess]) -> Iterator[None]:
    """End all nodes when the block is left, however it is left; a second Ctrl-C waits for it."""
    try:
        yield
    finally:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        for node in reversed(nodes):
            node.interrupt()
        deadline = time.monotonic() + GRACE
        for node in nodes:
            node.wait(max(0.1, deadline - time.monotonic()))
        signal.signal(signal.SIGINT, before)
