# SPDX-License-Identifier: Apache-2.0
"""Residual by length and direction of the beam."""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.diagnosis.place import groupings as by
from otf_core.diagnosis.result import Diagnosis
from otf_core.reports.gap_pictures import group_bars, key
from otf_core.reports.section import Picture, Section


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    return Section('beam', 'By beam', draw=lambda: _pictures(diagnosis))


def _pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    views = diagnosis.shown.views
    angles = [by.by_azimuth(views, 4), by.by_elevation(views, 4)]
    parts = (
        group_bars(diagnosis, [by.by_distance(views, 8)], 'residual by length of the beam'),
        group_bars(diagnosis, angles, 'residual by azimuth and elevation of the beam'),
    )
    caption = (
        'Root mean square of the residual by length of the beam, its azimuth about machine Z '
        '(from +X) and its elevation over the XY plane.'
    )
    return [Picture(parts, caption, columns=2, key=key(diagnosis, stroke=True))]
