# SPDX-License-Identifier: Apache-2.0
"""Expanded uncertainties: one coverage factor for all that is stated, and values with it as text.

U = k u with k = 2, which covers about 95 %. Where the effective degrees of freedom are 60 or
fewer, Student's t for 95 % is larger than 2 and stands for it (JCGM 100, G.6.4 and G.6.6). Two
significant digits of U are stated and the value is rounded to the same place (JCGM 100, 7.2.6).
"""

from __future__ import annotations

import math

import numpy as np

COVERAGE_FACTOR = 2.0
COVERAGE_PROBABILITY = 0.95
"""Coverage probability of the expanded uncertainties."""
FINEST = 6
"""Decimals that are written at most."""


def coverage_factor(freedom: float) -> float:
    """Coverage factor for whole degrees of freedom: 2, or Student's t for 95 % where larger."""
    if not freedom < 1e9:
        return COVERAGE_FACTOR
    # what scipy.stats calls, and loaded on use: predicting needs none
    from scipy.special import stdtrit

    t = stdtrit(max(1.0, np.floor(freedom)), 0.5 + 0.5 * COVERAGE_PROBABILITY)
    return max(COVERAGE_FACTOR, float(t))


def decimals(wide: float) -> int:
    """Decimals to which a value is rounded that has the expanded uncertainty ``wide``.

    Two significant digits of it; negative where tens or hundreds are rounded.
    """
    if not (math.isfinite(wide) and wide > 0.0):
        return 2
    places = 1 - math.floor(math.log10(wide))
    if round(wide, places) >= 10.0 ** (2 - places):  # 0.0996 is 0.10
        places -= 1
    return min(FINEST, places)


def figure(value: float, wide: float) -> str:
    """A value to the last stated digit of its expanded uncertainty, both in the same unit."""
    places = decimals(wide)
    return f'{round(value, places) + 0.0:.{max(0, places)}f}'


def significant(value: float) -> str:
    """An uncertainty alone, two significant digits."""
    return figure(value, abs(value))


def with_expanded(value: float, wide: float) -> str:
    """Value +/- expanded uncertainty, both in the same unit."""
    if not (math.isfinite(wide) and wide > 0.0):
        return f'{value:.4g}'
    return f'{figure(value, wide)} +/- {figure(wide, wide)}'


def micro_figure(value: float, wide: float, unit: str = 'm') -> str:
    """A value in m or rad as um or urad, to the last stated digit of ``wide``."""
    return f'{figure(1e6 * value, 1e6 * wide)} {micro_unit(unit)}'


def micro_significant(value: float, unit: str = 'm') -> str:
    """An uncertainty in m or rad as um or urad, two significant digits."""
    return f'{significant(1e6 * value)} {micro_unit(unit)}'


def micro_with_expanded(value: float, wide: float, unit: str = 'm') -> str:
    """Value +/- expanded uncertainty in m or rad as um or urad."""
    return f'{with_expanded(1e6 * value, 1e6 * wide)} {micro_unit(unit)}'


def micro_unit(unit: str) -> str:
    """Name of millionths of a unit."""
    return 'um' if unit == 'm' else 'urad'


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
