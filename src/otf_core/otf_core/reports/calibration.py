# SPDX-License-Identifier: Apache-2.0
"""What ``otf calibrate`` writes: report, certificate and all files of a calibration."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.budget.typical import typical_to_dict
from otf_core.calibration.calibration_result import GAUGE, CalibrationResult, RunResult
from otf_core.calibration.with_effects import EffectsCalibration
from otf_core.config import OTF, STANDSTILL
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import write_effects
from otf_core.effects.stated_effect import effects_to_list
from otf_core.files.writing import (
    ensure_folder,
    tidy,
    write_if_possible,
    write_text,
)
from otf_core.model.motions import MOTIONS, SQUARENESS, unit_of
from otf_core.model.provenance import STANDARD, provenance
from otf_core.model.tables import tables_to_dict
from otf_core.noise.noise_model import noise_to_fields
from otf_core.prediction.covariance import pack_covariance
from otf_core.prediction.driven_volume import driven_volume
from otf_core.prediction.volumetric import volumetric_error
from otf_core.reports.calibration_facts import (
    BudgetLine,
    CalibrationFacts,
    budget_lines,
    budget_to_dict,
    expanded_uncertainties,
)
from otf_core.reports.calibration_sections.error_motions import (
    motions_section,
    nodes_section,
    reversal_section,
    reversal_to_dict,
    squareness_section,
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

# What ``otf calibrate`` writes: the report of its sections, and all files of a calibration.
#
# ``error_tables.json`` (holds the covariance in full precision, so that a copy of it predicts with
# honest uncertainties), ``error_tables.csv`` (one row a node), ``residuals.npz`` (one row a path
# piece), ``report.html`` (all of it for a reader), ``certificate.html`` (two pages for print, of a
# machine with a section ``certificate``). With effects taken off: ``effects_taken_off.yaml``, and
# the plain calibration in ``plain/``.

SECTIONS: tuple[Callable[[CalibrationFacts], Section | None], ...] = (
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


def result_to_dict(
    result: CalibrationResult, verb: str = 'calibrate', facts: CalibrationFacts | None = None
) -> dict[str, Any]:
    """Return a calibration as plain data in the layout of error_tables.json.

    ``facts`` are worked out if not given.
    """
    facts = facts or facts_of(result, verb)
    data, pose, lines = tables_to_dict(result.tables), result.T_machine_tracker, list(facts.lines)
    for name, wide in expanded_uncertainties(result.tables, lines).items():
        data['squareness' if name in SQUARENESS else 'motions'][name] |= wide
    data |= {
        'alignment': {
            'rotation': pose.rotation.tolist(),
            'translation': pose.translation.tolist(),
        },
        'fit': asdict(result.fit),
        'reversal': reversal_to_dict(result.reversal, result.tables),
        'runs': [_run_to_dict(run) for run in result.runs],
        'run_id': result.run_id,
        'gauge': GAUGE,
        'spacing': _spacing_to_dict(result),
        'prior': {name: {'sd': size} for name, size in result.prior.items()},
        'covariance': pack_covariance(result.covariance),
        **budget_to_dict(result.tables, result.budget, lines),
        'driven': driven_volume(
            np.concatenate([run.q for run in result.runs]),
            result.config.corner_exclusion + result.config.piece_length,
        ).to_dict(),
        'typical_systematic': typical_to_dict(result.typical),
        'not_identifiable': list(result.not_identifiable),
        'effects': effects_to_list(result.effects),
        'effects_sentence': result.effects_sentence,
        'warnings': list(result.warnings),
        'failed_gates': list(result.failed_gates),
        'verdicts': result.verdicts.to_dict(),
        'headline': result.headline.to_dict(),
        'target_offset_bound': result.offset_bound.to_dict(),
        'config': asdict(result.config),
        'volumetric_error': volumetric_error(result.tables),
        'provenance': dict(facts.provenance),
    }
    return data


def _run_to_dict(run: RunResult) -> dict[str, Any]:
    pose = run.T_machine_tracker
    return {
        'name': run.name,
        'target_offset': run.target_offset.tolist(),
        'alignment': {
            'rotation': pose.rotation.tolist(),
            'translation': pose.translation.tolist(),
        },
        'coverage': run.coverage,
        'samples': run.samples,
        'pieces': len(run.pieces),
        'residual_rms': float(np.sqrt(np.mean(np.sum(run.residual**2, axis=0)))),
        'noise': noise_to_fields(run.noise),
        'misfit': asdict(run.misfit),
    }


def _spacing_to_dict(result: CalibrationResult) -> dict[str, Any]:
    """Spacing of the nodes, and what straight lines between them cost: wished for and taken."""
    costs = [
        {
            'fraction': fraction,
            'grid': cost.grid,
            'motions': {n: {'unit': unit_of(n), 'rms': v} for n, v in cost.motions.items()},
        }
        for fraction, cost in sorted(result.table_costs.items())
    ]
    return {'table_pitch_over': result.fraction, 'cost': costs}


def _tidy_rows(result: CalibrationResult, budget: list[BudgetLine]) -> str:
    lines = ['motion,axis,position,value,unit,u,identifiable,U,k,U_with_typical,target_offset']
    wide = expanded_uncertainties(result.tables, budget)
    for motion in MOTIONS:
        table = result.tables.motions[motion]
        known = table.node_identifiable
        flags = np.ones(len(table.position)) if known is None else known
        k = wide[motion]['k']
        whole, offset = result.expanded[motion], _offset_cell(result, motion)
        rows = zip(
            table.position, table.value, table.u, flags, wide[motion]['U'], whole, strict=True
        )
        for position, value, u, seen, wide_u, whole_u in rows:
            lines.append(
                f'{motion},{motion.axis},{tidy(position)!r},{float(value) + 0.0!r},{motion.unit},'
                f'{float(u)!r},{str(bool(seen)).lower()},{wide_u!r},{_factor(k)},{float(whole_u)!r},{offset}'
            )
    for name in SQUARENESS:
        entry = result.tables.squareness[name]
        seen = name not in result.not_identifiable
        lines.append(
            f'{name},,,{entry.value + 0.0!r},rad,{entry.u!r},{str(seen).lower()},'
            f'{wide[name]["U"]!r},{_factor(wide[name]["k"])},'
            f'{float(result.expanded[name][0])!r},{_offset_cell(result, name)}'
        )
    return '\n'.join(lines) + '\n'


def _offset_cell(result: CalibrationResult, name: str) -> str:
    """Target offset at which alone a value holds, m; empty: at any."""
    bound = result.offset_bound
    return ' '.join(f'{v:g}' for v in bound.offset) if name in bound.contains else ''


def _factor(k: float | None) -> str:
    """Coverage factor in a CSV cell; empty where nothing is uncertain."""
    return '' if k is None else repr(float(k))


@limit_to_one_thread
def write_calibration(
    result: CalibrationResult,
    folder: str | Path,
    verb: str = 'calibrate',
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
    verb : str
        Command that the files come from.
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
    facts = facts or facts_of(result, verb)
    lines = list(facts.lines)
    data = result_to_dict(result, verb, facts)
    write_text(folder / TABLES_FILE, json.dumps(data, indent=1) + '\n')
    wanted: dict[str, Callable[[], object]] = {
        'error_tables.csv': lambda: write_text(
            folder / 'error_tables.csv', _tidy_rows(result, lines)
        ),
    }
    if report:
        wanted[REPORT_FILE] = lambda: write_report(folder, facts)
    if certificate and result.tables.machine.stated.certificate:
        wanted[CERTIFICATE_FILE] = lambda: write_text(
            folder / CERTIFICATE_FILE, certificate_html(facts)
        )
    if residuals:
        wanted[RESIDUALS_FILE] = lambda: write_residuals(residual_arrays(result.runs), folder)
    if residuals_csv:
        wanted[RESIDUALS_TEXT] = lambda: write_residuals_text(residual_arrays(result.runs), folder)
    written = [name for name, write in wanted.items() if write_if_possible(missing, name, write)]
    return [folder / TABLES_FILE, *(folder / name for name in written)]


def write_report(folder: Path, facts: CalibrationFacts) -> None:
    """Write report.html into a folder that is there; ConfigError if it cannot be written."""
    write_text(folder / REPORT_FILE, calibration_html(facts))


def facts_of(
    result: CalibrationResult, verb: str = 'calibrate', lines: Sequence[BudgetLine] | None = None
) -> CalibrationFacts:
    """What a report is made of; ``lines`` of the budget are worked out if not given."""
    about = provenance(
        verb,
        method=STANDSTILL if result.runs[0].pieces.standstill else OTF,
        runs=result.origin,
        coverage=f'{STANDARD}; U: expanded uncertainty for 95 %, k beside it',
    )
    budget = budget_lines(result.tables, result.budget_with_typical) if lines is None else lines
    return CalibrationFacts(result, tuple(budget), about)


def write_with_effects(
    both: EffectsCalibration,
    folder: str | Path,
    *,
    residuals: bool = True,
    residuals_csv: bool = False,
    report: bool = True,
    missing: dict[str, str] | None = None,
) -> list[Path]:
    """Write the calibration, the effects taken off, and the plain calibration in ``plain/``.

    Without effects taken off there is no folder ``plain``: the tables are the plain ones.
    ``missing`` as of ``write_calibration``.
    """
    folder = Path(folder)
    files = []
    written = write_calibration(
        both.result,
        folder,
        residuals=residuals,
        residuals_csv=residuals_csv,
        report=report,
        missing=missing,
    )
    machine = both.result.tables.machine
    for number, applied in enumerate(both.applied):
        if applied and (not number or _differs(applied, both.applied[0])):
            name = f'{EFFECTS_FILE}_run_{number + 1}' if number else EFFECTS_FILE
            files.append(folder / f'{name}.yaml')
            write_effects(files[-1], applied, machine)
    if both.applied[0]:
        plain = folder / PLAIN_FOLDER
        lost: dict[str, str] | None = None if missing is None else {}
        if write_if_possible(
            missing,
            PLAIN_FOLDER,
            lambda: write_calibration(
                both.plain,
                plain,
                residuals=residuals,
                report=report,
                certificate=False,
                missing=lost,
            ),
        ):
            files.append(plain / TABLES_FILE)
        for name, why in (lost or {}).items():
            assert missing is not None
            missing[f'{PLAIN_FOLDER}/{name}'] = why
    return [*written, *files]


def write_reports(both: EffectsCalibration, folder: Path) -> None:
    """Write the reports that ``write_with_effects`` has left out."""
    write_report(folder, facts_of(both.result))
    if both.applied[0]:
        write_report(folder / PLAIN_FOLDER, facts_of(both.plain))


def write_residuals_of_both(both: EffectsCalibration, folder: Path) -> None:
    """Write residuals.npz where ``write_with_effects`` has left it out."""
    write_residuals(residual_arrays(both.result.runs), folder)
    if both.applied[0]:
        write_residuals(residual_arrays(both.plain.runs), folder / PLAIN_FOLDER)


def _differs(a: Sequence[AppliedEffect], b: Sequence[AppliedEffect]) -> bool:
    return any(dict(x.parameters) != dict(y.parameters) for x, y in zip(a, b, strict=True))
