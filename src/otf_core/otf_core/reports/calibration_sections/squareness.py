# SPDX-License-Identifier: Apache-2.0
"""Squareness errors as angles in words, in both habits of sign."""

from __future__ import annotations

import numpy as np

from otf_core.model.motions import SQUARENESS
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.quantities import micro
from otf_core.reports.section import Cell, Section, Table

ANGLES = {'C0Y': ('+X', '+Y', 1.0), 'B0Z': ('+X', '+Z', -1.0), 'A0Z': ('+Y', '+Z', 1.0)}
"""Directions between which a squareness error changes the angle, and the sign of the change."""
TILTS = {'C0Y': '+Y to -X', 'B0Z': '+Z to +X', 'A0Z': '+Z to -Y'}
"""What a positive value does."""
ARCSEC = np.pi / 648000


def squareness_words(name: str, value: float) -> str:
    """Say a squareness error as an angle.

    C0Y > 0 tilts +Y to -X, B0Z > 0 tilts +Z to +X, A0Z > 0 tilts +Z to -Y.

    Parameters
    ----------
    name : str
        C0Y, B0Z or A0Z.
    value : float, rad
    """
    one, other, sign = ANGLES[name]
    change = sign * value
    mark = '-' if change < 0 else '+'
    return (
        f'angle between {one} and {other} is 90 deg {mark} {1e6 * abs(change):.1f} urad '
        f'({abs(change) / ARCSEC:.1f} arcsec)'
    )


def section(facts: Facts) -> Section:
    """Return the section."""
    rows: list[tuple[Cell, ...]] = []
    text = ['squareness  value (urad)  u, k = 1 (urad)']
    data, angles = {}, []
    for name in SQUARENESS:
        entry = facts.tables.squareness[name]
        if name in facts.result.not_identifiable:
            rows.append((name, 'not known', '', '', '', ''))
            angles.append(f'{name}: not identifiable in these data.')
            text.append(f'{name:<10}  not identifiable in these data')
            continue
        k = facts.by_name[name].k if name in facts.by_name else 0.0
        larger = ANGLES[name][2] * entry.value
        said = squareness_words(name, entry.value)
        data[name] = {'value': entry.value, 'u': entry.u, 'U': k * entry.u, 'k': k,
                      'larger_than_90': larger, 'words': said}  # fmt: skip
        rows.append((name, micro(entry.value), micro(larger), micro(entry.u), micro(k * entry.u),
                     f'{k:.2f}'))  # fmt: skip
        angles.append(f'{name}: {said}.')
        text.append(f'{name:<10}{1e6 * entry.value:>14.2f}{1e6 * entry.u:>17.2f}  {said}')
    words = (
        *angles,
        'Two habits of sign are in use. Here and in all files the value is a right-handed '
        f'rotation: a positive value tilts {"; ".join(f"{n}: {t}" for n, t in TILTS.items())}. In '
        'the other habit a positive value means an angle larger than 90 degrees; the two differ '
        'for B0Z alone.',
    )
    head = ('', 'Value (urad)', 'Larger than 90 deg positive (urad)', 'u, k = 1 (urad)',
            'U, 95 % (urad)', 'k')  # fmt: skip
    table = Table(head, tuple(rows), numbers=(1, 2, 3, 4, 5))
    return Section('squareness', 'Squareness', words, data, (table,), (*text, ''))
