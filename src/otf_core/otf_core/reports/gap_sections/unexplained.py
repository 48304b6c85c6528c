# SPDX-License-Identifier: Apache-2.0
"""What stays unexplained."""

from __future__ import annotations

from otf_core.diagnosis.result import Diagnosis
from otf_core.reports.section import Section


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    where = diagnosis.unexplained_where
    words = f'{diagnosis.unexplained_um:.2f} um (root mean square)' + (
        f': {where}.' if where else '.'
    )
    data = {'rms_um': diagnosis.unexplained_um, 'where': where}
    size = f'left: {diagnosis.unexplained_um:.2f} um'
    told = diagnosis.unnamed is not None  # in the sentence of the first screen
    text = (size if told or not where else f'{size}, {where}', '')
    return Section('unexplained', 'What stays unexplained', (words,), data, text=text)
