# SPDX-License-Identifier: Apache-2.0
"""A comparison as data, as text and as files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.comparison.compare import COVERAGE_FACTOR, Comparison, agreement
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.evaluation import mean_length
from otf_core.model.frames import XYZ
from otf_core.model.motions import unit_of
from otf_core.model.provenance import provenance
from otf_core.reports.comparison_page import comparison_html
from otf_core.reports.plots.comparison import draw_motions, draw_volume
from otf_core.reports.quantities import place

Array = NDArray[np.float64]

SCHEMA = 'otf-comparison/1'
CONVENTION = (
    'positioning and rotations zero at axis position 0, else at the common minimum; straightness '
    'zero at both ends of the common range; squareness holds what this takes out of them'
)


def _judged(normalised: Array) -> tuple[str, str]:
    """Largest E_n, and the share up to 1 in percent; dashes where no uncertainty is known."""
    known = normalised[np.isfinite(normalised)]
    if not known.size:
        return '-', '-'
    return f'{known.max():.2f}', f'{100 * agreement(known):.0f} %'


def _number(value: float) -> float | None:
    return None if np.isnan(value) else value


def comparison_to_dict(result: Comparison) -> dict[str, Any]:
    """Return a comparison as plain data."""
    volume = result.volume
    motions = {}
    for name, motion in result.motions.items():
        motions[name] = {
            'unit': unit_of(name),
            'position': motion.position.tolist(),
            'a': motion.a.tolist(),
            'b': motion.b.tolist(),
            'u_a': motion.u_a.tolist(),
            'u_b': motion.u_b.tolist(),
            'normalised_error': [_number(float(v)) for v in motion.normalised],
            'largest_difference': float(np.abs(motion.difference).max()),
            'within': _number(agreement(motion.normalised)),
        }
    difference = volume.difference
    squareness = {
        name: {'unit': 'rad', 'a': one.a, 'b': one.b, 'u_a': one.u_a, 'u_b': one.u_b,
               'normalised_error': _number(one.normalised)}
        for name, one in result.squareness.items()
    }  # fmt: skip
    data: dict[str, Any] = {
        'schema': SCHEMA,
        'a': result.names[0],
        'b': result.names[1],
        'convention': CONVENTION,
        'counted_as_translations': list(result.common.folded),
        'without_uncertainty': list(result.without_u),
        'translations_apart_by': list(result.common.apart),
        'target_offsets': [offset.tolist() for offset in result.offsets],
        'motions': motions,
        'squareness': squareness,
        'volume': {
            'points': len(volume.q),
            'mae_a': mean_length(volume.a),
            'mae_b': mean_length(volume.b),
            'mae_difference': mean_length(difference),
            'mean_absolute': dict(zip(XYZ, np.abs(difference).mean(axis=0).tolist(), strict=True)),
            'standard_deviation': dict(zip(XYZ, difference.std(axis=0).tolist(), strict=True)),
            'within': _number(agreement(volume.normalised)),
            'coverage_factor': COVERAGE_FACTOR,
        },
    }
    if volume.squareness is not None:
        keys = ('mae_a', 'mae_b', 'mae_difference')
        data['volume_with_squareness'] = dict(zip(keys, volume.squareness, strict=True))
    return data


def format_comparison(result: Comparison) -> str:
    """Return the text for a terminal."""
    a, b = result.names
    lines = [
        f'a: {a}',
        f'b: {b}',
        f'{CONVENTION}.',
        '',
        'motion  unit   largest |b - a|   rms b - a   mean u_a   mean u_b   largest E_n  E_n <= 1',
    ]
    for name, motion in result.motions.items():
        rms = float(np.sqrt(np.mean(motion.difference**2)))
        worst, share = _judged(motion.normalised)
        lines.append(
            f'{name:<8}{"um" if unit_of(name) == "m" else "urad":<5}'
            f'{1e6 * np.abs(motion.difference).max():>17.2f}{1e6 * rms:>12.2f}'
            f'{1e6 * motion.u_a.mean():>11.2f}{1e6 * motion.u_b.mean():>11.2f}'
            f'{worst:>14}{share:>11}'
        )
    for name, one in result.squareness.items():
        worst, share = _judged(np.array([one.normalised]))
        lines.append(
            f'{name:<8}{"urad":<5}{1e6 * abs(one.difference):>17.2f}'
            f'{1e6 * abs(one.difference):>12.2f}{1e6 * one.u_a:>11.2f}{1e6 * one.u_b:>11.2f}'
            f'{worst:>14}{share:>11}'
        )
    lines += remarks_on(result)
    volume = result.volume
    within = _judged(volume.normalised)[1]
    lines += [
        '',
        f'volume, {len(volume.q)} points: mean error a {1e6 * mean_length(volume.a):.2f} um, '
        f'b {1e6 * mean_length(volume.b):.2f} um, '
        f'b - a {1e6 * mean_length(volume.difference):.2f} um; '
        f'E_n <= 1 for {within} of the components'
        + (', since no side states an uncertainty' if within == '-' else ''),
    ]
    if volume.squareness is not None:
        lines.append(
            'with squareness, without rigid motion: a {:.2f} um, b {:.2f} um, '
            'b - a {:.2f} um'.format(*(1e6 * v for v in volume.squareness))
        )
    return '\n'.join(lines)


def remarks_on(result: Comparison) -> list[str]:
    """What has to be known beside the numbers."""
    lines, common = [], result.common
    if common.folded:
        lines.append(
            f'{", ".join(common.folded)}: one side cannot tell them from translations; '
            f'counted as such'
        )
    if len(result.without_u) == 1:
        lines.append(f'{result.without_u[0]} states no uncertainty: E_n takes it as exact')
    if common.apart:
        axes = ', '.join(dict.fromkeys(m.axis for m in common.apart))
        lines.append(
            f'WARNING {", ".join(common.apart)}: neither side tells them from '
            f'translations, and they measured at different target offsets or places: the '
            f'translations of {axes}, and squareness, differ by these rotations times the '
            f'difference of the levers, whatever the machine does'
        )
    if not result.squareness:
        lines.append('squareness is not compared: not known to both')
    own, other = result.offsets
    if result.volume.squareness is not None and not np.array_equal(own, other):
        lines.append(f'both at the target offset of a, {place(own)}; that of b is {place(other)}')
    return lines


def write_comparison(
    result: Comparison, folder: str | Path, about: Mapping[str, Any] | None = None
) -> list[Path]:
    """Write motions.svg, volume.svg, report.html, comparison.txt and, last, comparison.json.

    Parameters
    ----------
    result : Comparison
    folder : str or Path
    about : mapping, optional
        Block ``provenance`` of the JSON file; what is known without it if not given.

    Returns
    -------
    list of Path
    """
    folder = ensure_folder(folder)
    data = comparison_to_dict(result) | {'provenance': about or provenance('compare')}
    files = [draw_motions(result, folder), draw_volume(result, folder)]
    date = str(data['provenance']['written'])
    files += [folder / name for name in ('report.html', 'comparison.txt', 'comparison.json')]
    write_text(files[2], comparison_html(result, CONVENTION, remarks_on(result), date))
    write_text(files[3], format_comparison(result) + '\n')
    content = json.dumps(data, indent=1, allow_nan=False)
    write_text(files[4], content + '\n')
    return files
