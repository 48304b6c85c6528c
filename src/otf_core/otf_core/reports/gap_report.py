# SPDX-License-Identifier: Apache-2.0
"""Report of a diagnosis: its sections in order, as page and text."""

from __future__ import annotations

from types import ModuleType

from otf_core.diagnosis.result import Diagnosis
from otf_core.reports.gap_sections import (
    beam,
    causes,
    conditions,
    frequency,
    functions,
    hidden,
    next_steps,
    over_time,
    overview,
    place,
    travel,
    unexplained,
    where,
)
from otf_core.reports.page import page_html
from otf_core.reports.section import Section, sections_to_text

SECTIONS: tuple[ModuleType, ...] = (
    overview,
    causes,
    functions,
    where,
    unexplained,
    hidden,
    next_steps,
    over_time,
    place,
    travel,
    beam,
    frequency,
    conditions,
)
"""Files of ``gap_sections`` in the order of the report."""


def gap_sections(diagnosis: Diagnosis) -> list[Section]:
    """All sections of one diagnosis; pictures are drawn when a page asks for them."""
    sections = [module.section(diagnosis) for module in SECTIONS]
    return [s for s in sections if s.title or s.words or s.tables or s.text]


def report_html(diagnosis: Diagnosis) -> str:
    """Return the report as one page."""
    return page_html(overview.heading(diagnosis), gap_sections(diagnosis))


def format_diagnosis(diagnosis: Diagnosis) -> str:
    """Return the text for a terminal."""
    return sections_to_text(gap_sections(diagnosis))
