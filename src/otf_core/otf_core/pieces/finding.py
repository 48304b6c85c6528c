# SPDX-License-Identifier: Apache-2.0
"""What a check found: how grave it is and in what words."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.documents import Document, stated

WARNING, GATE = 'warning', 'gate'
MIN_COVERAGE = 0.8
"""Share of the path length below which a calibration fails the quality gate."""
COMPLETE_PATH = 0.98
"""Driven share from which on nothing is reported."""
MAX_OUTLIERS = 0.2
"""Share of left-out samples above which a calibration fails the quality gate."""


@dataclass(frozen=True)
class Finding(Document):
    """A contradiction in the input that does not forbid a result."""

    check: str = stated('name of the check')
    severity: str = stated('warning: usable; gate: not to be relied on (exit code 4)')
    words: str = stated('the cause and what to do')


def words_of(findings: tuple[Finding, ...], severity: str) -> tuple[str, ...]:
    """Words of the findings of one severity."""
    return tuple(f'{f.check}: {f.words}' for f in findings if f.severity == severity)


def incomplete_path(coverage: float) -> tuple[Finding, ...]:
    """What a diagnosis says of a run that was not driven to its end."""
    if coverage >= COMPLETE_PATH:
        return ()
    words = (
        f'only {100 * coverage:.0f} % of the path was recorded; what acts on the rest alone is '
        f'not seen'
    )
    return (Finding('coverage', WARNING, words),)


def failed_gates_of_data(coverage: float, outliers: int, samples: int) -> list[str]:
    """State the quality gates that too little path, or too many outliers, fail."""
    failed = []
    if coverage < MIN_COVERAGE:
        failed.append(
            f'coverage: {100 * coverage:.0f} % of the path driven, '
            f'{100 * MIN_COVERAGE:.0f} % needed'
        )
    if outliers > MAX_OUTLIERS * samples:
        failed.append(
            f'outliers: {100 * outliers / samples:.0f} % of the samples left out, '
            f'{100 * MAX_OUTLIERS:.0f} % allowed'
        )
    return failed
