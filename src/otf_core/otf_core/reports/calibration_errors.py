# SPDX-License-Identifier: Apache-2.0
"""Errors of a calibration in charts and tables: the volume, all motions, both senses of travel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtr

from otf_core.arrays import Array, Index
from otf_core.files.writing import tidy
from otf_core.model.chain import nominal_position
from otf_core.model.expanded import (
    figure,
    micro_unit,
    micro_with_expanded,
    significant,
)
from otf_core.model.frames import XYZ
from otf_core.model.machine import TABLE, Machine
from otf_core.model.motions import ErrorMotion, unit_of
from otf_core.model.tables import ErrorTables
from otf_core.prediction.calibration_document import (
    FAIL,
    LIMIT_MEANING,
    OPEN,
    PASS,
    UNKNOWN,
    LimitVerdict,
    PackedCovariance,
    tables_from_dict,
)
from otf_core.reports.charts import (
    LEVELS,
    Bar,
    Panel,
    Scale,
    bars,
    heat_classes,
    heat_key,
    heat_step,
    polyline,
    scale_around,
    svg,
    words,
)
from otf_core.reports.rendering import State, micro
from otf_core.reports.scene import (
    Dots,
    Item,
    Magnification,
    Strokes,
    box,
    box_around,
    magnification,
    scene,
    tracker_items,
)

MOODS = {PASS: 'good', FAIL: 'bad', OPEN: 'open', UNKNOWN: 'open'}
DRAWN_POINTS, DOT_RADII, DRAWN_RUNS = 64, 8, 3
"""Points of the volume that are drawn, about; different radii; runs."""
ARROW_REACH = 0.9
"""Length of the longest arrow, in distances between arrows along the shortest edge of a cube."""
BOUND = '*'
"""Stands behind the name of an error that holds at one target offset only."""
CIRCLE, MAGNIFIED, CENTRE = 70.0, 35.0, 120.0
"""px; radius of the circle of a radial motion, of the largest motion on it, and its centre."""
LIMIT_HEIGHT_RATIO = 4.0
"""Height of a limit, in that of what is drawn, up to which it is drawn."""


@dataclass(frozen=True)
class Content:
    """A document, and what several parts of its page are worked out from."""

    doc: Mapping[str, Any]

    @cached_property
    def tables(self) -> ErrorTables:
        """Error tables."""
        return tables_from_dict(self.doc, 'error_tables.json').tables

    @property
    def machine(self) -> Machine:
        """The machine as set up in the first run."""
        return self.tables.machine

    @cached_property
    def entries(self) -> dict[str, Mapping[str, Any]]:
        """Entries of motions and scalars by name."""
        return {**self.doc['motions'], **self.doc['squareness'], **self.doc['location']}

    @cached_property
    def hidden(self) -> set[str]:
        """Errors that the data do not determine."""
        return set(self.doc['not_identifiable'])

    @cached_property
    def wide(self) -> dict[str, Array]:
        """Expanded uncertainty of scalars (1,) and nodes (k,), m and rad; zero if not known."""
        return {
            name: (entry['k'] or 0.0) * np.atleast_1d(entry['u'])
            for name, entry in self.entries.items()
        }

    @cached_property
    def limits(self) -> dict[str, Mapping[str, Any]]:
        """Limits with their states by name."""
        return {one['name']: one for one in self.doc['verdicts']['machine']['limits']}

    @cached_property
    def grid(self) -> Array:
        """Nominal points (n, 3), m, at which the volumetric error is stated."""
        position = np.array(self.doc['volumetric_error']['position'])
        return nominal_position(self.machine, position)

    @cached_property
    def error(self) -> Array:
        """Error vectors there, shape (n, 3), m."""
        return np.array(self.doc['volumetric_error']['error'])

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Corners of the box around the volume, m."""
        return box_around(self.grid)

    @property
    def covariance(self) -> Array:
        """Covariance (m, m) of scalars and nodes."""
        packed = PackedCovariance.from_dict(self.doc['covariance'], 'covariance')
        return np.asarray(packed.unpack(packed.size))

    @property
    def both_ways(self) -> bool:
        """True if forward and backward travel differ in this calibration."""
        return any(own['identifiable'] for own in self.doc['reversal']['motions'].values())

    @property
    def alone(self) -> list[tuple[str, float]]:
        """What every error makes alone, root mean square, m; largest first."""
        return sorted(self.doc['volumetric_error']['alone'].items(), key=lambda pair: -pair[1])

    def worst_place(self) -> str:
        """Axis positions of the longest error vector: to 0.1 mm and 0.1 deg."""
        worst = int(np.argmax(np.linalg.norm(self.error, axis=1)))
        parts: dict[str, list[str]] = {}
        position = self.doc['volumetric_error']['position'][worst]
        for (name, axis), value in zip(self.machine.axes.items(), position, strict=True):
            factor, unit = axis.shown
            parts.setdefault(unit, []).append(f'{name} {tidy(round(factor * value, 1)):g}')
        return ', '.join(f'{", ".join(own)} {unit}' for unit, own in parts.items())

    def position(self, name: str, node: int) -> str:
        """Place of a node of a motion."""
        factor, unit = self.machine.axes[name[2]].shown
        return f'{tidy(factor * self.entries[name]["position"][node]):.6g} {unit}'


