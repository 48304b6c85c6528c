# SPDX-License-Identifier: Apache-2.0
"""What to measure next."""

from __future__ import annotations

from otf_core.diagnosis.result import Diagnosis
from otf_core.reports.gap_words import next_measurements
from otf_core.reports.section import Section


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    lines = next_measurements(diagnosis) or ['Nothing more is needed for this question.']
    return Section('next', 'What to measure next', tuple(lines), {'measure': lines})
