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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.typical import typical_to_dict
from otf_core.calibration.budget_blocks import (
    budget_lines,
    budget_to_dict,
    expanded_uncertainties,
)
from otf_core.calibration.calibration_result import (
    COLUMNS,
    CalibrationResult,
    RunResult,
    gauge_of,
    table_cells,
)
from otf_core.calibration.views import result_views, run_view
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import write_effects
from otf_core.effects.stated_effect import effects_to_list
from otf_core.files.strict_yaml import read_json
from otf_core.files.writing import (
    ensure_folder,
    write_if_possible,
    write_text,
)
from otf_core.model.machine import SPINDLE
from otf_core.model.motions import ErrorMotion, unit_of
from otf_core.model.provenance import STANDARD, provenance
from otf_core.model.tables import ErrorTables, tables_to_dict
from otf_core.noise.noise_model import noise_to_fields
from otf_core.prediction.covariance import pack_covariance
from otf_core.prediction.driven_volume import driven_volume, linear_positions
from otf_core.reports.calibration_page import calibration_page, certificate_page
from otf_core.reports.residual_files import (
    RESIDUALS_FILE,
    RESIDUALS_TEXT,
    residual_arrays,
    write_residuals,
    write_residuals_text,
)
from otf_core.solving.reversal import Reversal
from otf_core.threads import limit_to_one_thread

TABLES_FILE, REPORT_FILE = 'error_tables.json', 'report.html'
CERTIFICATE_FILE = 'certificate.html'
PLAIN_FOLDER = 'plain'
EFFECTS_FILE = 'effects_taken_off'


def result_to_dict(result: CalibrationResult, verb: str = 'calibrate') -> dict[str, Any]:
    """Return a calibration as plain data in the layout of error_tables.json."""
    data, tables = tables_to_dict(result.tables), result.tables
    lines = budget_lines(tables, result.budget_with_typical, result.not_identifiable)
    entries = {**data['motions'], **data['squareness'], **data['location']}
    for name, wide in expanded_uncertainties(tables, lines).items():
        entries[name] |= wide
    for name, need in result.advice.items():
        entries[name]['needs'] = need
    lags = {one.axis: {'unit': 's', 'value': one.value, 'u': one.u} for one in result.lags}
    return data | {
        'targets': {
            name: {'link': own.link, 'place': own.place.tolist(), 'u': own.u.tolist()}
            for name, own in result.targets.items()
        },
        'alignment': result.T_machine_tracker.to_dict(),
        'tracker_link': tables.machine.tracker.link,
        'fit': asdict(result.fit),
        'reversal': {**reversal_to_dict(result.reversal, tables), 'lags': lags},
        'runs': [_run_to_dict(run) for run in result.runs],
        'run_id': result.run_id,
        'gauge': gauge_of(tables.machine),
        'spacing': _spacing_to_dict(result),
        'prior': {name: {'sd': size} for name, size in result.prior.items()},
        'covariance': pack_covariance(result.covariance, tables.machine),
        **budget_to_dict(tables, result.budget, lines),
        'driven': driven_volume(
            _linear_positions(result), result.config.corner_exclusion + result.config.piece_length
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
        **result_views(result),
        'provenance': provenance(
            verb,
            method=result.method,
            runs=result.origin,
            coverage=f'{STANDARD}; U: expanded uncertainty for 95 %, k beside it',
        ),
    }


def _linear_positions(result: CalibrationResult) -> Array:
    """Positions (n, 3) of the linear axes at the pieces; of reflectors in the spindle if any."""
    targets = result.tables.machine.targets
    spindle = np.concatenate(
        [np.array([targets[p.target].link == SPINDLE for p in run.parts])[run.part]
         for run in result.runs]
    )  # fmt: skip
    q = np.concatenate([run.q for run in result.runs])
    return linear_positions(result.tables.machine, q[spindle] if spindle.any() else q)


def driven_run(run: RunResult) -> dict[str, Any]:
    """Return how a run was driven and measured; where its residuals lie is left out."""
    return {k: v for k, v in _run_to_dict(run).items() if k not in ('legs', 'track', 'drift')}


def _run_to_dict(run: RunResult) -> dict[str, Any]:
    return {
        'name': run.name,
        'target_offset': run.target_offset.tolist(),
        'parts': [asdict(part) for part in run.parts],
        'alignment': run.T_machine_tracker.to_dict(),
        'coverage': run.coverage,
        'samples': run.samples,
        'pieces': len(run.pieces),
        'residual_rms': float(np.sqrt(np.mean(np.sum(run.residual**2, axis=0)))),
        'noise': noise_to_fields(run.noise),
        'misfit': asdict(run.misfit),
        **run_view(run),
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


def _rows_csv(result: CalibrationResult) -> str:
    """All nodes and scalars as text, a row each; a cell is empty where there is nothing."""

    def cell(value: object) -> str:
        if isinstance(value, tuple):
            return ' '.join(f'{v:g}' for v in value)
        if (isinstance(value, float) and math.isnan(value)) or value is None:
            return ''
        return str(value).lower() if isinstance(value, bool) else f'{value}'

    rows = [','.join(map(cell, row)) for row in table_cells(result)]
    return '\n'.join([','.join(('motion', *COLUMNS[1:])), *rows]) + '\n'


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
    missing : dict of str to str, optional
        Takes names of files that are left out as the disk is full, and why; error_tables.json
        never is.

    Raises
    ------
    ConfigError
        If the folder cannot be written.
    """
    folder = ensure_folder(folder)
    text = json.dumps(result_to_dict(result, verb), indent=1)
    write_text(folder / TABLES_FILE, text + '\n')
    data = json.loads(text)
    wanted: dict[str, Callable[[], object]] = {
        'error_tables.csv': lambda: write_text(folder / 'error_tables.csv', _rows_csv(result)),
    }
    if report:
        wanted[REPORT_FILE] = lambda: write_text(folder / REPORT_FILE, calibration_page(data))
    if certificate and result.tables.machine.stated.certificate:
        wanted[CERTIFICATE_FILE] = lambda: write_text(
            folder / CERTIFICATE_FILE, certificate_page(data)
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
            write_text(place / REPORT_FILE, calibration_page(read_json(place / TABLES_FILE)))
        else:
            write_residuals(residual_arrays(one.runs), place)


def _directions(
    reversal: Reversal, tables: ErrorTables
) -> Iterator[tuple[str, Array, Array, bool]]:
    for name, table in reversal.motions.items():
        mean = tables.motions[name].value
        forward, backward = mean + 0.5 * table.value, mean - 0.5 * table.value
        yield name, forward, backward, table.identifiable


def reversal_to_dict(reversal: Reversal, tables: ErrorTables) -> dict[str, Any]:
    """Return a reversal model as plain data for error_tables.json."""
    motions = {}
    for name, forward, backward, seen in _directions(reversal, tables):
        table = reversal.motions[name]
        motions[name] = {
            'axis': ErrorMotion.of(name).axis,
            'unit': unit_of(name),
            'position': table.position.tolist(),
            'forward': forward.tolist(),
            'backward': backward.tolist(),
            'value': table.value.tolist(),
            'u': table.u.tolist(),
            'identifiable': seen,
        }
    return {
        'model': reversal.model,
        'evidence': dict(reversal.evidence),
        'held': reversal.held,
        'sign': 'value = forward minus backward; forward: towards larger positions',
        'axes': {
            axis: {'value': size.value, 'u': size.u} for axis, size in reversal.backlash.items()
        },
        'motions': motions,
    }
