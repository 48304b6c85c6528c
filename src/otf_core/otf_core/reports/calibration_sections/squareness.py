# SPDX-License-Identifier: Apache-2.0
"""Squareness errors as angles in words, in both habits of sign."""

from __future__ import annotations

import numpy as np

from otf_core.model.expanded import figure, significant, with_expanded
from otf_core.model.motions import SQUARENESS
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.section import Cell, Section, Table

ANGLES = {'C0Y': ('+X', '+Y', 1.0), 'B0Z': ('+X', '+Z', -1.0), 'A0Z': ('+Y', '+Z', 1.0)}
"""Directions between which a squareness error changes the angle, and the sign of the change."""
TILTS = {'C0Y': '+Y to -X', 'B0Z': '+Z to +X', 'A0Z': '+Z to -Y'}
"""What a positive value does."""
ARCSEC = np.pi / 648000


def squareness_words(name: str, value: float, wide: float) -> str:
    """Say a squareness error as an angle, to the last stated digit of its U.

    C0Y > 0 tilts +Y to -X, B0Z > 0 tilts +Z to +X, A0Z > 0 tilts +Z to -Y.

    Parameters
    ----------
    name : str
        C0Y, B0Z or A0Z.
    value, wide : float, rad
        The error and its expanded uncertainty.
    """
    one, other, sign = ANGLES[name]
    change = sign * value
    mark = '-' if change < 0 else '+'
    return (
        f'angle between {one} and {other} is 90 deg {mark} '
        f'{figure(1e6 * abs(change), 1e6 * wide)} urad '
        f'({figure(abs(change) / ARCSEC, wide / ARCSEC)} arcsec)'
    )


def section(facts: Facts) -> Section:
    """Return the section."""
    result, bound = facts.result, facts.result.offset_bound
    rows: list[tuple[Cell, ...]] = []
    text = ['squareness, urad: value +/- U of the headline; u of the files, k = 1']
    data, angles = {}, []
    for name in SQUARENESS:
        entry = facts.tables.squareness[name]
        if name in result.not_identifiable:
            rows.append((name, 'not known', '', '', '', '', ''))
            angles.append(f'{name}: not identifiable in these data.')
            text.append(f'{name}  not identifiable in these data')
            continue
        wide = float(result.expanded[name][0])
        larger = ANGLES[name][2] * entry.value
        said, holds = squareness_words(name, entry.value, wide), bound.words(name)
        data[name] = {'value': entry.value, 'u': entry.u, 'U': wide, 'larger_than_90': larger,
                      'words': said, 'holds': holds}  # fmt: skip
        figures = [figure(1e6 * v, 1e6 * wide) for v in (entry.value, larger)]
        rows.append((name, *figures, significant(1e6 * wide), significant(1e6 * entry.u),
                     holds or 'at any target offset'))  # fmt: skip
        angles.append(f'{name}: {said}{f", {holds}" if holds else ""}.')
        text.append(
            f'{name}  {with_expanded(1e6 * entry.value, 1e6 * wide):<20}'
            f'u {significant(1e6 * entry.u):<8}{said}{f"; {holds}" if holds else ""}'
        )
    words = (
        *angles,
        'Two habits of sign are in use. Here and in all files the value is a right-handed '
        f'rotation: a positive value tilts {"; ".join(f"{n}: {t}" for n, t in TILTS.items())}. In '
        'the other habit a positive value means an angle larger than 90 degrees; the two differ '
        'for B0Z alone.',
    )
    head = ('', 'Value (urad)', 'Larger than 90 deg positive (urad)', 'U (urad)',
            'u in the files, k = 1 (urad)', 'Holds')  # fmt: skip
    table = Table(head, tuple(rows), numbers=(1, 2, 3, 4))
    return Section('squareness', 'Squareness', words, data, (table,), (*text, ''))
