# SPDX-License-Identifier: Apache-2.0
"""Words on where a gap lies: size, direction, place, band of frequency, shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from otf_core.diagnosis.place.groups import Group, unevenness
from otf_core.diagnosis.place.placement import Placement
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
MAINLY = 75.0
"""Percent of the squared gap from which one axis is named alone."""
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


def _pointing_words(components: Mapping[str, float]) -> str:
    """Axes along which a gap points, by their shares of its square."""
    whole = sum(gap**2 for gap in components.values())
    if whole <= 0.0:
        return ''
    shares = {axis: 100.0 * gap**2 / whole for axis, gap in components.items()}
    axis = max(shares, key=shares.__getitem__)
    if shares[axis] > MAINLY:
        return f'It points along machine {axis} ({shares[axis]:.0f} % of the squared gap)'
    parts = ', '.join(f'{a} {share:.0f} %' for a, share in shares.items())
    return f'Across the path it points along {parts} (of the squared gap)'


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
    """
    if not stands_out(total, groups):
        return NO_STRUCTURE
    parts = [f'{s.words} ({100 * s.share:.0f} % of the excess)' for s in found]
    if sum(s.share for s in found) < MOSTLY:
        kinds = _kinds(groups)
        parts += _band_words(total, kinds.pop('frequency', []))
        parts += [_contrast_words(*pair) for pair in _largest(kinds, total.pieces)]
    return '; '.join(parts) or EVERYWHERE


def summary_words(
    groups: Sequence[Group],
    place: Placement,
    components: Mapping[str, float],
    shape: str,
    *,
    loud: bool,
) -> str:
    """Say in a few sentences where a gap lies and along which axes it points.

    Parameters
    ----------
    groups : sequence of Group
        Of all kinds.
    place : Placement
        In the view that separates most.
    components : mapping of axis to float, m
    shape : str
        What ``structure_words`` returned; empty where the cause is known.
    loud : bool
        Anything stands out: ``stands_out``.
    """
    if not loud:
        most = max(groups, key=lambda g: g.significance)
        return (
            f'No place stands out: of {len(groups)} groups of path pieces, by line, feed, '
            f'volume, time, beam and frequency; the largest excess, of {most.label}, is '
            f'{most.significance:.1f} standard deviations.'
        )
    said = [f'The gap lies {place.words}' if place.words else _everywhere_words(groups)]
    said += [words for words in (_pointing_words(components),) if words]
    if shape and shape != EVERYWHERE:
        said.append(f'Shape: {shape}')
    return '. '.join(said) + '.'


def _everywhere_words(groups: Sequence[Group]) -> str:
    """A gap that no view separates, and the band of frequency that holds most of it."""
    words = (
        'The gap lies all over the run: no group of lines, senses of travel, feeds, places, times '
        'or beams holds clearly more of it than its share of the path'
    )
    bands = [g for g in groups if g.kind == 'frequency']
    whole = sum(max(b.excess, 0.0) * b.pieces for b in bands)
    for band in bands[1:]:
        share = max(band.excess, 0.0) * band.pieces / max(whole, 1e-300)
        if share > HALF and band.significance > SIGNIFICANT:
            words += f'; {100 * share:.0f} % of the squared gap is at {band.label} in time'
    return words
