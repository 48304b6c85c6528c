# SPDX-License-Identifier: Apache-2.0
"""Residual by line, feed and sense of travel."""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.diagnosis.place import groupings as by
from otf_core.diagnosis.result import Diagnosis
from otf_core.reports.gap_pictures import group_bars, key
from otf_core.reports.section import Picture, Section


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    title = 'By line, feed and sense of travel'
    return Section('travel', title, draw=lambda: _pictures(diagnosis))


def _pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    views = diagnosis.shown.views
    parts = (
        group_bars(diagnosis, [by.by_line(views), by.by_feed(views)], 'residual by line and feed'),
        group_bars(diagnosis, [by.by_sense(views, k) for k in range(3)], 'residual by sense'),
    )
    caption = (
        'Root mean square of the residual. Diagonals are named after the axes they move; forward '
        'is towards larger axis positions.'
    )
    return [Picture(parts, caption, columns=2, key=key(diagnosis, stroke=True))]
