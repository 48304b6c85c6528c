# SPDX-License-Identifier: Apache-2.0
"""What these data cannot show."""

from __future__ import annotations

from otf_core.diagnosis.result import Diagnosis
from otf_core.reports.gap_words import effect_cause, effect_name
from otf_core.reports.section import Section, Table

TITLE = 'What these data cannot show'


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    if not diagnosis.not_visible:
        words = 'Every effect of the catalogue would have left a trace in these data.'
        return Section('hidden', TITLE, (words,))
    rows = tuple(((effect_name(e), effect_cause(e)), needs) for e, needs in diagnosis.not_visible)
    words = 'These effects leave no trace in these data, so they are neither found nor absent.'
    text = tuple(f'not visible: {e}; needs {n}' for e, n in diagnosis.not_visible)
    return Section('hidden', TITLE, (words,), tables=(Table(('Effect', 'Shown by'), rows),),
                   text=text)  # fmt: skip
