# SPDX-License-Identifier: Apache-2.0
"""What a check found: how grave it is and in what words."""

from __future__ import annotations

from dataclasses import dataclass

WARNING, GATE = 'warning', 'gate'


@dataclass(frozen=True)
class Finding:
    """A contradiction in the input that does not forbid a result.

    Attributes
    ----------
    check : str
        Name of the check.
    severity : str
        ``WARNING``: the result is usable; ``GATE``: it is not to be relied on (exit code 4).
    words : str
        The cause and what to do.
    """

    check: str
    severity: str
    words: str


def words_of(findings: tuple[Finding, ...], severity: str) -> tuple[str, ...]:
    """Words of the findings of one severity."""
    return tuple(f'{f.check}: {f.words}' for f in findings if f.severity == severity)
