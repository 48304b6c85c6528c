# SPDX-License-Identifier: Apache-2.0
"""What ``otf compare`` writes of machines with rotary axes: page, text, comparison.json."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.compare import COVERAGE_FACTOR, agreement
from otf_core.comparison.rotary_axes import RotaryComparison
from otf_core.files.writing import ensure_folder
from otf_core.model.motions import unit_of
from otf_core.model.provenance import provenance
from otf_core.reports.page import Heading, Section, Table, page_html, write_result

SCHEMA = 'otf-comparison/2'
HEAD = ('error', 'unit', 'largest |b - a|', 'at', 'mean u_a', 'mean u_b', 'largest E_n')
Row = tuple[str, str, str, str, str, str, str]


def _largest(normalised: Array) -> float | None:
    known = normalised[np.isfinite(normalised)]
    return float(known.max()) if known.size else None


def _rows(result: RotaryComparison) -> list[Row]:
    """A row per error: um and urad, places in mm and degrees."""
    rows = []
    for name, one in result.motions.items():
        worst = int(np.abs(one.difference).argmax())
        turning = result.machine.axes[name[-1]].rotary
        at = float(one.position[worst])
        place = f'{np.degrees(at):.2f} deg' if turning else f'{1e3 * at:.1f} mm'
        rows.append(_row(name, one.difference, place, one.u_a, one.u_b, one.normalised))
    for name, scalar in result.scalars.items():
        u_a, u_b = np.array([scalar.u_a]), np.array([scalar.u_b])
        difference = np.array([scalar.difference])
        rows.append(_row(name, difference, '', u_a, u_b, np.array([scalar.normalised])))
    return rows


def _row(name: str, difference: Array, place: str, u_a: Array, u_b: Array, e_n: Array) -> Row:
    largest = _largest(e_n)
    return (
        name,
        'um' if unit_of(name) == 'm' else 'urad',
        f'{1e6 * np.abs(difference).max():.2f}',
        place,
        f'{1e6 * u_a.mean():.2f}',
        f'{1e6 * u_b.mean():.2f}',
        '-' if largest is None else f'{largest:.2f}',
    )


def _volume_words(result: RotaryComparison) -> str:
    a, b, difference = (1e6 * v for v in result.volume)
    return (
        f'volume over all axes, {result.points} points, without rigid motion of the workpiece: '
        f'mean error a {a:.2f} um, b {b:.2f} um, b - a {difference:.2f} um'
    )


def _left_out(result: RotaryComparison) -> list[str]:
    """What is not compared, by reason."""
    reasons: dict[str, list[str]] = {}
    for name, reason in result.not_compared.items():
        reasons.setdefault(reason, []).append(name)
    every = len(result.machine.motions) + len(result.machine.scalars)
    lines = []
    for why, names in reasons.items():
        which = ', '.join(names)
        if len(names) > every // 2:
            which = f'single errors ({len(names)} of {every})'
        lines.append(f'not compared: {which}: {why}')
    return lines


def format_rotary_comparison(result: RotaryComparison) -> str:
    """Return the text for a terminal."""
    own = _rows(result)
    rows = [HEAD, *own] if own else []
    wide = [max(len(row[k]) for row in rows) for k in range(len(HEAD))] if rows else []
    lines = [f'a: {result.names[0]}', f'b: {result.names[1]}', '']
    lines += [
        '  '.join(
            cell.ljust(w) if k < 2 else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(row, wide, strict=True))
        )
        for row in rows
    ]
    return '\n'.join([*lines, *_left_out(result), '', _volume_words(result)])


def rotary_comparison_to_dict(result: RotaryComparison) -> dict[str, Any]:
    """Return a comparison as plain data, SI."""
    motions = {
        name: {
            'unit': unit_of(name),
            'position_unit': result.machine.axes[name[-1]].unit,
            'position': one.position.tolist(),
            'a': one.a.tolist(),
            'b': one.b.tolist(),
            'u_a': one.u_a.tolist(),
            'u_b': one.u_b.tolist(),
            'largest_difference': float(np.abs(one.difference).max()),
            'largest_normalised_error': _largest(one.normalised),
            'within': _finite(agreement(one.normalised)),
        }
        for name, one in result.motions.items()
    }
    scalars = {
        name: {
            'unit': unit_of(name),
            'a': one.a,
            'b': one.b,
            'u_a': one.u_a,
            'u_b': one.u_b,
            'normalised_error': _finite(one.normalised),
        }
        for name, one in result.scalars.items()
    }
    location = result.machine.location
    sizes = dict(zip(('mae_a', 'mae_b', 'mae_difference'), result.volume, strict=True))
    return {
        'schema': SCHEMA,
        'a': result.names[0],
        'b': result.names[1],
        'motions': motions,
        'squareness': {n: v for n, v in scalars.items() if n not in location},
        'location': {n: v for n, v in scalars.items() if n in location},
        'not_compared': dict(result.not_compared),
        'volume': {'points': result.points, **sizes, 'coverage_factor': COVERAGE_FACTOR},
    }


def _finite(value: float) -> float | None:
    return None if np.isnan(value) else value


def write_rotary_comparison(
    result: RotaryComparison, folder: str | Path, about: Mapping[str, Any] | None = None
) -> list[Path]:
    """Write report.html and comparison.json.

    Parameters
    ----------
    about : mapping, optional
        Block ``provenance`` of comparison.json.
    """
    data = rotary_comparison_to_dict(result) | {'provenance': about or provenance('compare')}
    numbers = (2, 4, 5, 6)
    page = page_html(
        Heading(f'{result.names[0]} and {result.names[1]}', f'{_volume_words(result)}.'),
        [
            Section('compared', '', tuple(_left_out(result))),
            Section('errors', 'Errors', tables=(Table(HEAD, tuple(_rows(result)), numbers),)),
        ],
    )
    return write_result(ensure_folder(Path(folder)), 'comparison', page, data)
