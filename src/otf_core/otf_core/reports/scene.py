# SPDX-License-Identifier: Apache-2.0
"""Pictures in space that can be turned: drawn here for paper, redrawn by a script on a screen."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from otf_core.arrays import Array
from otf_core.reports.charts import arrow_path, round_below, svg, words

WIDTH, HEIGHT, MARGIN = 480.0, 320.0, 22.0
SIDE = 100.0
"""px; room for labels left and right of the scene."""
AZIMUTH, ELEVATION = math.radians(-58.0), math.radians(24.0)
"""From where the picture is seen first: from the front, a little from the right and above."""
LETTER, LINE = 5.9, 13.0
"""px; about the width of a letter and the height of a line of labels."""
SIDES = (('', 9.0), ('end', -9.0), ('middle', 0.0))
"""How a label stands beside its place, and how far off it, px."""
TRACKER_DISTANCE = 0.3
"""Distance of a tracker from the volume, in its diagonals, up to which it stands in the scene."""


@dataclass(frozen=True)
class Strokes:
    """Lines of one class.

    Attributes
    ----------
    ends : ndarray, shape (n, 2, 3), m
    arrows : bool
        With a head at the second end.
    """

    kind: str
    ends: Array
    arrows: bool = False


@dataclass(frozen=True)
class Dots:
    """Dots of one class.

    Attributes
    ----------
    points : ndarray, shape (n, 3), m
    radius : float, m
        As they are drawn, magnified if they are; 0: the size of the class.
    """

    kind: str
    points: Array
    radius: float = 0.0


@dataclass(frozen=True)
class Label:
    """Text at a point.

    Attributes
    ----------
    point : ndarray, shape (3,), m
    kind : str
        Classes, such as 'end' or 'middle'.
    dx, dy : float, px
        Off the point.
    """

    point: Array
    text: str
    kind: str = 'middle'
    dx: float = 0.0
    dy: float = 0.0


@dataclass(frozen=True)
class Magnification:
    """How much larger than the volume errors are drawn.

    Attributes
    ----------
    factor : float
        A round number.
    reference : float, m
        An error of round size, whose arrow stands beside the scene.
    """

    factor: float
    reference: float

    @property
    def words(self) -> str:
        """In words."""
        return f'errors × {self.factor:,.0f}'.replace(',', '\u202f')


SHORTEST_EDGE = 0.05
"""Of a box that is drawn, in its longest."""
STAYS = 0.1
"""m; size of the volume of a target that stays where it is, on the line of a rotary table."""


def box_around(points: Array) -> tuple[Array, Array]:
    """Corners of a box around points (n, 3), m; no edge is much shorter than the others."""
    low, high = points.min(axis=0), points.max(axis=0)
    least = SHORTEST_EDGE * max(float((high - low).max()), STAYS)
    lack = np.maximum(0.0, least - (high - low))
    return low - 0.5 * lack, high + 0.5 * lack


def magnification(longest: float, reach: float) -> Magnification:
    """A round magnification that draws the longest error at most ``reach`` long, m."""
    size = max(longest, 1e-12)
    return Magnification(round_below(reach / size), round_below(size))


Item = Strokes | Dots | Label
EDGES = (
    ('X', (0.5, 0.0, 0.0), 'end', -4.0, 15.0),
    ('Y', (1.0, 0.5, 0.0), '', 6.0, 15.0),
    ('Z', (0.0, 0.0, 0.5), 'end', -6.0, 4.0),
)
"""Name of every axis: place on the box, alignment of the text, and offset from the place, px."""


def box(low: Array, high: Array) -> list[Item]:
    """Edges of a box, and the names of the axes at three of them."""
    corners = np.array(list(product((0, 1), repeat=3)))
    pairs = [
        (a, b) for a in corners for b in corners if a.sum() < b.sum() and abs(b - a).sum() == 1
    ]
    size = high - low
    items: list[Item] = [Strokes('grid', low + np.array(pairs) * size)]
    for k, (name, shares, kind, dx, dy) in enumerate(EDGES):
        ends = (round(1e3 * float(end[k]), 1) + 0.0 for end in (low, high))
        text = f'{name} ' + ' to '.join(f'{end:g}' for end in ends) + ' mm'
        items.append(Label(low + np.array(shares) * size, text, kind, dx, dy))
    return items


def tracker_items(place: Array, low: Array, high: Array) -> list[Item]:
    """Mark of a tracker at place (3,), m; of one far from the box an arrow towards it."""
    edge = np.clip(place, low, high)
    away = place - edge
    far, reach = float(np.linalg.norm(away)), TRACKER_DISTANCE * float(np.linalg.norm(high - low))
    if far <= reach:
        return [Dots('z big', place[None]), Label(place, 'tracker', 'end', -9.0, 4.0)]
    tip = edge + away * (0.5 * reach / far)
    label = f'tracker, {far:.1f} m away'
    return [Strokes('z', np.array([[edge, tip]]), arrows=True), Label(tip, label, 'middle', dy=12)]


def _axes() -> tuple[Array, Array]:
    """Directions right and up in the picture, shape (3,)."""
    ca, sa = math.cos(AZIMUTH), math.sin(AZIMUTH)
    ce, se = math.cos(ELEVATION), math.sin(ELEVATION)
    return np.array([-sa, ca, 0.0]), np.array([-ca * se, -sa * se, ce])


HALF = 0.5 * HEIGHT - MARGIN
"""px of the unit sphere."""


def _projected(points: Array) -> Array:
    """Places in the picture of points (n, 3) of the unit sphere, px."""
    right, up = _axes()
    return np.column_stack(
        [0.5 * WIDTH + HALF * (points @ right), 0.5 * HEIGHT - HALF * (points @ up)]
    )


def _fitted(items: Sequence[Item], low: Array, high: Array) -> tuple[Array, float]:
    """Centre (3,) and radius, m, with which box and marks fill the picture as it is seen first."""
    corners = np.array(list(product(*zip(low, high, strict=True))))
    ends = [i.points if isinstance(i, Dots) else i.ends.reshape(-1, 3)
            for i in items if not isinstance(i, Label)]  # fmt: skip
    places = np.concatenate([corners, *ends]) @ np.stack(_axes(), axis=1)
    near, far = places.min(axis=0), places.max(axis=0)
    room = np.array([WIDTH - 2.0 * SIDE, HEIGHT - 2.0 * MARGIN])
    scale = float((room / np.maximum(far - near, 1e-12)).min())
    middle = 0.5 * (low + high)
    shift = 0.5 * (near + far) - middle @ np.stack(_axes(), axis=1)
    return middle + np.stack(_axes(), axis=1) @ shift, HALF / scale


def _label_spots(item: Label) -> list[tuple[str, float, float]]:
    """Class and offset of a label, the one wished for first."""
    own = (item.kind, item.dx, item.dy)
    near = [(kind, dx, dy) for dy in (4.0, -9.0, 18.0) for kind, dx in SIDES]
    far = [(kind, 4.0 * dx, dy) for dy in (4.0, -26.0, 34.0) for kind, dx in SIDES]
    return [own, *near, *far]


def _label_box(item: Label, kind: str, x: float, y: float) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of a label whose anchor lies at x, y, px."""
    wide = LETTER * len(item.text)
    left_edge = x - wide if 'end' in kind else x - 0.5 * wide if 'middle' in kind else x
    return left_edge, y - LINE + 3.0, left_edge + wide, y + 3.0


