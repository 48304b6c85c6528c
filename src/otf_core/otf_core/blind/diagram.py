# SPDX-License-Identifier: Apache-2.0
"""Reliability diagram: how many of the causes named are there, over the confidence stated."""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.blind.counts import Stated, binomial_interval

SIDE, EDGE = 260.0, 46.0
"""Pixels: of the square of both shares, and around it."""
TICKS = (0.0, 0.25, 0.5, 0.75, 1.0)


def _across(share: float) -> float:
    return EDGE + SIDE * share


def _up(share: float) -> float:
    return EDGE + SIDE * (1.0 - share)


def _line(x1: float, y1: float, x2: float, y2: float, look: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" {look}/>'


def _words(x: float, y: float, words: str, look: str = '') -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle" {look}>{words}</text>'


def _point(one: Stated) -> list[str]:
    """A class: its share, the 95 % interval, and how many causes it holds."""
    x, low_high = _across(one.mean), binomial_interval(one.row.hits, one.row.of)
    bar = 'stroke="#1f77b4" stroke-width="2"'
    return [
        _line(x, _up(low_high[0]), x, _up(low_high[1]), bar),
        f'<circle cx="{x:.1f}" cy="{_up(one.row.hits / one.row.of):.1f}" r="5" fill="#1f77b4"/>',
        _words(x - 14.0, _up(low_high[0]) + 12.0, str(one.row.of), 'fill="#1f77b4"'),
    ]


def reliability_svg(classes: Sequence[Stated]) -> str:
    """Draw the diagram as SVG; a point on the diagonal states what is so."""
    whole, plain = SIDE + 2.0 * EDGE, 'stroke="#888"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{whole:.0f}" height="{whole:.0f}" '
        f'viewBox="0 0 {whole:.0f} {whole:.0f}" font-family="sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="white"/>',
        f'<rect x="{EDGE}" y="{EDGE}" width="{SIDE}" height="{SIDE}" fill="none" {plain}/>',
        _line(_across(0.0), _up(0.0), _across(1.0), _up(1.0), f'{plain} stroke-dasharray="4"'),
    ]
    for tick in TICKS:
        parts.append(_words(_across(tick), _up(0.0) + 16.0, f'{tick:g}'))
        parts.append(_words(_across(0.0) - 18.0, _up(tick) + 4.0, f'{tick:g}'))
    for one in classes:
        parts += _point(one)
    middle = _across(0.5)
    parts.append(_words(middle, _up(0.0) + 34.0, 'confidence stated'))
    turned = f'transform="rotate(-90 12 {middle:.1f})"'
    parts.append(_words(12.0, middle, 'share of the causes that are there', turned))
    parts.append(_words(middle, 24.0, 'causes named in a blind trial, with 95 % intervals'))
    return '\n'.join([*parts, '</svg>\n'])
