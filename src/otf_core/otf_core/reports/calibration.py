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
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.calibration.calibration_result import (
    COLUMNS,
    CalibrationResult,
    RunResult,
    table_cells,
)
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import write_effects
from otf_core.files.strict_yaml import read_json
from otf_core.files.writing import (
    ensure_folder,
    whole_file,
    write_if_possible,
    write_text,
)
from otf_core.prediction.calibration_document import CalibrationDocument
from otf_core.reports.calibration_page import calibration_page, certificate_page
from otf_core.threads import limit_to_one_thread

TABLES_FILE, REPORT_FILE = 'error_tables.json', 'report.html'
CERTIFICATE_FILE, RESIDUALS_FILE = 'certificate.html', 'residuals.npz'
PLAIN_FOLDER = 'plain'
EFFECTS_FILE = 'effects_taken_off'


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


def residual_arrays(runs: Sequence[RunResult]) -> dict[str, NDArray[np.generic]]:
    """Return the residuals of all runs under the names of ``residuals.npz``, a row a path piece.

    Returns
    -------
    dict of str to ndarray
        ``run``, ``part``, ``leg``, ``count``, shape (n,); ``time``, s; ``speed``, m/s; ``q``,
        (n, k), m and rad; ``axes``, shape (n, c, 3), unit vectors in the frame of the tracker's
        link; ``deviation``, ``residual``, shape (n, c), m.
    """
    pieces = [run.pieces for run in runs]
    counts = {
        'run': np.repeat(np.arange(len(runs)), [len(p) for p in pieces]),
        'part': np.concatenate([run.part for run in runs]),
        'leg': np.concatenate([p.leg for p in pieces]),
        'count': np.concatenate([p.count for p in pieces]),
    }
    return {
        **{name: np.asarray(values, np.int32) for name, values in counts.items()},
        'time': np.concatenate([p.time for p in pieces]),
        'speed': np.concatenate([run.speed for run in runs]),
        'q': np.concatenate([run.q for run in runs]),
        'axes': np.concatenate([np.stack(tuple(run.axes), axis=1) for run in runs]),
        'deviation': np.concatenate([run.deviation.T for run in runs]),
        'residual': np.concatenate([run.residual.T for run in runs]),
    }


def write_residuals(arrays: Mapping[str, NDArray[np.generic]], folder: Path) -> None:
    """Write residuals.npz."""
    with whole_file(folder / RESIDUALS_FILE) as partial, partial.open('wb') as file:
        np.savez(file, allow_pickle=False, **arrays)


@limit_to_one_thread
def write_calibration(
    result: CalibrationResult,
    folder: str | Path,
    *,
    residuals: bool = True,
    report: bool = True,
    certificate: bool = True,
    missing: dict[str, str] | None = None,
) -> list[Path]:
    """Write all files of a calibration, the most important first.

    Parameters
    ----------
    folder : str or Path
        Made if missing; files of the same names are replaced.
    residuals : bool
        Write residuals.npz.
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
    text = json.dumps(result.to_dict(), indent=1, allow_nan=False)
    write_text(folder / TABLES_FILE, text + '\n')
    data = json.loads(text)
    wanted: dict[str, Callable[[], object]] = {
        'error_tables.csv': lambda: write_text(
            folder / 'error_tables.csv', _rows_csv(result.document)
        ),
    }
    if report:
        wanted[REPORT_FILE] = lambda: write_text(folder / REPORT_FILE, calibration_page(data))
    if certificate and result.tables.machine.stated.certificate:
        wanted[CERTIFICATE_FILE] = lambda: write_text(
            folder / CERTIFICATE_FILE, certificate_page(data)
        )
    if residuals:
        wanted[RESIDUALS_FILE] = lambda: write_residuals(residual_arrays(result.runs), folder)
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
