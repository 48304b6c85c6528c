# SPDX-License-Identifier: Apache-2.0
"""Where the gap lies."""

from __future__ import annotations

from otf_core.diagnosis.result import Diagnosis
from otf_core.reports.section import Section


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    summary = diagnosis.where.summary
    how = 'What noise leaves is computed piece by piece here; the simulation above draws it.'
    return Section('where', 'Where it lies', (summary, how), {'summary': summary}, text=(summary,))
