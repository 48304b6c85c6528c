# SPDX-License-Identifier: Apache-2.0
"""One thing worked out by a process of its own while this one goes on.

A diagnosis is many small steps in Python, which threads of one process take in turn. A copy of the
process (``fork``) has everything at hand without having it sent; only what it finds is. Where
processes cannot be copied, or one comes to grief, the work is done here once it is asked for: so
errors are told here, too, and nothing is lost but time.
"""

from __future__ import annotations

import ctypes
import io
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import is_dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess, current_process
from types import TracebackType
from typing import Any, Generic, TypeVar

from otf_core.threads import one_by_one, side_by_side

A = TypeVar('A')
R = TypeVar('R')

TICKET = 2
"""Bytes of the number of the next item."""
_PR_SET_PDEATHSIG = 1
"""Option of ``prctl`` (linux/prctl.h): the signal that the end of the parent sends."""
NICE = 10
"""Of 19 by which a process can give way to others."""
_SMALL = (str, bytes, int, float, type)
"""Sent sooner than looked up."""


class Aside(Generic[R]):
    """Something that is worked out aside, while this context lasts.

    Parameters
    ----------
    work : callable
        Depends on nothing that happens later, and changes nothing; what it returns is sent.
    known : sequence of object
        What is here as well, with the fields of dataclasses and what is in sequences and mappings:
        where what is sent refers to it, it is this.
    later : bool
        Gives way to other processes, being needed last.
    """

    def __init__(
        self, work: Callable[[], R], known: Sequence[object] = (), *, later: bool = False
    ) -> None:
        self._work, self._nice = work, NICE if later else 0
        self._known = _within(known)  # a copy has everything at the same place
        self._process: BaseProcess | None = None
        self._found: list[R] = []

    def __enter__(self) -> Aside[R]:
        if _may_copy():
            fork = get_context('fork')
            self._answer, end = fork.Pipe(duplex=False)
            process = fork.Process(target=self._tell, args=(end, os.getpid()), daemon=True)
            with end, suppress(OSError), warnings.catch_warnings():  # no memory for a copy
                # from Python 3.12 on copies beside other threads warn; see _may_copy
                warnings.simplefilter('ignore', DeprecationWarning)
                process.start()
                self._process = process
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._answer.close()
            self._process = None

    def result(self) -> R:
        """What was found; waits for it."""
        if not self._found and self._process is not None:
            with suppress(EOFError):
                received = _Unpickler(io.BytesIO(self._answer.recv_bytes()))
                received.known = self._known
                self._found.append(received.load())
        if not self._found:
            self._found.append(self._work())
        return self._found[0]

    def _tell(self, end: Connection, parent: int) -> None:
        """Send what is found; whatever goes wrong, the other process sees that nothing comes."""
        _end_with(parent)
        one_by_one()
        os.nice(self._nice)
        with end, suppress(BaseException):
            sent = io.BytesIO()
            pickler = _Pickler(sent, pickle.HIGHEST_PROTOCOL)
            pickler.known = self._known
            pickler.dump(self._work())
            end.send_bytes(sent.getbuffer())


def share_out(
    function: Callable[[A], R], items: Sequence[A], known: Sequence[object] = ()
) -> list[R]:
    """Results of a function for all items, in their order; two processes share the work.

    Where no process can be copied, ``threads.side_by_side``.

    Parameters
    ----------
    function : callable
        Its results do not depend on each other.
    known : sequence of object
        See ``Aside``.
    """
    if len(items) < 2 or not _may_copy():
        return side_by_side(function, items)
    tickets, end = os.pipe()
    with os.fdopen(tickets, 'rb', buffering=0) as queue:
        with os.fdopen(end, 'wb') as box:
            box.writelines(k.to_bytes(TICKET, 'little') for k in range(len(items)))
        own = partial(_drawn, function, items, queue)
        with Aside(own, known) as other:
            results = own()
            results |= other.result()
    return [results[k] if k in results else function(item) for k, item in enumerate(items)]


def _drawn(function: Callable[[A], R], items: Sequence[A], queue: io.FileIO) -> dict[int, R]:
    """Results for items whose tickets are drawn here, by their places."""
    return {k: function(items[k]) for k in _tickets(queue)}


def _tickets(queue: io.FileIO) -> Iterator[int]:
    """Places that nobody else has drawn."""
    while ticket := queue.read(TICKET):
        yield int.from_bytes(ticket, 'little')


def _end_with(parent: int) -> None:
    """End as soon as the process ends that this one is a copy of, whatever ends it."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)  # copies are made on Linux alone
    if os.getppid() != parent:  # it was faster
        os._exit(1)


def _may_copy() -> bool:
    """Return whether a copy of this process would be of use, and harm nobody.

    Made by the main thread alone: a copy has the locks of all other threads as they happen to be,
    and where the main thread leaves the work to others, as in a node of the graph, they are many.
    """
    if sys.platform != 'linux' or current_process().daemon:
        return False
    if threading.current_thread() is not threading.main_thread():
        return False
    return len(os.sched_getaffinity(0)) > 1


def _within(known: Sequence[object]) -> dict[int, object]:
    """Objects by their ``id``: those given, and all that they hold."""
    objects: dict[int, object] = {}
    waiting = list(known)
    while waiting:
        one = waiting.pop()
        if id(one) in objects or one is None or isinstance(one, _SMALL):
            continue
        objects[id(one)] = one
        if isinstance(one, Mapping):
            waiting += one.values()
        elif isinstance(one, (list, tuple)):
            waiting += one
        elif is_dataclass(one):
            waiting += vars(one).values()
    return objects


class _Pickler(pickle.Pickler):
    known: dict[int, Any]

    def persistent_id(self, obj: Any) -> int | None:
        """Place of what is known."""
        return id(obj) if id(obj) in self.known else None


class _Unpickler(pickle.Unpickler):
    known: dict[int, Any]

    def persistent_load(self, pid: int) -> Any:
        """What lies there."""
        return self.known[pid]
