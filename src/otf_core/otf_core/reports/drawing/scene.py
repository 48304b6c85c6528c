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
from numpy.typing import NDArray

from otf_core.reports.drawing.panel import arrow_path, svg, words

Array = NDArray[np.float64]

WIDTH, HEIGHT, MARGIN = 480.0, 330.0, 28.0
AZIMUTH, ELEVATION = math.radians(-58.0), math.radians(24.0)
"""From where the picture is seen first: from the front, a little from the right and above."""


@dataclass(frozen=True)
class Strokes:
    """Lines of one class.

    Attributes
    ----------
    kind : str
    ends : ndarray, shape (n, 2, 3), m
    arrows : bool
        With a head at the second end.
    """

    kind: str
    ends: Array
    arrows: bool = False


@dataclass(frozen=True)
class Dots:
    """Dots of one class at points, shape (n, 3), m."""

    kind: str
    points: Array


@dataclass(frozen=True)
class Label:
    """Text at a point.

    Attributes
    ----------
    point : ndarray, shape (3,), m
    text : str
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


TURNED = 'On a screen, drag it or use the arrow keys to turn it; Home turns it back.'
"""For captions."""
Item = Strokes | Dots | Label
EDGES = (
    ('X', (0.5, 0.0, 0.0), 'end', -4.0, 15.0),
    ('Y', (1.0, 0.5, 0.0), '', 6.0, 15.0),
    ('Z', (0.0, 0.0, 0.5), 'end', -6.0, 4.0),
)
"""Where the axes are named: a place on the box, and which way off it."""


def box(low: Array, high: Array) -> list[Item]:
    """Edges of a box, and the names of the axes at three of them."""
    corners = np.array(list(product((0, 1), repeat=3)))
    pairs = [
        (a, b) for a in corners for b in corners if a.sum() < b.sum() and abs(b - a).sum() == 1
    ]
    size = high - low
    items: list[Item] = [Strokes('grid', low + np.array(pairs) * size)]
    for k, (name, shares, kind, dx, dy) in enumerate(EDGES):
        ends = (round(float(end[k]), 2) + 0.0 for end in (low, high))
        text = f'{name} ' + ' to '.join(f'{end:.2f}' for end in ends) + ' m'
        items.append(Label(low + np.array(shares) * size, text, kind, dx, dy))
    return items


def _projected(points: Array) -> Array:
    """Places in the picture of points (n, 3) of the unit sphere, px."""
    ca, sa = math.cos(AZIMUTH), math.sin(AZIMUTH)
    ce, se = math.cos(ELEVATION), math.sin(ELEVATION)
    right = np.array([-sa, ca, 0.0])
    up = np.array([-ca * se, -sa * se, ce])
    half = 0.5 * HEIGHT - MARGIN
    return np.column_stack(
        [0.5 * WIDTH + half * (points @ right), 0.5 * HEIGHT - half * (points @ up)]
    )


def _path(item: Strokes | Dots, points: Array) -> str:
    if isinstance(item, Dots):
        places = _projected(points)
        return ('M%.1f %.1fh0' * len(places)) % tuple(places.reshape(-1).tolist())
    ends = _projected(points.reshape(-1, 3)).reshape(-1, 2, 2)
    if item.arrows:
        return arrow_path(ends)
    return ('M%.1f %.1fL%.1f %.1f' * len(ends)) % tuple(ends.reshape(-1).tolist())


def scene(
    items: Sequence[Item], low: Array, high: Array, title: str, *, turns: bool = True
) -> str:
    """Picture of items in a box from low to high (3,), m; ``SCRIPT`` lets the reader turn it."""
    centre = 0.5 * (low + high)
    size = 0.5 * float(np.linalg.norm(high - low))
    marks, data = [], []
    for item in items:
        if isinstance(item, Label):
            point = (item.point - centre) / size
            x, y = _projected(point[None])[0]
            mark = words(x, y, item.text, f'{item.kind} soft')
            marks.append(mark.replace('<text', f'<text dx="{item.dx:g}" dy="{item.dy:g}"', 1))
            data.append([3, *np.round(point, 3).tolist()])
            continue
        where = item.points if isinstance(item, Dots) else item.ends
        points = (where - centre) / size
        kind = 'dots' if isinstance(item, Dots) else 'line'
        marks.append(f'<path class="{kind} {item.kind}" d="{_path(item, points)}"/>')
        code = 0 if isinstance(item, Dots) else 2 if item.arrows else 1
        data.append([code, *np.round(points, 4).reshape(-1).tolist()])
    picture = svg(WIDTH, HEIGHT, marks, title)
    if not turns:
        return picture
    numbers = html.escape(json.dumps(data, separators=(',', ':')), quote=True)
    return picture.replace('<svg ', f'<svg class="turn" tabindex="0" data-scene="{numbers}" ', 1)


SCRIPT = """
'use strict';
for (const svg of document.querySelectorAll('svg.turn')) {
  const items = JSON.parse(svg.dataset.scene);
  const marks = [...svg.children].slice(-items.length);
  const box = svg.viewBox.baseVal, half = box.height / 2 - 28;
  const front = [-58 * Math.PI / 180, 24 * Math.PI / 180];
  let [azimuth, elevation] = front, last = null;
  const draw = () => {
    const ca = Math.cos(azimuth), sa = Math.sin(azimuth);
    const ce = Math.cos(elevation), se = Math.sin(elevation);
    const at = (v, i) => [box.width / 2 + half * (-sa * v[i] + ca * v[i + 1]),
      box.height / 2 - half * (-ca * se * v[i] - sa * se * v[i + 1] + ce * v[i + 2])];
    const text = p => p[0].toFixed(1) + ' ' + p[1].toFixed(1);
    items.forEach((v, k) => {
      const mark = marks[k];
      if (v[0] === 3) {
        const p = at(v, 1);
        mark.setAttribute('x', p[0].toFixed(1)); mark.setAttribute('y', p[1].toFixed(1));
        return;
      }
      let d = '';
      for (let i = 1; i < v.length; i += v[0] ? 6 : 3) {
        const a = at(v, i);
        if (!v[0]) { d += 'M' + text(a) + 'h0'; continue; }
        const b = at(v, i + 3);
        d += 'M' + text(a) + 'L' + text(b);
        if (v[0] === 2) {
          const s = [a[0] - b[0], a[1] - b[1]], n = Math.max(Math.hypot(...s), 1e-9);
          const f = Math.min(5, 0.6 * n) / n, c = Math.cos(0.45), t = Math.sin(0.45);
          const side = u => text([b[0] + f * (c * s[0] - u * t * s[1]),
            b[1] + f * (u * t * s[0] + c * s[1])]);
          d += 'M' + side(1) + 'L' + text(b) + 'L' + side(-1);
        }
      }
      mark.setAttribute('d', d);
    });
  };
  const turn = (right, down) => {
    azimuth -= right;
    elevation = Math.max(-1.5, Math.min(1.5, elevation + down));
    draw();
  };
  svg.addEventListener('pointerdown', e => { last = [e.clientX, e.clientY];
    svg.setPointerCapture(e.pointerId); });
  svg.addEventListener('pointermove', e => {
    if (!last) return;
    turn((e.clientX - last[0]) / 150, (e.clientY - last[1]) / 150);
    last = [e.clientX, e.clientY];
  });
  for (const end of ['pointerup', 'pointercancel']) svg.addEventListener(end, () => last = null);
  const steps = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1],
    ArrowDown: [0, 0.1]};
  svg.addEventListener('keydown', e => {
    if (e.key === 'Home') [azimuth, elevation] = front;
    else if (!(e.key in steps)) return;
    e.preventDefault();
    turn(...(steps[e.key] || [0, 0]));
  });
}
"""
"""Turns every picture of ``scene`` with mouse, finger or arrow keys; needs nothing else."""