# The volume, and all errors with limits.


def _drawn(content: Content) -> Index:
    """Which points of the volume are drawn: every other of a lattice, the first of others."""
    size, axes = len(content.grid), len(content.machine.axis_names)
    count = round(size ** (1 / axes))
    if count**axes != size or axes > 3:
        return np.arange(min(size, DRAWN_POINTS))
    use = np.arange(0, count, 2)
    every = np.arange(size).reshape((count,) * axes)
    return np.asarray(every[np.ix_(*[use] * axes)].ravel())


def trackers(content: Content) -> list[Item]:
    """Marks of the places of the tracker, runs from one place once; of one on the table."""
    places: list[Array] = []
    for run in content.doc['runs'] if content.machine.tracker.link == TABLE else ():
        own = np.array(run['alignment']['translation'])
        if all(np.linalg.norm(own - other) > 1e-2 for other in places):
            places.append(own)
    return [item for at in places for item in tracker_items(at, *content.box)]


def arrow_items(
    grid: Array, error: Array, step: float, shown: Magnification, kind: str = 'heat arrow'
) -> list[Item]:
    """Error vectors (n, 3), m, coloured by length in classes of ``step``, um."""
    classes = heat_classes(1e6 * np.linalg.norm(error, axis=1), step)
    ends = np.stack([grid, grid + shown.factor * error], axis=1)
    return [Strokes(f'{kind} h{level}', ends[classes == level], arrows=True)
            for level in range(LEVELS) if np.any(classes == level)]  # fmt: skip


def volume_charts(content: Content) -> tuple[str, str, str]:
    """The volume before and after at one scale, and the key of its colours."""
    k = content.doc['headline']['k']
    size = k * np.linalg.norm(content.doc['volumetric_error']['u'], axis=1)
    length = np.linalg.norm(content.error, axis=1)
    step, (low, high), at = heat_step(1e6 * length), content.box, _drawn(content)
    spacing = float((high - low).min()) / (DRAWN_POINTS ** (1 / 3) - 1.0)
    shown = magnification(float(max(length.max(), size.max())), ARROW_REACH * spacing)
    frame: list[Item] = [*box(low, high), *trackers(content)]
    grid, own = content.grid[at], size[at]
    arrows = arrow_items(grid, content.error[at], step, shown)
    order = np.array_split(np.argsort(own), min(DOT_RADII, len(own)))
    dots = [Dots('after disc', grid[part], shown.factor * float(own[part].mean()))
            for part in order]  # fmt: skip
    return (
        scene([*frame, *arrows], low, high, 'error vectors in the volume', shown=shown),
        scene([*frame, *dots], low, high, 'uncertainty after compensation in the volume',
              shown=shown),
        heat_key(step, 1e6 * float(length.max()), 'µm'),
    )  # fmt: skip


def bound_sentence(doc: Mapping[str, Any]) -> str:
    """Which errors hold at one target offset only; may be empty."""
    return str(doc['target_offset_bound']['sentence'])


def starred(content: Content, name: str) -> str:
    """Name of an error, with a star where it holds at one target offset only."""
    return f'{name}{BOUND}' if name in content.doc['target_offset_bound']['contains'] else name


