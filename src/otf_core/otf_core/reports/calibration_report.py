# SPDX-License-Identifier: Apache-2.0
"""Report of a calibration: its sections in order, as page, text and plain data."""

from __future__ import annotations

from types import ModuleType

from otf_core.reports.calibration_facts import Facts
from otf_core.reports.calibration_sections import (
    budget,
    conditions,
    conventions,
    correlations,
    coverage,
    data_quality,
    diagonals,
    drift,
    effects,
    fit,
    limits,
    motions,
    nodes,
    overview,
    path,
    provenance,
    reversal,
    squareness,
    volume,
)
from otf_core.reports.page import page_html
from otf_core.reports.section import Section

SECTIONS: tuple[ModuleType, ...] = (
    overview,
    limits,
    motions,
    squareness,
    effects,
    volume,
    diagonals,
    reversal,
    budget,
    conditions,
    conventions,
    path,
    coverage,
    correlations,
    data_quality,
    drift,
    fit,
    nodes,
    provenance,
)
"""Files of ``calibration_sections`` in the order of the report."""


def calibration_sections(facts: Facts) -> list[Section]:
    """All sections of one calibration; pictures are drawn when a page asks for them."""
    found = (module.section(facts) for module in SECTIONS)
    return [section for section in found if section is not None]


def calibration_html(facts: Facts) -> str:
    """Return the report as one page."""
    return page_html(overview.heading(facts), calibration_sections(facts))
