# SPDX-License-Identifier: Apache-2.0
"""Where the gap lies: by time, leg, travel, feed, region, beam and frequency, and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.place import groups as by
from otf_core.diagnosis.place.groups import (
    Group,
    RunView,
    band_groups,
    leg_rows,
    leg_sums,
    make_groups,
    noise_factor,
    partition,
    rows_along,
    unevenness,
    usual_bands,
)
from otf_core.diagnosis.place.placement import Placement, place_in_order, separations
from otf_core.diagnosis.place.structure import GapStructure, Projection, find_structures
from otf_core.model.frames import XYZ

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
    contrasts = []
    for kind, groups in kinds.items():
        if kind in ('path piece', 'points') or kind.startswith('waves'):
            continue
        big = [g for g in groups if g.pieces >= FEWEST_PIECES * pieces]
        worth = unevenness(big)
        if worth < UNEVEN:
            continue
        most, least = max(big, key=lambda g: g.excess), min(big, key=lambda g: g.excess)
        if most.significance > SIGNIFICANT and _gap(most) > CONTRAST * _gap(least):
            contrasts.append((worth, most, least))
    contrasts.sort(key=lambda item: -item[0])
    return [(most, least) for _, most, least in contrasts[:MOST_KINDS]]


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
    """Return whether there is anything beyond noise."""
    most = max(g.significance for g in groups)
    return total.significance > SIGNIFICANT or most > MOST_SIGNIFICANT


def _band_words(total: Group, bands: Sequence[Group]) -> list[str]:
    """Name a band that holds most of the excess; the lowest one holds all that is slow."""
    for band in bands[1:]:
        if band.excess > HALF * total.excess and band.significance > SIGNIFICANT:
            share = min(100.0, 100 * band.excess / total.excess)
            return [f'mostly at {band.label} ({share:.0f} % of the excess)']
    return []


def structure_words(
    total: Group, groups: Sequence[Group], structures: Sequence[GapStructure]
) -> str:
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
    parts = [f'{s.words} ({100 * s.share:.0f} % of the excess)' for s in structures]
    if sum(s.share for s in structures) < MOSTLY:
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
    """State in a few sentences where a gap lies and along which axes it points.

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


Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Where:
    """Where the gap lies; each list holds rows of plain data.

    Every row has ``label``, ``rms_um`` (real run), ``expected_um`` (its simulation) and
    ``significance`` (standard deviations of the excess). Over all pieces rms and expected are the
    residuals of the run and of its simulation, so the gap is that of the headline.

    Attributes
    ----------
    summary : str
        In words.
    view, grouping : str
        View in which the gap has a place, 'path', 'volume', 'time' or 'beam', and the grouping of
        it that separates most; empty where none does.
    share_percent : float
        Share of the variance of the gap between its groups, beyond chance: ``separation``.
    parts : tuple of mapping
        Its groups: ``label``, ``gap_um`` and the shares of squared gap and path they hold.
    separation : tuple of mapping
        Every grouping with its share, the largest first.
    components_um : mapping of axis to float
        The gap along machine X, Y and Z; their squares add up to that of the gap.
    """

    summary: str = ''
    view: str = ''
    grouping: str = ''
    share_percent: float = 0.0
    parts: tuple[Mapping[str, Any], ...] = ()
    separation: tuple[Mapping[str, Any], ...] = ()
    components_um: Mapping[str, float] = field(default_factory=dict)
    by_time: tuple[Mapping[str, Any], ...] = ()
    by_axis_and_direction: tuple[Mapping[str, Any], ...] = ()
    by_path_piece: tuple[Mapping[str, Any], ...] = ()
    by_region: tuple[Mapping[str, Any], ...] = ()
    by_beam: tuple[Mapping[str, Any], ...] = ()
    by_frequency: tuple[Mapping[str, Any], ...] = ()


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
    groups = []
    for k, axis in enumerate(XYZ):
        groups += make_groups([f'along machine {axis}'], 'points', sums[k])
    return groups


def components(views: Sequence[RunView], residuals: Sequence[Array]) -> dict[str, float]:
    """Root mean square of the gap along each machine axis, m.

    Over all pieces, those that see nothing along an axis included, so that the squares add up to
    that of the whole gap. Where noise makes one of them negative it is zero.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (c, p), m
    """
    square, pieces = np.zeros(3), 0
    whole = 0.0
    for view, residual in zip(views, residuals, strict=True):
        square += (view.vectors(residual) ** 2).sum(axis=0)
        square -= np.einsum('cp,cpk->k', view.expected**2, view.axes**2)
        whole += float((residual**2).sum() - (view.expected**2).sum())
        pieces += len(view.leg)
    positive = np.maximum(square, 0.0)
    if whole <= 0.0 or positive.sum() <= 0.0:
        return dict.fromkeys(XYZ, 0.0)
    sizes = np.sqrt(positive / positive.sum() * whole / pieces)
    return dict(zip(XYZ, sizes.tolist(), strict=True))


