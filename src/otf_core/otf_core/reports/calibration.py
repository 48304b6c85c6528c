# SPDX-License-Identifier: Apache-2.0
"""What ``otf calibrate`` writes: report, certificate and all files of a calibration.

``error_tables.json`` (holds the covariance in full precision, so that a copy of it predicts with
honest uncertainties), ``error_tables.csv`` (one row a node), ``residuals.npz`` (one row a path
piece), ``report.html`` (all of it for a reader), ``certificate.html`` (two pages for print, of a
machine with a section ``certificate``). With effects taken off: ``effects_taken_off.yaml``, and
the plain calibration in ``plain/``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path

from otf_core.calibration.calibration_result import (
    COLUMNS,
    CalibrationResult,
    table_cells,
)
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import write_effects
from otf_core.files.writing import (
    ensure_folder,
    write_if_possible,
    write_text,
)
from otf_core.prediction.calibration_document import CalibrationDocument
from otf_core.reports.calibration_facts import (
    CalibrationFacts,
)
from otf_core.reports.calibration_sections.error_motions import (
    location_section,
    motions_section,
    nodes_section,
    reversal_section,
    squareness_section,
    targets_section,
)
from otf_core.reports.calibration_sections.first_screen import (
    heading,
    limits_section,
    overview_section,
)
from otf_core.reports.calibration_sections.measurement import (
    conditions_section,
    conventions_section,
    data_quality_section,
    drift_section,
    effects_section,
    fit_section,
    path_section,
    provenance_section,
)
from otf_core.reports.calibration_sections.uncertainty_budget import (
    budget_section,
    correlations_section,
)
from otf_core.reports.calibration_sections.volumetric_error import (
    coverage_section,
    diagonals_section,
    turns_section,
    volume_section,
)
from otf_core.reports.certificate import certificate_html
from otf_core.reports.page import (
    Section,
    page_html,
)
from otf_core.reports.residual_files import (
    RESIDUALS_FILE,
    RESIDUALS_TEXT,
    residual_arrays,
    write_residuals,
    write_residuals_text,
)
from otf_core.threads import limit_to_one_thread

SECTIONS: tuple[Callable[[CalibrationFacts], Section | None], ...] = (
    overview_section,
    limits_section,
    motions_section,
    squareness_section,
    location_section,
    targets_section,
    effects_section,
    volume_section,
    turns_section,
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
TABLES_FILE, REPORT_FILE = 'error_tables.json', 'report.html'
CERTIFICATE_FILE = 'certificate.html'
PLAIN_FOLDER = 'plain'
EFFECTS_FILE = 'effects_taken_off'


def calibration_sections(facts: CalibrationFacts) -> list[Section]:
    """All sections of one calibration; pictures are drawn when a page asks for them."""
    sections = (section(facts) for section in SECTIONS)
    return [section for section in sections if section is not None]


def calibration_html(facts: CalibrationFacts) -> str:
    """Return the report as one page."""
    return page_html(heading(facts), calibration_sections(facts))


def _rows_csv(document: CalibrationDocument) -> str:
    """All nodes and scalars as text, a row each; a cell is empty where there is nothing."""

    def cell(value: object) -> str:
        if isinstance(value, tuple):
            return ' '.join(f'{v:g}' for v in value)
        if (isinstance(value, float) and math.isnan(value)) or value is None:
            return ''
        return str(value).lower() if isinstance(value, bool) else f'{value}'

    rows = [','.join(map(cell, row)) for row in table_cells(document)]
    return '\n'.join([','.join(('motion', *COLUMNS[1:])), *rows]) + '\n'


@limit_to_one_thread
def write_calibration(
    result: CalibrationResult,
    folder: str | Path,
    *,
    residuals: bool = True,
    residuals_csv: bool = False,
    report: bool = True,
    certificate: bool = True,
    facts: CalibrationFacts | None = None,
    missing: dict[str, str] | None = None,
) -> list[Path]:
    """Write all files of a calibration, the most important first.

    Parameters
    ----------
    folder : str or Path
        Made if missing; files of the same names are replaced.
    residuals : bool
        Write residuals.npz.
    residuals_csv : bool
        Write the residuals as text too.
    report : bool
        Write report.html.
    certificate : bool
        Write certificate.html if machine.yaml has a section ``certificate``.
    facts : CalibrationFacts, optional
        Worked out if not given.
    missing : dict of str to str, optional
        Takes names of files that are left out as the disk is full, and why; error_tables.json
        never is.

    Raises
    ------
    ConfigError
        If the folder cannot be written.
    """
    folder = ensure_folder(folder)
    facts = facts or facts_of(result)
    text = json.dumps(result.to_dict(), indent=1, allow_nan=False) + '\n'
    write_text(folder / TABLES_FILE, text)
    wanted: dict[str, Callable[[], object]] = {
        'error_tables.csv': lambda: write_text(
            folder / 'error_tables.csv', _rows_csv(result.document)
        ),
    }
    if report:
        wanted[REPORT_FILE] = lambda: write_text(folder / REPORT_FILE, calibration_html(facts))
    if certificate and result.tables.machine.stated.certificate:
        wanted[CERTIFICATE_FILE] = lambda: write_text(
            folder / CERTIFICATE_FILE, certificate_html(facts)
        )
    if residuals:
        wanted[RESIDUALS_FILE] = lambda: write_residuals(residual_arrays(result.runs), folder)
    if residuals_csv:
        wanted[RESIDUALS_TEXT] = lambda: write_residuals_text(
            residual_arrays(result.runs), folder, result.tables.machine.axis_names
        )
    written = [name for name, write in wanted.items() if write_if_possible(missing, name, write)]
    files = [folder / TABLES_FILE, *(folder / name for name in written)]
    files += _write_effects(result, folder)
    plain, own = result.uncorrected, folder / PLAIN_FOLDER
    if plain is None:
        return files
    lost: dict[str, str] | None = None if missing is None else {}

    def write_plain() -> None:
        write_calibration(plain, own, residuals=residuals, report=report, certificate=False,
                          missing=lost)  # fmt: skip

    if write_if_possible(missing, PLAIN_FOLDER, write_plain):
        files.append(own / TABLES_FILE)
    if missing is not None:
        missing.update({f'{PLAIN_FOLDER}/{name}': why for name, why in (lost or {}).items()})
    return files


def facts_of(result: CalibrationResult) -> CalibrationFacts:
    """What a report is made of."""
    return CalibrationFacts(result, tuple(result.budget_lines), result.document.provenance)


def _write_effects(result: CalibrationResult, folder: Path) -> list[Path]:
    """Write what was taken off: of the first run, and of others where it differs."""
    files, first = list[Path](), result.applied[0] if result.applied else ()
    for number, applied in enumerate(result.applied):
        if not number or _differs(applied, first):
            name = f'{EFFECTS_FILE}_run_{number + 1}' if number else EFFECTS_FILE
            files.append(folder / f'{name}.yaml')
            write_effects(files[-1], applied, result.tables.machine)
    return files


def _differs(a: Sequence[AppliedEffect], b: Sequence[AppliedEffect]) -> bool:
    return any(dict(x.parameters) != dict(y.parameters) for x, y in zip(a, b, strict=True))


def write_later(result: CalibrationResult, folder: Path, name: str) -> None:
    """Write report.html or residuals.npz, also of the plain calibration, that were left out."""
    pairs = [(result, folder)]
    if result.uncorrected is not None:
        pairs.append((result.uncorrected, folder / PLAIN_FOLDER))
    for one, place in pairs:
        if name == REPORT_FILE:
            write_text(place / REPORT_FILE, calibration_html(facts_of(one)))
        else:
            write_residuals(residual_arrays(one.runs), place)