def limit_of(content: Content, name: str) -> float | None:
    """Limit that machine.yaml states for an error, m or rad; or None."""
    return content.machine.limits.values.get(name) if content.machine.limits else None


def _limit_kind(content: Content, name: str, otherwise: str = 'after') -> str:
    """Class of a bar or band by the state of its limit."""
    state = content.limits.get(name, {}).get('state')
    return MOODS[state] if state and state != UNKNOWN else otherwise


def error_bars(content: Content) -> list[str]:
    """All errors as bars with U and limits: displacements, then angles."""
    rows: dict[str, list[Bar]] = {'m': [], 'rad': []}
    for name, own in content.doc['sizes'].items():
        limit, unit = limit_of(content, name), own['unit']
        mark, stated = None, ''
        if limit is not None:
            mark, stated = 1e6 * limit, f', limit {1e6 * limit:g}'
        if own['size'] is None:
            rows[unit].append(Bar(name, (), f'not known{stated}', mark))
            continue
        value, wide = 1e6 * own['size'], 1e6 * own['k'] * own['u']
        label = f'{micro_with_expanded(own["size"], 1e-6 * wide, unit)}{stated}'
        rows[unit].append(Bar(starred(content, name), ((value, _limit_kind(content, name)),),
                              label, mark, (max(value - wide, 0.0), value + wide)))  # fmt: skip
    return [bars(own, f'size of all errors in {micro_unit(unit)}', names=44.0, width=480.0)
            for unit, own in rows.items()]  # fmt: skip


def limit_key(content: Content) -> list[tuple[str, str]]:
    """What the colours of the bars mean, where there are limits."""
    sizes = content.doc['sizes']
    limited = [n for n in sizes if limit_of(content, n) is not None]
    if not limited:
        return []
    states = {content.limits[n]['state'] for n in limited if sizes[n]['size'] is not None}
    keys = [('after-key', 'no limit stated')] if len(limited) < len(sizes) else []
    return keys + [(f'{MOODS[s]}-key', s) for s in (PASS, OPEN, FAIL) if s in states]


def limit_row(one: Mapping[str, Any]) -> tuple[Any, ...]:
    """Quantity, value, U, limit, unit and state of a limit."""
    value, wide = 1e6 * one['value'], 1e6 * one['k'] * one['u']
    shown = '' if one['state'] == UNKNOWN else figure(value, wide or value)
    return (LIMIT_MEANING.get(one['name'], one['name']), shown, significant(wide) if wide else '',
            f'{1e6 * one["limit"]:g}', micro_unit(one['unit']),
            State(one['state'], MOODS[one['state']]))  # fmt: skip


def limit_lines(content: Content) -> list[str]:
    """Limits that are not proven to be kept, a line each."""
    judged = (LimitVerdict.from_dict(one) for one in content.limits.values())
    return [one.words for one in judged if one.state != PASS]


def warnings(doc: Mapping[str, Any]) -> list[str]:
    """Warnings but that on typical contributions, which the headline states."""
    typical = doc['typical_systematic'] or {}
    return [w for w in doc['warnings'] if w != typical.get('sentence')]


def needs(content: Content) -> list[str]:
    """Errors that the data do not show and what would show them, those of one need together.

    Without the rotations that the sentence on the target offset names already.
    """
    named = {r for own in content.doc['target_offset_bound']['contains'].values() for r in own}
    by_need: dict[str, list[str]] = {}
    for name in content.doc['not_identifiable']:
        if name not in named:
            by_need.setdefault(content.entries[name].get('needs') or '', []).append(name)
    return [', '.join(own) + (f' (needs {n})' if n else '') for n, own in by_need.items()]


# Motions, squareness, location, reflectors.


def role(motion: ErrorMotion) -> str:
    """What a motion is called."""
    if motion.axis in XYZ:
        if motion.is_translation:
            return 'positioning' if motion.is_positioning else 'straightness'
        return 'roll' if motion.along == motion.place else f'rotation about {XYZ[motion.along]}'
    if motion.is_positioning:
        return 'angular positioning'
    if not motion.is_translation:
        return f'tilt about {XYZ[motion.along]}'
    axial = motion.along == 'ABC'.index(motion.axis)
    return 'axial motion' if axial else f'radial motion in {motion.direction}'


