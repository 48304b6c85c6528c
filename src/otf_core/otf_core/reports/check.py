# SPDX-License-Identifier: Apache-2.0
"""The check of a recording as text."""

from __future__ import annotations

from otf_core.checking.checks import ERROR, FORECAST, Checked, CheckReport


def format_check(report: CheckReport) -> str:
    """Return the text for a terminal: the answer, what to expect, what is wrong, the table."""
    wrong = sum(p.severity == ERROR for _, p in report.problems)
    doubtful = len(report.problems) - wrong
    counted = [
        f'{count} {word}{"s" if count > 1 else ""}'
        for count, word in ((wrong, 'error'), (doubtful, 'warning'))
        if count
    ]
    answer = 'usable' if report.usable else 'NOT USABLE'
    lines = [f'{report.name}: {answer}{", " if counted else ""}{", ".join(counted)}']
    expected = report.checked.get(FORECAST.name, Checked()).words
    lines += [*expected.splitlines(), '']
    lines += [f'{p.severity.upper()} {name}: {p.what}' for name, p in report.problems]
    lines += [''] if report.problems else []
    width = max(len(name) for name in report.checked)
    lines += [
        f'{name:<{width}}  {found.words}'
        for name, found in report.checked.items()
        if found.words and name != FORECAST.name
    ]
    return '\n'.join(lines)
