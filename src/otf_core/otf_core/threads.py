# SPDX-License-Identifier: Apache-2.0
"""One thread for linear algebra: the matrices are small, threads cost more than they give.

On busy machines several threads make a calibration ten times slower, and their number changes the
last bits. threadpoolctl has no rosdep key; without it the number of threads stays as it is, and
OPENBLAS_NUM_THREADS=1 in the environment does the same. Processes of our own set that before NumPy
is loaded: threads that its library begins then look for work in loops, which takes a third of the
processor time of a start.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

try:
    from threadpoolctl import threadpool_limits
except ImportError:
    threadpool_limits = None

P = ParamSpec('P')
R = TypeVar('R')
A = TypeVar('A')


WORKERS = 2
"""Threads; as many as cores are expected. They do not change results, items being independent."""

_here = threading.local()


def side_by_side(function: Callable[[A], R], items: Sequence[A]) -> list[R]:
    """Results of a function for all items, in their order; arrays are worked on at once.

    What is side by side already goes on one by one: more threads than cores are in each
    other's way.
    """
    if len(items) < 2 or getattr(_here, 'beside_another', False):
        return [function(item) for item in items]
    with ThreadPoolExecutor(WORKERS, initializer=one_by_one) as pool:
        return list(pool.map(function, items))


def one_by_one() -> None:
    """Let what is side by side go on one by one in this thread: another one is at work."""
    _here.beside_another = True


@contextmanager
def one_thread() -> Iterator[None]:
    """Let linear algebra use one thread in this context; finding its libraries takes 2 ms."""
    if threadpool_limits is None or getattr(_here, 'limited', False):
        yield
        return
    _here.limited = True
    try:
        with threadpool_limits(1):
            yield
    finally:
        _here.limited = False


def limit_to_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function whose linear algebra uses one thread."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with one_thread():
            return function(*args, **kwargs)

    return limited
