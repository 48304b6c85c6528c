# SPDX-License-Identifier: Apache-2.0
"""All checks of a recording, and the answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from otf_core.checking.beam import BEAM
from otf_core.checking.checked import ERROR, Check, Checked, Problem
from otf_core.checking.clock import CLOCK
from otf_core.checking.content import CONTENT
from otf_core.checking.contradiction import CONTRADICTION
from otf_core.checking.following import FOLLOWING
from otf_core.checking.forecast import FORECAST
from otf_core.checking.gaps import GAPS
from otf_core.checking.look import look
from otf_core.checking.rate import RATE
from otf_core.checking.standstill import STANDSTILL
from otf_core.config import CalibrationConfig
from otf_core.inputs.recordings import AS_IT_IS, Given
from otf_core.model.machine import Machine

CHECKS: tuple[Check, ...] = (
    CONTENT,
    RATE,
    GAPS,
    CLOCK,
    BEAM,
    STANDSTILL,
    FOLLOWING,
    CONTRADICTION,
    FORECAST,
)
"""In the order in which they are shown; a further one is one file and one line here."""


@dataclass(frozen=True)
class CheckReport:
    """What is to be known of a recording before the tracker is dismounted.

    Attributes
    ----------
    name : str
    checked : mapping of str to Checked
        By the names of the checks.
    """

    name: str
    checked: Mapping[str, Checked]

    @property
    def problems(self) -> tuple[tuple[str, Problem], ...]:
        """Names of checks and what they found, errors first."""
        every = [(name, p) for name, found in self.checked.items() for p in found.problems]
        return tuple(sorted(every, key=lambda item: item[1].severity != ERROR))

    @property
    def usable(self) -> bool:
        """True if a calibration would take the recording."""
        return all(p.severity != ERROR for _, p in self.problems)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        facts: dict[str, Any] = {}
        for found in self.checked.values():
            facts |= found.facts
        problems = [
            {'check': name, 'severity': p.severity, 'what': p.what} for name, p in self.problems
        ]
        return {'usable': self.usable, 'problems': problems, **facts}


def check(
    source: str,
    machine: Machine | None = None,
    config: CalibrationConfig | None = None,
    given: Given = AS_IT_IS,
) -> CheckReport:
    """Ask a recording whether it can be used.

    Parameters
    ----------
    source : str
        A bag, or a table of samples as text.
    machine : Machine, optional
    config : CalibrationConfig, optional
    given : Given
        How it is read.

    Returns
    -------
    CheckReport

    Raises
    ------
    ConfigError
        If there is no such file or folder.
    """
    seen = look(source, machine, config or CalibrationConfig(), given)
    return CheckReport(source, {c.name: c.ask(seen) for c in CHECKS})
