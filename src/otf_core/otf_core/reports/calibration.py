# SPDX-License-Identifier: Apache-2.0
"""The files and the text of a calibration.

``error_tables.json`` (INTERFACES layout; holds the covariance in full precision, so that a copy
of it predicts with honest uncertainties), ``error_tables.csv`` (one row a node), ``reversal.csv``
(the same, forward and backward), ``residuals.npz`` (one row a path piece), ``summary.txt``.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.budget.typical import typical_to_dict
from otf_core.calibration.result import GAUGE, CalibrationResult, RunResult
from otf_core.config import OTF, STANDSTILL
from otf_core.effects.stated import effects_to_list, format_effects
from otf_core.files.csv_points import tidy
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.motions import MOTIONS, SQUARENESS, unit_of
from otf_core.model.provenance import STANDARD, provenance
from otf_core.model.tables import tables_to_dict
from otf_core.noise.fields import noise_to_fields
from otf_core.prediction.covariance import pack_covariance
from otf_core.prediction.driven_volume import driven_volume
from otf_core.reports.budget import (
    BudgetLine,
    budget_lines,
    budget_to_dict,
    expanded,
    format_budget,
)
from otf_core.reports.calibration_words import (
    convention_lines,
    squareness_words,
    volumetric_error,
    volumetric_line,
)
from otf_core.reports.residuals import write_residuals
from otf_core.reports.reversal import format_reversal, reversal_csv, reversal_to_dict

TABLES_FILE = 'error_tables.json'


def result_to_dict(
    result: CalibrationResult, verb: str = 'calibrate', lines: list[BudgetLine] | None = None
) -> dict[str, Any]:
    """Return a calibration as plain data in the layout of error_tables.json.

    ``lines`` of its budget are worked out if not given.
    """
    data, pose = tables_to_dict(result.tables), result.T_machine_tracker
    lines = budget_lines(result.tables, result.budget) if lines is None else lines
    for name, wide in expanded(result.tables, lines).items():
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
        'spacing': _spacing(result),
        'prior': {name: asdict(known) for name, known in result.prior.items()},
        'covariance': pack_covariance(result.covariance),
        **budget_to_dict(result.tables, result.budget, lines),
        'driven': driven_volume(
            np.concatenate([run.q for run in result.runs]),
            result.config.corner_exclusion + result.config.piece_length,
        ).to_dict(),
        'typical_systematic': typical_to_dict(result.typical),
        'not_identifiable': list(result.not_identifiable),
        'effects': effects_to_list(result.effects),
        'warnings': list(result.warnings),
        'failed_gates': list(result.failed_gates),
        'config': asdict(result.config),
        'volumetric_error': volumetric_error(result.tables),
        'provenance': provenance(
            verb,
            method=STANDSTILL if result.runs[0].pieces.standstill else OTF,
            runs=result.origin,
            coverage=f'{STANDARD}; U: expanded uncertainty for 95 %, k beside it',
        ),
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


def _spacing(result: CalibrationResult) -> dict[str, Any]:
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
    lines = ['motion,axis,position,value,unit,u,identifiable,U,k']
    wide = expanded(result.tables, budget)
    for motion in MOTIONS:
        table = result.tables.motions[motion]
        known = table.node_identifiable
        flags = np.ones(len(table.position)) if known is None else known
        k = wide[motion]['k']
        rows = zip(table.position, table.value, table.u, flags, wide[motion]['U'], strict=True)
        for position, value, u, seen, wide_u in rows:
            lines.append(
                f'{motion},{motion.axis},{tidy(position)!r},{float(value) + 0.0!r},{motion.unit},'
                f'{float(u)!r},{str(bool(seen)).lower()},{wide_u!r},{_factor(k)}'
            )
    for name in SQUARENESS:
        entry = result.tables.squareness[name]
        seen = name not in result.not_identifiable
        lines.append(
            f'{name},,,{entry.value + 0.0!r},rad,{entry.u!r},{str(seen).lower()},'
            f'{wide[name]["U"]!r},{_factor(wide[name]["k"])}'
        )
    return '\n'.join(lines) + '\n'


def _factor(k: float | None) -> str:
    """Coverage factor in a CSV cell; empty where nothing is uncertain."""
    return '' if k is None else repr(float(k))


def write_calibration(
    result: CalibrationResult,
    folder: str | Path,
    verb: str = 'calibrate',
    *,
    residuals_csv: bool = False,
) -> list[Path]:
    """Write all files of a calibration; error_tables.json last.

    Parameters
    ----------
    result : CalibrationResult
    folder : str or Path
        Made if missing; files of the same names are replaced.
    verb : str
        Command that the files come from.
    residuals_csv : bool
        Write the residuals as text too.

    Returns
    -------
    list of Path

    Raises
    ------
    ConfigError
        If the folder cannot be written.
    """
    folder = ensure_folder(folder)
    lines = budget_lines(result.tables, result.budget)
    write_text(folder / 'error_tables.csv', _tidy_rows(result, lines))
    write_text(folder / 'reversal.csv', reversal_csv(result.reversal, result.tables))
    residuals = write_residuals(result.runs, folder, text=residuals_csv)
    write_text(folder / 'summary.txt', format_result(result, lines) + '\n')
    data = result_to_dict(result, verb, lines)
    write_text(folder / TABLES_FILE, json.dumps(data, indent=1) + '\n')
    tables = [folder / name for name in (TABLES_FILE, 'error_tables.csv', 'reversal.csv')]
    return [*tables, *residuals, folder / 'summary.txt']


def format_result(result: CalibrationResult, budget: list[BudgetLine] | None = None) -> str:
    """Return the text for a terminal: warnings first, then fit, squareness, tables.

    Lines of the ``budget`` are worked out if not given.
    """
    fit, machine = result.fit, result.tables.machine
    budget = budget_lines(result.tables, result.budget) if budget is None else budget
    lines = [f'WARNING {text}' for text in result.warnings]
    lines += [f'FAILED {text}' for text in result.failed_gates]
    lines += [
        f'{machine.name}, chain {machine.chain}, run {result.run_id}',
        f'samples {fit.samples}, used {fit.used} in {fit.pieces} path pieces; '
        f'{fit.unknowns} unknowns, rank {fit.rank}; path driven {100 * fit.coverage:.1f} %',
        f'mean distance from the path {1e6 * fit.path_mae_before:.2f} um, compensated '
        f'{1e6 * fit.path_mae_after:.2f} um; residual rms {1e6 * fit.residual_rms:.2f} um',
        volumetric_line(result.tables),
        *(_run_line(number, run) for number, run in enumerate(result.runs, start=1)),
        *convention_lines(result),
        '',
        format_tables(result),
        '',
        *([format_effects(result.effects), ''] if result.effects else []),
        format_reversal(result.reversal),
        '',
        format_budget(result.tables, result.budget, budget),
    ]
    return '\n'.join(lines)


def _run_line(number: int, run: RunResult) -> str:
    place, offset = (
        ', '.join(f'{v:.3f}' for v in vector)
        for vector in (run.T_machine_tracker.translation, run.target_offset)
    )
    return (
        f'run {number}{f" ({run.name})" if run.name else ""}: {run.samples} samples, '
        f'{100 * run.coverage:.1f} % driven, tracker at ({place}) m, target offset ({offset}) m'
    )


def format_tables(result: CalibrationResult) -> str:
    """Return the error tables as text: span and standard uncertainty of every motion."""
    lines = ['squareness  value (urad)  u, k = 1 (urad)']
    for name in SQUARENESS:
        entry = result.tables.squareness[name]
        known = name not in result.not_identifiable
        lines.append(
            f'{name:<10}{1e6 * entry.value:>14.2f}{1e6 * entry.u:>17.2f}  '
            f'{squareness_words(name, entry.value)}'
            if known
            else f'{name:<10}  not identifiable in these data'
        )
    lines += ['', 'motion  unit  nodes       min       max    mean u, k = 1']
    for name in MOTIONS:
        table = result.tables.motions[name]
        unit = 'um' if unit_of(name) == 'm' else 'urad'
        row = f'{name:<8}{unit:<6}{len(table.position):>5}'
        if table.identifiable:
            row += f'{1e6 * table.value.min():>10.2f}{1e6 * table.value.max():>10.2f}'
            row += f'{1e6 * table.u.mean():>17.2f}'
        else:
            row += '   not identifiable in these data'
        lines.append(row)
    lines += ['', f'Gauge: {GAUGE}.', _spacing_in_words(result)]
    return '\n'.join(lines)


def _spacing_in_words(result: CalibrationResult) -> str:
    wish, taken = result.table_costs[1], result.table_costs[result.fraction]
    worst = max(wish.motions, key=lambda name: wish.motions[name])
    unit = 'um' if unit_of(worst) == 'm' else 'urad'
    costs = (
        f'straight lines between nodes cost {1e6 * wish.grid:.2f} um on the grid '
        f'(most in {worst}: {1e6 * wish.motions[worst]:.2f} {unit})'
    )
    if result.fraction == 1:
        return f'Nodes stand table_pitch apart; {costs}.'
    return (
        f'Nodes stand at 1/{result.fraction} of table_pitch, where straight lines cost '
        f'{1e6 * taken.grid:.2f} um on the grid; at table_pitch {costs}.'
    )
