# SPDX-License-Identifier: Apache-2.0
"""Report of a calibration: its sections in order, as page, text and plain data."""

from __future__ import annotations

from collections.abc import Callable

from otf_core.reports.calibration_facts import Facts
from otf_core.reports.calibration_sections.conventions import (
    conventions_section,
    effects_section,
    provenance_section,
)
from otf_core.reports.calibration_sections.error_motions import (
    motions_section,
    nodes_section,
    reversal_section,
    squareness_section,
)
from otf_core.reports.calibration_sections.first_screen import (
    heading,
    limits_section,
    overview_section,
)
from otf_core.reports.calibration_sections.measurement import (
    conditions_section,
    data_quality_section,
    drift_section,
    fit_section,
    path_section,
)
from otf_core.reports.calibration_sections.uncertainty import budget_section, correlations_section
from otf_core.reports.calibration_sections.volumetric_error import (
    coverage_section,
    diagonals_section,
    volume_section,
)
from otf_core.reports.page import page_html
from otf_core.reports.section import Section

SECTIONS: tuple[Callable[[Facts], Section | None], ...] = (
    overview_section,
    limits_section,
    motions_section,
    squareness_section,
    effects_section,
    volume_section,
    diagonals_section,
    reversal_section,
    budget_section,
    conditions_section,
    conventions_section,
    path_section,
    coverage_section,
    correlations_section,
    data_quality_section,
    drift_section,
    fit_section,
    nodes_section,
    provenance_section,
)
"""Functions of ``calibration_sections`` in the order of the report."""


def calibration_sections(facts: Facts) -> list[Section]:
    """All sections of one calibration; pictures are drawn when a page asks for them."""
    found = (section(facts) for section in SECTIONS)
    return [section for section in found if section is not None]


def calibration_html(facts: Facts) -> str:
    """Return the report as one page."""
    return page_html(heading(facts), calibration_sections(facts))
