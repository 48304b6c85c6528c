# SPDX-License-Identifier: Apache-2.0
"""Words on where a gap lies: size, direction, place, band of frequency, shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from otf_core.diagnosis.place.groups import Group, unevenness
from otf_core.diagnosis.place.structure import GapStructure

SIGNIFICANT, MOST_SIGNIFICANT = 4.0, 5.5
"""Standard deviations of an excess that is worth a word: of all pieces, and of the largest of
some hundred groups."""
UNEVEN = 10.0
"""See ``groups.unevenness``."""
CONTRAST = 1.3
"""The largest group of a kind is named if its gap is this many times that of the rest."""
MOST_KINDS = 2
MOSTLY = 0.7
"""Share of the excess from which shapes say enough."""
HALF = 0.5
"""Share of the excess from which a band of frequency is named."""
FEWEST_PIECES = 0.01
"""Share of all pieces below which a group is not named in words."""
NO_STRUCTURE = 'no structure beyond noise'
EVERYWHERE = 'spread evenly over time, path, volume and beam'
"""Shapes of a gap that has no place."""


def _gap(group: Group) -> float:
    return float(np.sqrt(max(group.excess, 0.0)))


def _largest(kinds: Mapping[str, Sequence[Group]], pieces: int) -> list[tuple[Group, Group]]:
    """Of the kinds along which the gap is most uneven: largest and smallest group."""
    found = []
    for kind, groups in kinds.items():
        if kind in ('path piece', 'points') or kind.startswith('waves'):
            continue
        big = [g for g in groups if g.pieces >= FEWEST_PIECES * pieces]
        worth = unevenness(big)
        if worth < UNEVEN:
            continue
        most, least = max(big, key=lambda g: g.excess), min(big, key=lambda g: g.excess)
        if most.significance > SIGNIFICANT and _gap(most) > CONTRAST * _gap(least):
            found.append((worth, most, least))
    found.sort(key=lambda item: -item[0])
    return [(most, least) for _, most, least in found[:MOST_KINDS]]


def _um(value: float) -> str:
    return f'{1e6 * value:.2g} um'


def _pointing_words(points: Sequence[Group]) -> str:
    gaps = sorted(((_gap(g), g.label) for g in points), reverse=True)
    if not gaps or gaps[0][0] <= 0:
        return ''
    if len(gaps) < 2 or gaps[0][0] > 2.0 * gaps[1][0]:
        return f', mostly {gaps[0][1]} ({_um(gaps[0][0])})'
    parts = ', '.join(f'{label[-1]} {_um(gap)}' for gap, label in sorted(gaps, key=lambda g: g[1]))
    return f', along {parts}'


PLACES = {
    'time': 'from {}',
    'line': 'on {} lines',
    'sense': 'with {}',
}


def _contrast_words(most: Group, least: Group) -> str:
    sizes = f'({_um(_gap(most))}; {least.label}: {_um(_gap(least))})'
    place = PLACES.get(most.kind.split()[0], 'at {}').format(most.label)
    if most.kind == 'distance':
        far = float(most.label.split()[1]) > float(least.label.split()[1])
        return f'larger {"far from" if far else "close to"} the tracker, {place} {sizes}'
    return f'largest {place} {sizes}'


def _kinds(groups: Sequence[Group]) -> dict[str, list[Group]]:
    kinds: dict[str, list[Group]] = {}
    for group in groups:
        kinds.setdefault(group.kind, []).append(group)
    return kinds


def stands_out(total: Group, groups: Sequence[Group]) -> bool:
    """Tell whether there is anything beyond noise."""
    most = max(g.significance for g in groups)
    return total.significance > SIGNIFICANT or most > MOST_SIGNIFICANT


def _band_words(total: Group, bands: Sequence[Group]) -> list[str]:
    """Name a band that holds most of the excess; the lowest one holds all that is slow."""
    for band in bands[1:]:
        if band.excess > HALF * total.excess and band.significance > SIGNIFICANT:
            share = min(100.0, 100 * band.excess / total.excess)
            return [f'mostly at {band.label} ({share:.0f} % of the excess)']
    return []


def structure_words(total: Group, groups: Sequence[Group], found: Sequence[GapStructure]) -> str:
    """Describe the shape of a gap.

    Parameters
    ----------
    total : Group
        All pieces.
    groups : sequence of Group
        Of all kinds.
    found : sequence of GapStructure
    """
    if not stands_out(total, groups):
        return NO_STRUCTURE
    parts = [f'{s.words} ({100 * s.share:.0f} % of the excess)' for s in found]
    if sum(s.share for s in found) < MOSTLY:
        kinds = _kinds(groups)
        parts += _band_words(total, kinds.pop('frequency', []))
        parts += [_contrast_words(*pair) for pair in _largest(kinds, total.pieces)]
    return '; '.join(parts) or EVERYWHERE


def summary_words(total: Group, groups: Sequence[Group], shape: str) -> str:
    """Say in one or two sentences how large the gap is, where it points and where it lies.

    Parameters
    ----------
    total, groups
        See ``structure_words``.
    shape : str
        What that returned.
    """
    size = f'The residual is {_um(total.rms)}, noise leaves {_um(total.expected)}'
    if not stands_out(total, groups):
        most = max(groups, key=lambda g: g.significance)
        return (
            f'{size}; nothing stands out: of {len(groups)} groups {most.label} has the largest '
            f'excess ({most.significance:.1f} standard deviations).'
        )
    points = _pointing_words([g for g in groups if g.kind == 'points'])
    return f'{size}; the gap is {_um(_gap(total))}{points}. Where and how: {shape}.'
