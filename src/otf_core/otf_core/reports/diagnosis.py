# SPDX-License-Identifier: Apache-2.0
"""What ``otf diagnose`` writes: the report of its sections, gap.json, what causes do to tables."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from otf_core.aside import share_out
from otf_core.diagnosis.answer import measured_run
from otf_core.diagnosis.result import Diagnosis
from otf_core.effects.effects_yaml import write_effects
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.provenance import STANDARD, provenance
from otf_core.reports.calibration import write_calibration
from otf_core.reports.gap_sections.overview import (
    causes_section,
    conditions_section,
    functions_section,
    heading,
    hidden_section,
    next_section,
    overview_section,
    unexplained_section,
    where_section,
)
from otf_core.reports.gap_sections.residual_views import (
    beam_section,
    frequency_section,
    place_section,
    time_section,
    travel_section,
)
from otf_core.reports.page import Section, page_html, sections_to_text
from otf_core.threads import limit_to_one_thread

SECTIONS: tuple[Callable[[Diagnosis], Section], ...] = (
    overview_section,
    causes_section,
    functions_section,
    where_section,
    unexplained_section,
    hidden_section,
    next_section,
    time_section,
    place_section,
    travel_section,
    beam_section,
    frequency_section,
    conditions_section,
)
"""Functions of ``gap_sections`` in the order of the report."""
SCHEMA = 'otf-gap/1'
REPORT_FILE, BESIDE_TABLES = 'report.html', 'gap_report.html'
"""Name of the report; beside error_tables.json there is one of the calibration already."""


def gap_sections(diagnosis: Diagnosis) -> list[Section]:
    """All sections of one diagnosis; pictures are drawn when a page asks for them."""
    sections = [section(diagnosis) for section in SECTIONS]
    return [s for s in sections if s.title or s.words or s.tables or s.text]


def report_html(diagnosis: Diagnosis) -> str:
    """Return the report as one page."""
    return page_html(heading(diagnosis), gap_sections(diagnosis))


def format_diagnosis(diagnosis: Diagnosis) -> str:
    """Return the text for a terminal."""
    return sections_to_text(gap_sections(diagnosis))


def diagnosis_to_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as plain data in the layout of gap.json."""
    return {
        'schema': SCHEMA,
        'runs': list(diagnosis.runs),
        'measured': [measured_run(view) for view in diagnosis.shown.views],
        'verdict': diagnosis.verdict,
        'sentence': diagnosis.sentence,
        'gap': asdict(diagnosis.gap),
        'causes': [asdict(c) for c in diagnosis.causes],
        'unnamed': None if diagnosis.unnamed is None else asdict(diagnosis.unnamed),
        'unexplained': {
            'rms_um': diagnosis.unexplained_um,
            'where': diagnosis.unexplained_where,
        },
        'not_visible': [{'effect': e, 'needs': n} for e, n in diagnosis.not_visible],
        'where': asdict(diagnosis.where),
        'considered': [{'effect': e, 'log_odds': s} for e, s in diagnosis.considered],
        'table_change_um': diagnosis.table_change_um,
        'smallest_found_um': dict(diagnosis.smallest_found_um),
        'contradictions': [asdict(finding) for finding in diagnosis.contradictions],
        'reversal': diagnosis.reversal.model,
        'run_id': diagnosis.calibration.plain.run_id,
        'provenance': provenance(
            'diagnose',
            method='otf',
            runs=diagnosis.origin,
            coverage=f'{STANDARD}; intervals: 95 %',
        ),
    }


def effects_file(run: int) -> str:
    """File of the effects in one run; further runs have one where theirs differ."""
    return f'effects_run_{run + 1}.yaml' if run else 'effects.yaml'


@limit_to_one_thread
def write_diagnosis(
    diagnosis: Diagnosis, folder: str | Path, report: str = REPORT_FILE
) -> list[Path]:
    """Write gap.json, report.html, and with causes effects.yaml and both calibrations.

    Parameters
    ----------
    folder : str or Path
        Made if missing.
    report : str
        Name of the report.

    Returns
    -------
    list of Path
        gap.json last.
    """
    folder = ensure_folder(folder)
    written: list[Path] = []
    first, calibration = diagnosis.applied[0], diagnosis.calibration
    if first:
        for number, applied in enumerate(diagnosis.applied):
            if not number or applied != first:
                written.append(folder / effects_file(number))
                write_effects(written[-1], applied, diagnosis.machine)
    tables = {}
    if first and diagnosis.causes and calibration.applied:
        tables['calibration_plain'] = calibration.plain
        tables['calibration_with_effects'] = calibration
        written.append(folder / 'calibration_with_effects')

    def write(name: str) -> None:
        if name in tables:
            write_calibration(
                replace(tables[name], uncorrected=None, applied=()),
                folder / name,
                certificate=False,
            )
        else:
            write_text(folder / name, report_html(diagnosis))

    share_out(write, [report, *tables])
    content = diagnosis_to_dict(diagnosis)
    write_text(folder / 'gap.json', json.dumps(content, indent=1) + '\n')
    return [*written, folder / report, folder / 'gap.json']
