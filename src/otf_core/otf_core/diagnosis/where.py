# SPDX-License-Identifier: Apache-2.0
"""Where the gap lies: by time, leg, travel, feed, region, beam and frequency, and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis import groupings as by
from otf_core.diagnosis.bands import time_bands, wave_bands
from otf_core.diagnosis.groups import (
    Group,
    leg_rows,
    leg_sums,
    make_groups,
    partition,
    rows_along,
    unevenness,
)
from otf_core.diagnosis.result import Where
from otf_core.diagnosis.structure import Projection, find_structures
from otf_core.diagnosis.views import RunView
from otf_core.machine import AXES

Array = NDArray[np.float64]
Rows = list[dict[str, Any]]

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


def pointing_groups(views: Sequence[RunView], residuals: Sequence[Array]) -> list[Group]:
    """Components of the residual along the machine axes; those along the path are not seen."""
    sums: list[list[Any]] = [[], [], []]
    for view, residual in zip(views, residuals, strict=True):
        for part, rows in leg_rows(view, residual):
            for k in range(3):
                weights = view.axes[:, part, k]
                seen = (weights**2).sum(axis=0)[:, None] > 0.1
                joined = rows_along(rows, weights)
                sums[k].append(leg_sums([joined], seen, seen.sum(axis=0)))
    found = []
    for k, axis in enumerate(AXES):
        found += make_groups([f'along machine {axis}'], 'points', sums[k])
    return found


def groupings_of(views: Sequence[RunView]) -> dict[str, list[by.Grouping]]:
    """Groupings of each list of ``Where`` but that by frequency."""
    return {
        'by_time': [by.by_time(views)],
        'by_path_piece': [by.by_leg(views)],
        'by_axis_and_direction': [
            by.by_line(views),
            *(by.by_sense(views, k) for k in range(3)),
            by.by_feed(views),
        ],
        'by_region': [by.by_region(views)],
        'by_beam': [by.by_distance(views), by.by_azimuth(views), by.by_elevation(views)],
    }


def _leg_details(views: Sequence[RunView], residuals: Sequence[Array]) -> Rows:
    details = []
    for view, residual in zip(views, residuals, strict=True):
        vectors = view.vectors(residual)
        for low, high in view.bounds:
            details.append(
                {
                    'run': view.name,
                    'leg': int(view.leg[low]),
                    'time': [float(view.time[low]), float(view.time[high - 1])],
                    'from': view.q[low].tolist(),
                    'to': view.q[high - 1].tolist(),
                    'mean_um': (1e6 * vectors[low:high].mean(axis=0)).tolist(),
                }
            )
    return details


def total_group(views: Sequence[RunView], residuals: Sequence[Array]) -> Group:
    """All pieces of all runs as one group."""
    indices = [np.zeros(len(v.leg), dtype=np.int64) for v in views]
    return partition(views, indices, ['all'], 'all', residuals)[0]


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


def _all_groups(views: Sequence[RunView], residuals: Sequence[Array]) -> dict[str, list[Group]]:
    groups = {
        name: [g for p in parts for g in partition(views, p.indices, p.labels, p.kind, residuals)]
        for name, parts in groupings_of(views).items()
    }
    groups['by_axis_and_direction'] += pointing_groups(views, residuals)
    groups['by_frequency'] = time_bands(views, residuals)
    for axis in range(3):
        groups['by_frequency'] += wave_bands(views, residuals, axis)
    return groups


def _residuals(views: Sequence[RunView], residual: str) -> list[Array]:
    return [getattr(v, residual) for v in views]


def describe_structure(
    views: Sequence[RunView],
    residual: str = 'residual_before',
    project: Projection | None = None,
) -> str:
    """Shape of a gap without a known cause, in words.

    Parameters
    ----------
    views : sequence of RunView
    residual : str
        'residual_before' or 'residual_after': without or with the causes.
    project : callable, optional
        ``Rows.project``, so that sizes are true ones; see ``structure.find_structures``.
    """
    residuals = _residuals(views, residual)
    return _structure_words(views, residuals, _all_groups(views, residuals), project)


def _stands_out(total: Group, groups: Sequence[Group]) -> bool:
    most = max(g.significance for g in groups)
    return total.significance > SIGNIFICANT or most > MOST_SIGNIFICANT


def _band_words(total: Group, bands: Sequence[Group]) -> list[str]:
    """Name a band that holds most of the excess; the lowest one holds all that is slow."""
    for band in bands[1:]:
        if band.excess > HALF * total.excess and band.significance > SIGNIFICANT:
            share = min(100.0, 100 * band.excess / total.excess)
            return [f'mostly at {band.label} ({share:.0f} % of the excess)']
    return []


def _structure_words(
    views: Sequence[RunView],
    residuals: Sequence[Array],
    groups: Mapping[str, Sequence[Group]],
    project: Projection | None,
) -> str:
    total = total_group(views, residuals)
    every = [g for part in groups.values() for g in part]
    if not _stands_out(total, every):
        return 'no structure beyond noise'
    found = find_structures(views, residuals, project)
    parts = [f'{s.words} ({100 * s.share:.0f} % of the excess)' for s in found]
    if sum(s.share for s in found) < MOSTLY:
        kinds = _kinds(every)
        parts += _band_words(total, kinds.pop('frequency', []))
        parts += [_contrast_words(*pair) for pair in _largest(kinds, total.pieces)]
    return '; '.join(parts) or 'spread evenly over time, path, volume and beam'


def _summary(total: Group, groups: Mapping[str, Sequence[Group]], shape: str) -> str:
    every = [g for part in groups.values() for g in part]
    most = max(every, key=lambda g: g.significance)
    size = f'The residual is {_um(total.rms)}, noise leaves {_um(total.expected)}'
    if not _stands_out(total, every):
        return (
            f'{size}; nothing stands out: of {len(every)} groups {most.label} has the largest '
            f'excess ({most.significance:.1f} standard deviations).'
        )
    points = _pointing_words([g for g in every if g.kind == 'points'])
    return f'{size}; the gap is {_um(_gap(total))}{points}. Where and how: {shape}.'


def where_of(
    views: Sequence[RunView],
    residual: str = 'residual_before',
    project: Projection | None = None,
) -> Where:
    """Tell where the gap lies.

    Parameters
    ----------
    views : sequence of RunView
    residual, project
        See ``describe_structure``.
    """
    residuals = _residuals(views, residual)
    groups = _all_groups(views, residuals)
    shape = _structure_words(views, residuals, groups, project)
    rows: dict[str, Rows] = {k: [g.row() for g in part] for k, part in groups.items()}
    details = _leg_details(views, residuals)
    rows['by_path_piece'] = [r | d for r, d in zip(rows['by_path_piece'], details, strict=True)]
    summary = _summary(total_group(views, residuals), groups, shape)
    return Where(summary=summary, **{name: tuple(part) for name, part in rows.items()})