def groupings_of(views: Sequence[RunView]) -> dict[str, list[by.Grouping]]:
    """Groupings of each list of ``Where`` but that by frequency."""
    return {
        'by_time': [by.by_time(views)],
        'by_path_piece': [by.by_leg(views)],
        'by_axis_and_direction': [
            by.by_line(views),
            *(by.by_sense(views, k) for k in range(len(views[0].axis_names))),
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
    [[total]] = partition(views, [by.Grouping('all', ['all'], indices)], residuals)
    return total


def _all_groups(views: Sequence[RunView], residuals: Sequence[Array]) -> dict[str, list[Group]]:
    groupings = groupings_of(views)
    every = [part for parts in groupings.values() for part in parts]
    group_lists = iter(partition(views, every, residuals))
    groups = {
        name: [group for _ in parts for group in next(group_lists)]
        for name, parts in groupings.items()
    }
    groups['by_axis_and_direction'] += pointing_groups(views, residuals)
    [bands] = band_groups(views, [residuals], usual_bands(views))
    groups['by_frequency'] = [group for own in bands for group in own]
    return groups


@dataclass(frozen=True)
class _Located:
    """Groups of all kinds, words on the shape of the gap, and whether there is one."""

    total: Group
    groups: dict[str, list[Group]]
    shape: str
    loud: bool = True

    @property
    def every(self) -> list[Group]:
        return [g for part in self.groups.values() for g in part]


def _located(
    views: Sequence[RunView],
    residuals: Sequence[Array],
    project: Projection | None,
    known: str = '',
    *,
    certain: bool = True,
) -> _Located:
    total, groups = total_group(views, residuals), _all_groups(views, residuals)
    located = _Located(total, groups, known)
    located = replace(located, loud=stands_out(total, located.every))
    if known and certain:
        return located
    loud = located.loud
    structures = find_structures(views, residuals, project) if loud else []
    words = structure_words(total, located.every, structures)
    if known:
        says_most = sum(s.share for s in structures) > MOSTLY
        words = f'{known}; {words}' if says_most else known
    return replace(located, shape=words)


def describe_structure(
    views: Sequence[RunView],
    residual: str = 'residual_before',
    project: Projection | None = None,
) -> str:
    """Shape of a gap without a known cause, in words.

    Parameters
    ----------
    residual : str
        'residual_before' or 'residual_after': without or with the causes.
    project : callable, optional
        ``Rows.project``, so that sizes are true ones; see ``structure.find_structures``.
    """
    return _located(views, [getattr(v, residual) for v in views], project).shape


def where_and_shape(
    views: Sequence[RunView],
    residual: str = 'residual_before',
    project: Projection | None = None,
    known: str = '',
    *,
    certain: bool = True,
    simulated: float | None = None,
) -> tuple[Where, str]:
    """Determine where the gap lies, and its shape as ``describe_structure`` does, in one search.

    Parameters
    ----------
    residual, project
        See ``describe_structure``.
    known : str
        What explains the gap, in words.
    certain : bool
        No other shape is looked for then, which could only contradict; else one is stated beside
        ``known`` if it says most.
    simulated : float, m, optional
        Residual that the simulation leaves: what is stated counts as noise what makes that up.
    """
    residuals = [getattr(v, residual) for v in views]
    located = _located(views, residuals, project, known, certain=certain)
    noise = 1.0 if simulated is None else noise_factor(views, simulated)
    shown = [v.with_noise(noise) for v in views]
    rows: dict[str, Rows] = {
        name: [g.with_noise(noise).row() for g in part] for name, part in located.groups.items()
    }
    details = _leg_details(views, residuals)
    rows['by_path_piece'] = [r | d for r, d in zip(rows['by_path_piece'], details, strict=True)]
    along = components(shown, residuals)
    of_axis = {f'along machine {axis}': 1e6 * gap for axis, gap in along.items()}
    for row in rows['by_axis_and_direction']:
        if row['label'] in of_axis:
            row['gap_um'] = of_axis[row['label']]
    ranking = separations(shown, residuals)
    place = place_in_order(shown, residuals, ranking)
    shape = located.shape.removeprefix(known).lstrip('; ') if known else located.shape
    every = [g.with_noise(noise) for g in located.every]
    where = Where(
        summary=summary_words(every, place, along, shape, loud=located.loud),
        separation=tuple(
            {'view': s.view, 'grouping': s.grouping.kind, 'share_percent': _percent(s.share)}
            for s in ranking
        ),
        components_um={axis: 1e6 * gap for axis, gap in along.items()},
        by_time=tuple(rows['by_time']),
        by_axis_and_direction=tuple(rows['by_axis_and_direction']),
        by_path_piece=tuple(rows['by_path_piece']),
        by_region=tuple(rows['by_region']),
        by_beam=tuple(rows['by_beam']),
        by_frequency=tuple(rows['by_frequency']),
    )
    if located.loud and place.words:
        where = _at_place(where, place)
    return where, located.shape


def _percent(share: float) -> float:
    return 100.0 * max(share, 0.0)


def _at_place(where: Where, place: Placement) -> Where:
    """Add the view that separates most, and what of the gap its groups hold."""
    best = place.separation
    parts = []
    for part in place.parts:
        gap, path = place.share([part])
        parts.append({
            'label': part.label,
            'gap_um': 1e6 * part.gap,
            'share_of_gap_percent': 100.0 * gap,
            'share_of_path_percent': 100.0 * path,
        })  # fmt: skip
    return replace(
        where,
        view=best.view,
        grouping=best.grouping.kind,
        share_percent=_percent(best.share),
        parts=tuple(parts),
    )