Box = tuple[float, float, float, float]


def _overlap(a: Box, b: Box) -> float:
    wide = min(a[2], b[2]) - max(a[0], b[0])
    high = min(a[3], b[3]) - max(a[1], b[1])
    return max(wide, 0.0) * max(high, 0.0)


def _crowd(items: Sequence[Item], centre: Array, size: float) -> Array:
    """Places (n, 2), px, that labels should leave free: along lines and arrows, and dots."""
    share = np.linspace(0.0, 1.0, 7)[:, None]
    points = [np.zeros((0, 3))]
    for item in items:
        if isinstance(item, Dots):
            points.append(item.points)
        elif isinstance(item, Strokes):
            a, b = item.ends[:, None, 0], item.ends[:, None, 1]
            points.append((a + share * (b - a)).reshape(-1, 3))
    return _projected((np.concatenate(points) - centre) / size)


def _spot(
    item: Label, x: float, y: float, placed: Sequence[Box], crowd: Array
) -> tuple[str, float, float, Box]:
    """Where a label overlaps nothing that stands there already, and the box it takes."""
    best, least = ('', 0.0, 0.0, (0.0, 0.0, 0.0, 0.0)), math.inf
    for kind, dx, dy in _label_spots(item):
        own = _label_box(item, kind, x + dx, y + dy)
        outside = max(0.0, -own[0]) + max(0.0, own[2] - WIDTH) + max(0.0, own[3] - HEIGHT)
        covered = np.all((crowd > own[:2]) & (crowd < own[2:]), axis=1).sum()
        cost = sum(_overlap(own, other) for other in placed) + LINE * (outside + float(covered))
        if cost < least:
            best, least = (kind, dx, dy, own), cost
    return best


