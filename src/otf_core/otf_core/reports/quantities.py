# SPDX-License-Identifier: Apache-2.0
"""Numbers of reports as text: micrometres and microradians, positions in millimetres."""

from __future__ import annotations

import math
from collections.abc import Iterable

from otf_core.files.csv_points import tidy

MANY = 1e6
"""Degrees of freedom that are given as infinite."""


def micro(value: float, digits: int = 2) -> str:
    """A value in millionths: um for m, urad for rad."""
    return f'{1e6 * value + 0.0:.{digits}f}'


def micro_unit(unit: str) -> str:
    """Name of millionths of a unit."""
    return 'um' if unit == 'm' else 'urad'


def whole_dof(dof: float) -> int | None:
    """Effective degrees of freedom, cut to the next lower integer (GUM G.4.1); None: infinite."""
    return int(dof) if dof < MANY else None


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


def scaled(unit: str, size: float) -> tuple[float, str]:
    """Factor and unit in which a value is easy to read."""
    if unit == 'm':
        return (1e3, 'mm') if size >= 1e-3 else (1e6, 'um')
    for plain, short in (('rad', 'urad'), ('m', 'um')):
        if unit == plain or (unit.startswith((plain + '/', plain + ' ')) and unit != 'm/m'):
            return 1e6, short + unit[len(plain) :]
    if unit == 'm/m':
        return 1e6, 'um/m'
    if unit == '1/K':
        return 1e6, 'um/(m K)'
    if unit == 's' and 0 < size < 1e-2:
        return 1e3, 'ms'
    return 1.0, unit


def quantity(value: float, u: float | None, unit: str) -> str:
    """Value with expanded uncertainty (k = 2) and unit.

    Parameters
    ----------
    value : float
        SI.
    u : float, optional
        Standard uncertainty.
    unit : str
        SI unit of the value.
    """
    factor, name = scaled(unit, abs(value))
    spread = 2.0 * factor * u if u is not None else math.nan
    if math.isfinite(spread) and spread > 0:
        digits = min(6, max(0, 1 - math.floor(math.log10(spread))))
        number = f'{factor * value:.{digits}f} +/- {spread:.{digits}f}'
    else:
        number = f'{factor * value:.4g}'
    return f'{number} {name}'.rstrip()
