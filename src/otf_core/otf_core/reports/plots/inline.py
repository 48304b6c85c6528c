# SPDX-License-Identifier: Apache-2.0
"""Figures as SVG inside an HTML page: no outside reference, the colours of the page's text."""

from __future__ import annotations

import io
import re
from typing import Any

NUMBER = re.compile(r'-?\d+\.\d{2,}')
"""Coordinates; a tenth of a point is enough for the eye."""


def _rounded(number: re.Match[str]) -> str:
    return f'{float(number.group()):.1f}'


def _renamed(text: str, name: str) -> str:
    """Number the marks, as matplotlib names them after the last digits of coordinates."""
    marks = {mark: f'{name}-{k}' for k, mark in enumerate(re.findall(r' id="([^"]*)"', text))}
    return re.sub(
        r'( id="|url\(#|href="#)([^")]*)', lambda m: m.group(1) + marks[m.group(2)], text
    )


def inline_svg(figure: Any, name: str, title: str) -> str:
    """Return a figure as an ``svg`` element.

    Parameters
    ----------
    figure : matplotlib figure
    name : str
        Letters only; unique in the page, as the figure's marks are named after it.
    title : str
        For readers who cannot see it; plain text without markup.
    """
    import matplotlib

    settings: Any = {'svg.hashsalt': name, 'svg.fonttype': 'none', 'font.family': 'sans-serif'}
    target = io.StringIO()
    with matplotlib.rc_context(settings):
        figure.savefig(target, format='svg', transparent=True, metadata={'Date': None})
    text = target.getvalue()
    text = text[text.index('<svg') :]
    text = re.sub(r'<metadata>.*?</metadata>', '', text, flags=re.S)
    text = re.sub(r'<style.*?</style>', '', text, flags=re.S)
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', '', text)
    text = re.sub(
        r' id="(?:patch|line2d|text|axes|xtick|ytick|figure|matplotlib\.)[^"]*"', '', text
    )
    text = _renamed(text.replace('xlink:href', 'href'), name)
    text = re.sub(r'<[^>]*>', lambda m: NUMBER.sub(_rounded, m.group()), text)
    text = text.replace('#000000', 'currentColor')
    text = re.sub(r'>\s+<', '><', text)
    head = re.match(r'<svg[^>]*viewBox="([^"]*)"[^>]*>', text)
    assert head is not None
    label = f'<svg viewBox="{head.group(1)}" role="img" aria-label="{title}">'
    return label + text[head.end() :]
