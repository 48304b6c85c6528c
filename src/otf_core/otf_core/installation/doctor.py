# SPDX-License-Identifier: Apache-2.0
"""All checks of an installation."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from otf_core.installation import clock, graph, packages, python, space, texts
from otf_core.installation.state import State

CHECKS: tuple[Callable[[], Iterator[State]], ...] = (
    python.check,
    packages.check,
    space.check,
    texts.check,
    clock.check,
    graph.check,
)
"""In the order in which they are shown."""


def examine() -> list[State]:
    """Look at this installation."""
    return [state for check in CHECKS for state in check()]