def largest_motions(content: Content) -> Iterator[str]:
    """The motions that reach farthest from their zero, and where."""
    for unit, kind in (('m', 'displacement'), ('rad', 'rotation')):
        known = [n for n in map(str, content.machine.motions)
                 if n not in content.hidden and unit_of(n) == unit]  # fmt: skip
        if not known:
            continue
        name = max(known, key=lambda n: float(np.abs(content.entries[n]['value']).max()))
        value = np.array(content.entries[name]['value'])
        k = int(np.abs(value).argmax())
        size = micro_with_expanded(float(value[k]), float(content.wide[name][k]), unit)
        yield (f'Largest {kind}: {name}, {role(ErrorMotion.of(name))}, {size} at {name[2]} '
               f'{content.position(name, k)} (U, 95 %).')  # fmt: skip


def motion_chart(content: Content, motion: ErrorMotion) -> str:
    """One motion over its axis: mean of both directions of travel, U, limit, each direction."""
    name, own = str(motion), content.entries[str(motion)]
    factor, along_unit = content.machine.axes[motion.axis].shown
    unit = 'µm' if motion.is_translation else 'µrad'
    heading = f'{name} {role(motion)}'
    x = factor * np.array(own['position'])
    low, high = (x[0], x[-1]) if x[-1] > x[0] else (x[0] - 0.5, x[0] + 0.5)
    along = Scale(float(low), float(high), f'{motion.axis} ({along_unit})')
    if name in content.hidden:
        panel = Panel(along, Scale(-1.0, 1.0, f'{name} ({unit})', marks=1))
        marks = [words(190.0, 100.0, 'not identifiable in these data', 'middle soft')]
        return panel.draw(marks, f'{name}: not identifiable', heading)
    y, u = 1e6 * np.array(own['value']), 1e6 * content.wide[name]
    reversal = content.doc['reversal']['motions'].get(name, {'identifiable': False})
    sides = [y]
    if reversal['identifiable']:
        sides += [1e6 * np.array(reversal[way]) for way in ('forward', 'backward')]
    reach = np.concatenate([*sides, y - u, y + u])
    edges, limit = np.zeros(0), limit_of(content, name)
    if limit is not None:  # on the span: a band about the middle of the values
        every, heading = np.concatenate(sides), f'{heading}, limit {1e6 * limit:g} {unit}'
        if 1e6 * limit > LIMIT_HEIGHT_RATIO * np.ptp(reach):
            heading += ', beyond the scale'
        else:
            edges = 0.5 * (every.max() + every.min()) + 0.5e6 * limit * np.array([-1.0, 1.0])
    scale = scale_around(np.concatenate([reach, edges]), f'{name} ({unit})')
    panel = Panel(along, scale)
    marks = [panel.band(x, y - u, y + u, 'after band')]
    if scale.low < 0 < scale.high:
        marks.append(panel.level(0.0, 'soft'))
    marks += [panel.level(float(e), f'{_limit_kind(content, name, "")} dash') for e in edges]
    marks += [panel.line(x, side, f'before {dash}')
              for side, dash in zip(sides[1:], ('dash', 'dot'), strict=False)]  # fmt: skip
    marks += [panel.line(x, y, 'after'), panel.dots(x, y, 'after node')]
    seen = np.array(own.get('node_identifiable') or [True] * len(x))
    if not seen.all():
        marks.append(panel.rings(x[~seen], y[~seen]))
    return panel.draw(marks, f'{name} over {motion.axis}, with uncertainty', heading)


def alone_chart(content: Content) -> str:
    """What the largest errors make alone."""
    rows = [Bar(n, ((1e6 * v, 'before'),), f'{micro(v)} µm') for n, v in content.alone[:12]]
    return bars(rows, 'contribution of each motion')


