# SPDX-License-Identifier: Apache-2.0
"""Numbers of reports as text: micrometres and microradians, positions in millimetres."""

from __future__ import annotations

from collections.abc import Iterable

from otf_core.files.csv_points import tidy

INFINITE_DOF = 1e6
"""Degrees of freedom that are given as infinite."""


def micro(value: float, digits: int = 2) -> str:
    """A value in millionths: um for m, urad for rad."""
    return f'{1e6 * value + 0.0:.{digits}f}'


def micro_unit(unit: str) -> str:
    """Name of millionths of a unit."""
    return 'um' if unit == 'm' else 'urad'


def whole_dof(dof: float) -> int | None:
    """Effective degrees of freedom, cut to the next lower integer (GUM G.4.1); None: infinite."""
    return int(dof) if dof < INFINITE_DOF else None


def dof_words(dof: float) -> str:
    """The same in words."""
    whole = whole_dof(dof)
    return 'infinite' if whole is None else str(whole)


def place(point: Iterable[float]) -> str:
    """A point, m, in words, in mm."""
    return ', '.join(f'{a} {millimetres(v)}' for a, v in zip('XYZ', point, strict=True)) + ' mm'


def millimetres(value: float) -> str:
    """A position, m, in mm to 0.1 mm, without zeros at its end."""
    return f'{tidy(round(1e3 * value, 1)):g}'


def listed(names: Iterable[str]) -> str:
    """Names with commas and a last 'and'."""
    found = list(names)
    return ' and '.join([', '.join(found[:-1]), found[-1]] if len(found) > 1 else found)
