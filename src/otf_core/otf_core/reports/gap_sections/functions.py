# SPDX-License-Identifier: Apache-2.0
"""Functions that free forms and a cause without a name found, with their bands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.diagnosis.free_curves import SCALES, Curve, at_words
from otf_core.diagnosis.result import Diagnosis
from otf_core.effects.inputs import label_of
from otf_core.reports.drawing.panel import Panel
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.gap_words import effect_name
from otf_core.reports.section import Picture, Section

MOST = 6
"""Curves of one cause that are drawn, the largest first."""


def section(diagnosis: Diagnosis) -> Section:
    """Return the section; it is empty where everything follows a formula."""
    unnamed = diagnosis.unnamed
    shown = [(effect_name(c.effect), c.departs, c.curves) for c in diagnosis.causes if c.curves]
    if unnamed is not None:
        shown.append(('Cause without a name', unnamed.words, unnamed.curves))
    if not shown:
        return Section('functions', '')
    words = tuple(f'{effect_name(c.effect)}: {c.departs}.' for c in diagnosis.causes if c.curves)
    return Section(
        'functions',
        'Functions found',
        words,
        draw=lambda: [_picture(name, curves) for name, _, curves in shown],
    )


def _picture(name: str, curves: Sequence[Curve]) -> Picture:
    caption = (
        f'{name}: the function that the data show; the band is that of k = 2, without what tables '
        f'and the place of the tracker hold as well.'
    )
    return Picture(tuple(_panel(c) for c in curves[:MOST]), caption, columns=2, title=name)


def _panel(curve: Curve) -> str:
    factor, unit = SCALES.get(curve.unit, (1.0, curve.unit))
    across, of_input = (1e3, 'mm') if curve.input_unit == 'm' else (1.0, curve.input_unit)
    at = across * np.array(curve.at)
    value, u = factor * np.array(curve.value), factor * np.array(curve.u)
    low, high = value - 2.0 * u, value + 2.0 * u
    label = label_of(curve.input) + (f' ({of_input})' if of_input else '')
    ends = float(at[0]), max(float(at[-1]), float(at[0]) + 1e-9)
    panel = Panel(
        Scale(*ends, label),
        around(np.concatenate([[0.0], low, high]), unit.replace('u', 'µ', 1)),
    )
    marks = [
        panel.level(0.0, 'soft'),
        panel.band(at, low, high, 'after band'),
        panel.line(at, value, 'after'),
    ]
    held = ', '.join(at_words(n, v) for n, v in curve.held.items())
    heading = f'{curve.term}, {held}' if held else curve.term
    return panel.draw(marks, f'{curve.term} against {label_of(curve.input)}', heading)
