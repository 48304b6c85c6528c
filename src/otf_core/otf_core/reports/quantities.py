# SPDX-License-Identifier: Apache-2.0
"""Numbers of reports as text: micrometres and microradians, places in metres."""

from __future__ import annotations

from collections.abc import Iterable

from otf_core.files.csv_points import tidy


def micro(value: float, digits: int = 2) -> str:
    """A value in millionths: um for m, urad for rad."""
    return f'{1e6 * value + 0.0:.{digits}f}'


def micro_unit(unit: str) -> str:
    """Name of millionths of a unit."""
    return 'um' if unit == 'm' else 'urad'


def place(point: Iterable[float]) -> str:
    """A point in words, m."""
    return ', '.join(f'{a} {tidy(v):.3f}' for a, v in zip('XYZ', point, strict=True)) + ' m'


def listed(names: Iterable[str]) -> str:
    """Names with commas and a last 'and'."""
    found = list(names)
    return ' and '.join([', '.join(found[:-1]), found[-1]] if len(found) > 1 else found)
