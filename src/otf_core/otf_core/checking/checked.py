# SPDX-License-Identifier: Apache-2.0
"""What a check says: one line for people, facts for programs, problems for both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from otf_core.checking.seen import Seen

WARNING = 'warning'
ERROR = 'error'
"""A calibration would refuse the recording, or a quality gate of it would fail."""


@dataclass(frozen=True)
class Problem:
    """Something wrong with a recording.

    Attributes
    ----------
    severity : str
        ``WARNING`` or ``ERROR``.
    what : str
        What, where, and what to do.
    """

    severity: str
    what: str


@dataclass(frozen=True)
class Checked:
    """What one check found.

    Attributes
    ----------
    words : str
        For the table; empty if there is nothing to look at.
    facts : mapping of str to plain data
        In the units that the names state.
    problems : tuple of Problem
    """

    words: str = ''
    facts: Mapping[str, Any] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class Check:
    """One question to a recording.

    Attributes
    ----------
    name : str
        What is looked at, one word.
    ask : callable
        Seen to Checked.
    """

    name: str
    ask: Callable[[Seen], Checked]


def warnings(*texts: str) -> tuple[Problem, ...]:
    """Problems that a calibration can live with; empty texts are none."""
    return tuple(Problem(WARNING, text) for text in texts if text)


def errors(*texts: str) -> tuple[Problem, ...]:
    """Problems that it cannot live with; empty texts are none."""
    return tuple(Problem(ERROR, text) for text in texts if text)
