# SPDX-License-Identifier: Apache-2.0
"""Tables as a text file of mm and rad holds them."""

from __future__ import annotations

from dataclasses import replace

from otf_core.model.motions import MOTIONS
from otf_core.model.tables import ErrorTables, MotionTable, Squareness

LENGTH, ANGLE = 9, 9
"""Decimals of lengths in m (1 nm: six decimals of a mm) and of angles in rad."""


def rounded_tables(tables: ErrorTables) -> ErrorTables:
    """Return tables with lengths to 1e-6 mm and angles to 1e-9 rad."""
    motions: dict[str, MotionTable] = {
        m: replace(
            tables.motions[m],
            value=tables.motions[m].value.round(LENGTH if m.is_translation else ANGLE),
        )
        for m in MOTIONS
    }
    square = {k: Squareness(round(s.value, ANGLE), s.u) for k, s in tables.squareness.items()}
    return replace(tables, motions=motions, squareness=square)
