# SPDX-License-Identifier: Apache-2.0
"""What a check of the installation says."""

from __future__ import annotations

from dataclasses import dataclass

OK = 'ok'
WARNING = 'warning'
ERROR = 'error'


@dataclass(frozen=True)
class State:
    """One part of an installation.

    Attributes
    ----------
    part : str
        One word.
    severity : str
        ``OK``; ``WARNING``: some things will not work; ``ERROR``: nothing will.
    what : str
        What was found.
    do : str
        What to do; empty where all is well.
    """

    part: str
    severity: str
    what: str
    do: str = ''
