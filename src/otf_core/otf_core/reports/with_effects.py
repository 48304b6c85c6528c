# SPDX-License-Identifier: Apache-2.0
"""The files of a calibration with effects taken off."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from otf_core.calibration.with_effects import EffectsCalibration
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import write_effects
from otf_core.reports.calibration import facts_of, write_calibration, write_report

PLAIN_FOLDER = 'plain'
EFFECTS_FILE = 'effects_taken_off'


def write_with_effects(
    done: EffectsCalibration,
    folder: str | Path,
    *,
    residuals_csv: bool = False,
    report: bool = True,
    certificate: bool = False,
) -> list[Path]:
    """Write the calibration, the effects taken off, and the plain calibration in ``plain/``.

    Without effects taken off there is no folder ``plain``: the tables are the plain ones.

    Returns
    -------
    list of Path
    """
    folder = Path(folder)
    files = []
    if done.applied[0]:
        files = write_calibration(done.plain, folder / PLAIN_FOLDER, report=report)[:1]
    written = write_calibration(
        done.result, folder, residuals_csv=residuals_csv, report=report, certificate=certificate
    )
    machine = done.result.tables.machine
    for number, applied in enumerate(done.applied):
        if applied and (not number or _differs(applied, done.applied[0])):
            name = f'{EFFECTS_FILE}_run_{number + 1}' if number else EFFECTS_FILE
            files.append(folder / f'{name}.yaml')
            write_effects(files[-1], applied, machine)
    return [*written, *files]


def write_reports(done: EffectsCalibration, folder: Path) -> None:
    """Write the reports that ``write_with_effects`` has left out."""
    if done.applied[0]:
        write_report(folder / PLAIN_FOLDER, facts_of(done.plain))
    write_report(folder, facts_of(done.result))


def _differs(a: Sequence[AppliedEffect], b: Sequence[AppliedEffect]) -> bool:
    return any(dict(x.parameters) != dict(y.parameters) for x, y in zip(a, b, strict=True))