def radial_motion(content: Content, axis: str) -> str:
    """Radial motion of a rotary axis in the direction to the angle itself, about a circle."""
    along = int(np.argmax(np.abs(np.array(content.machine.axes[axis].direction))))
    first, second = (content.tables.motions[f'E{XYZ[(along + k) % 3]}{axis}'] for k in (1, 2))
    angle = np.linspace(first.position[0], first.position[-1], 361)
    radial = 1e6 * (np.cos(angle) * first.at(angle) + np.sin(angle) * second.at(angle))
    reach = max(float(np.abs(radial).max()), 1e-3)

    def circle(values: Array) -> str:
        size = CIRCLE + MAGNIFIED * values / reach
        return polyline(CENTRE + np.column_stack([size * np.cos(angle), -size * np.sin(angle)]))

    marks = [
        f'<path class="line soft" d="{circle(np.zeros_like(radial))}"/>',
        f'<path class="line after" d="{circle(radial)}"/>',
        words(CENTRE, CENTRE, f'{MAGNIFIED:g} px = {reach:.2f} µm', 'middle soft'),
        words(CENTRE + CIRCLE + 42.0, CENTRE, '0 deg', 'soft'),
    ]
    return svg(2.0 * CENTRE + 50.0, 2.0 * CENTRE, marks, f'radial motion of {axis}')


def scalar_words(content: Content, name: str) -> str:
    """Name, value and U of a squareness or location error."""
    if name in content.hidden:
        return f'{name} not known'
    value, wide = content.entries[name]['value'], float(content.wide[name][0])
    return f'{name} {micro_with_expanded(value, wide, unit_of(name))}'


# The volume by direction and over the rotary axes; forward and backward.


def component_charts(content: Content) -> list[str]:
    """Components of the error along X, Y and Z: as found, then as expected after compensation."""
    found, expected = list[str](), list[str]()
    u = np.maximum(1e6 * np.array(content.doc['volumetric_error']['u']), 1e-6)
    for k, axis in enumerate(XYZ):
        values = 1e6 * content.error[:, k]
        for kind, reach in (('before', np.append(values, 0.0)),
                            ('after', 3.0 * u[:, k].max() * np.array([-1.0, 1.0]))):  # fmt: skip
            across = scale_around(reach, f'd{axis} (µm)')
            edges = np.linspace(across.low, across.high, 25)
            if kind == 'before':
                share, heading = np.histogram(values, edges)[0] / len(values), 'as it stands'
            else:
                share = np.diff(ndtr(edges[:, None] / u[:, k]).mean(axis=1))
                heading = 'expected after'
            panel = Panel(across, scale_around(100.0 * share, 'share of points (%)', zero=True))
            heading = f'along {axis}, {heading}'
            drawn = panel.draw([panel.columns(edges, 100.0 * share, kind)], f'errors {heading}',
                               heading)  # fmt: skip
            (found if kind == 'before' else expected).append(drawn)
    return found + expected


def turns_chart(turns: Mapping[str, Any]) -> dict[str, Any]:
    """Mean error over the rotary axes: a table, and of two axes a map by colour."""
    names = turns['axes']
    angles = [np.degrees(own) for own in turns['position']]
    sizes = 1e6 * np.array(turns['mean']).reshape(len(angles[0]), -1)
    head = [f'{names[0]} (deg)', 'mean error (um)']
    if len(names) > 1:
        head = [f'{names[0]} \\ {names[1]} (deg)', *(f'{v:.0f}' for v in angles[1])]
    rows = [(f'{a:.0f}', *(f'{v:.1f}' for v in row)) for a, row in zip(angles[0], sizes,
                                                                   strict=True)]  # fmt: skip
    shown = {'axes': names, 'head': head, 'rows': rows, 'chart': '', 'key': ''}
    if len(names) == 1:
        return shown
    edges = [np.array([v[0], *(0.5 * (v[1:] + v[:-1])), v[-1]]) for v in angles]
    up, across = (Scale(float(e[0]), float(e[-1]), f'{n} (deg)')
                  for n, e in zip(names, edges, strict=True))  # fmt: skip
    step, panel, (y, x) = heat_step(sizes.ravel()), Panel(across, up), edges
    classes = heat_classes(sizes, step)
    marks = [
        panel.band(x[k : k + 2], [y[i]] * 2, [y[i + 1]] * 2, f'heat h{classes[i, k]}')
        for i, k in np.ndindex(classes.shape)
    ]
    drawn = panel.draw(marks, f'mean error over {names[0]} and {names[1]}')
    return shown | {'chart': drawn, 'key': heat_key(step, float(sizes.max()), 'µm')}