def _reference(shown: Magnification, scale: float) -> list[str]:
    """Arrow of an error of round size, and what it is; ``scale`` in px of a metre."""
    long = shown.reference * shown.factor * scale
    y = HEIGHT - 9.0
    ends = np.array([[[10.0, y], [10.0 + long, y]]])
    label = f'{1e6 * shown.reference:g} µm, {shown.words}'
    return [f'<path class="line ink" d="{arrow_path(ends)}"/>', words(18.0 + long, y + 4.0, label)]


def _path(item: Strokes | Dots, points: Array) -> str:
    if isinstance(item, Dots):
        places = _projected(points)
        return ('M%.1f %.1fh0' * len(places)) % tuple(places.reshape(-1).tolist())
    ends = _projected(points.reshape(-1, 3)).reshape(-1, 2, 2)
    if item.arrows:
        return arrow_path(ends)
    return ('M%.1f %.1fL%.1f %.1f' * len(ends)) % tuple(ends.reshape(-1).tolist())


def scene(
    items: Sequence[Item],
    low: Array,
    high: Array,
    title: str,
    *,
    turns: bool = True,
    shown: Magnification | None = None,
) -> str:
    """Picture of items in a box; ``scene.js`` lets the reader turn it.

    Parameters
    ----------
    items : sequence of Item
        Labels are drawn last, none over another.
    low, high : ndarray, shape (3,), m
    title : str
        For readers who cannot see it.
    shown : Magnification, optional
        Of arrows and radii among the items; stated with an arrow of reference.
    """
    centre, size = _fitted(items, low, high)
    marks, data = [], []
    fixed = _reference(shown, HALF / size) if shown else []
    crowd = _crowd(items, centre, size)
    occupied: list[Box] = [(0.0, HEIGHT - 20.0, 0.6 * WIDTH, HEIGHT)] if shown else []
    for item in sorted(items, key=lambda i: isinstance(i, Label)):
        if isinstance(item, Label):
            point = (item.point - centre) / size
            x, y = _projected(point[None])[0]
            kind, dx, dy, own = _spot(item, x, y, occupied, crowd)
            occupied.append(own)
            mark = words(x, y, item.text, f'{kind} soft over')
            marks.append(mark.replace('<text', f'<text dx="{dx:g}" dy="{dy:g}"', 1))
            data.append([3, *np.round(point, 3).tolist()])
            continue
        where = item.points if isinstance(item, Dots) else item.ends
        points = (where - centre) / size
        kind, style = ('dots', '') if isinstance(item, Dots) else ('line', '')
        if isinstance(item, Dots) and item.radius > 0:
            style = f' style="stroke-width:{max(2.0 * item.radius * HALF / size, 2.5):.1f}"'
        marks.append(f'<path class="{kind} {item.kind}"{style} d="{_path(item, points)}"/>')
        code = 0 if isinstance(item, Dots) else 2 if item.arrows else 1
        data.append([code, *np.round(points, 4).reshape(-1).tolist()])
    picture = svg(WIDTH, HEIGHT, [*fixed, *marks], title)
    if not turns:
        return picture
    numbers = html.escape(json.dumps(data, separators=(',', ':')), quote=True)
    return picture.replace('<svg ', f'<svg class="turn" tabindex="0" data-scene="{numbers}" ', 1)
