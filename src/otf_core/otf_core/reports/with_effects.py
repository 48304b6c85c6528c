# SPDX-License-Identifier: Apache-2.0
"""The files of a calibration with effects taken off."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from otf_core.calibration.with_effects import EffectsCalibration
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import write_effects
from otf_core.files.writing import write_if_it_fits
from otf_core.reports.calibration import TABLES_FILE, facts_of, write_calibration, write_report

PLAIN_FOLDER = 'plain'
EFFECTS_FILE = 'effects_taken_off'


def write_with_effects(
    done: EffectsCalibration,
    folder: str | Path,
    *,
    residuals_csv: bool = False,
    report: bool = True,
    certificate: bool = False,
    missing: dict[str, str] | None = None,
) -> list[Path]:
    """Write the calibration, the effects taken off, and the plain calibration in ``plain/``.

    Without effects taken off there is no folder ``plain``: the tables are the plain ones.
    ``missing`` as of ``write_calibration``.

    Returns
    -------
    list of Path
    """
    folder = Path(folder)
    files = []
    written = write_calibration(
        done.result,
        folder,
        residuals_csv=residuals_csv,
        report=report,
        certificate=certificate,
        missing=missing,
    )
    machine = done.result.tables.machine
    for number, applied in enumerate(done.applied):
        if applied and (not number or _differs(applied, done.applied[0])):
            name = f'{EFFECTS_FILE}_run_{number + 1}' if number else EFFECTS_FILE
            files.append(folder / f'{name}.yaml')
            write_effects(files[-1], applied, machine)
    if done.applied[0]:
        plain = folder / PLAIN_FOLDER
        lost: dict[str, str] | None = None if missing is None else {}
        if write_if_it_fits(
            missing,
            PLAIN_FOLDER,
            lambda: write_calibration(done.plain, plain, report=report, missing=lost),
        ):
            files.append(plain / TABLES_FILE)
        for name, why in (lost or {}).items():
            assert missing is not None
            missing[f'{PLAIN_FOLDER}/{name}'] = why
    return [*written, *files]


def write_reports(done: EffectsCalibration, folder: Path) -> None:
    """Write the reports that ``write_with_effects`` has left out."""
    if done.applied[0]:
        write_report(folder / PLAIN_FOLDER, facts_of(done.plain))
    write_report(folder, facts_of(done.result))


def _differs(a: Sequence[AppliedEffect], b: Sequence[AppliedEffect]) -> bool:
    return any(dict(x.parameters) != dict(y.parameters) for x, y in zip(a, b, strict=True))
