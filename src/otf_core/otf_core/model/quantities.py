# SPDX-License-Identifier: Apache-2.0
"""A quantity in words: value, expanded uncertainty and a unit that is easy to read."""

from __future__ import annotations

from otf_core.model.expanded import COVERAGE_FACTOR, with_expanded


def readable_unit(unit: str, size: float) -> tuple[float, str]:
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
    factor, name = readable_unit(unit, abs(value))
    wide = COVERAGE_FACTOR * factor * u if u is not None else 0.0
    return f'{with_expanded(factor * value, wide)} {name}'.rstrip()
