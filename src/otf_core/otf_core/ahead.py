# SPDX-License-Identifier: Apache-2.0
"""Work that will be asked for, begun ahead in a copy of the process.

A hint and nothing more: the call for a result is the same whether its work was begun or not, so
that a line with ``begin`` can be deleted without changing a result.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

from otf_core.aside import Aside

P = ParamSpec('P')
R = TypeVar('R')


class Ahead:
    """Calls that are begun while this context lasts; those nobody asked for end with it.

    Examples
    --------
    >>> with Ahead() as ahead:
    ...     ahead.begin(divmod, 7, 2)
    ...     ahead(divmod, 7, 2)
    (3, 1)
    """

    def __init__(self) -> None:
        self._begun: dict[tuple[object, ...], Aside[Any]] = {}
        self._arguments: list[tuple[object, ...]] = []  # alive, so that their ids stay theirs
        self._stack = ExitStack()

    def begin(self, function: Callable[P, R], *arguments: P.args, **named: P.kwargs) -> None:
        """Begin a call in a copy of the process, which gives way to other work."""
        self._arguments.append((*arguments, *named.values()))
        work = Aside(partial(function, *arguments, **named), self._arguments[-1], later=True)
        self._begun[_key(function, arguments, named)] = self._stack.enter_context(work)

    def __call__(self, function: Callable[P, R], *arguments: P.args, **named: P.kwargs) -> R:
        """Return the result of a call; one that was begun is waited for."""
        begun = self._begun.get(_key(function, arguments, named))
        result: R = function(*arguments, **named) if begun is None else begun.result()
        return result

    def __enter__(self) -> Ahead:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()


def _key(
    function: Callable[..., Any], arguments: tuple[object, ...], named: dict[str, Any]
) -> tuple[object, ...]:
    """What makes two calls the same: the function, and the very same objects as arguments."""
    return (function, *map(id, arguments), *((name, id(value)) for name, value in named.items()))
