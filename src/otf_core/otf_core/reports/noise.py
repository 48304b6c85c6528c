# SPDX-License-Identifier: Apache-2.0
"""A noise report as data, as text and as files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.provenance import provenance
from otf_core.noise.fields import noise_to_fields
from otf_core.noise.model import QUANTITIES
from otf_core.noise.report import NoiseReport
from otf_core.reports.noise_page import noise_html
from otf_core.reports.plots.noise import draw_noise

Array = NDArray[np.float64]

SCHEMA = 'otf-noise/1'


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def noise_to_dict(report: NoiseReport) -> dict[str, Any]:
    """Return a report as plain data in the layout of noise.json."""
    measured = report.measured
    fields = noise_to_fields(measured.noise)
    of_tails = fields.pop('tails')
    for tail, entry in zip(measured.tails, of_tails.values(), strict=True):
        entry |= {'excess_kurtosis': tail.excess_kurtosis, 'beyond_4_sigma': tail.beyond}
    return {
        'schema': SCHEMA,
        **fields,
        'standstills': report.standstills,
        'samples': measured.samples,
        'uncertainty': {
            'u_range': _number(report.u_total[0]),
            'u_angle': [_number(v) for v in report.u_total[1:]],
            'white_range': _number(report.u_white[0]),
            'white_angle': [_number(v) for v in report.u_white[1:]],
            'correlation_time': _number(report.u_correlation_time),
        },
        'windows': measured.windows,
        'windows_left_out': measured.left_out,
        'duration': report.duration,
        'rate': report.rate,
        'distance': report.distance,
        'tails': of_tails,
        'peaks': [
            {'of': QUANTITIES[p.quantity], 'frequency': p.frequency, 'rms': p.rms}
            for p in report.peaks
        ],
        'lost': {
            'samples': report.lost.samples,
            'gaps': report.lost.gaps,
            'longest': report.lost.longest,
        },
        'steps': [{'time': s.time, 'size': s.size.tolist()} for s in report.steps],
        'drift': None
        if report.drift is None
        else {'duration': report.drift.duration, 'change': report.drift.change.tolist()},
        'warnings': list(report.warnings),
    }


def _level_rows(report: NoiseReport) -> list[str]:
    rows, noise = [], report.measured.noise
    for k, name in enumerate(QUANTITIES):
        tail, unit = report.measured.tails[k], 'um' if k == 0 else 'urad'
        freedom = 'normal' if tail.freedom is None else f't({tail.freedom:.0f})'
        rows.append(
            f'{name:<18}{unit:<5}{1e6 * noise.level[k]:>8.3f}'
            f'{1e6 * report.u_total[k]:>8.3f}{1e6 * noise.white[k]:>9.3f}'
            f'{1e6 * report.u_white[k]:>8.3f}{tail.excess_kurtosis:>11.2f}  {freedom}'
        )
    return rows


def _event_rows(report: NoiseReport) -> list[str]:
    def sized(values: Array) -> str:
        return f'{values[0]:+.2f} um, {values[1]:+.2f} urad, {values[2]:+.2f} urad'

    lost = report.lost
    rows = ['no samples lost']
    if lost.samples:
        rows = [f'{lost.samples} samples lost in {lost.gaps} gaps, longest {lost.longest:.2f} s']
    if report.steps:
        largest = max(report.steps, key=lambda s: float(np.max(np.abs(s.size))))
        rows.append(
            f'{len(report.steps)} steps within standstills, the largest at {largest.time:.1f} s: '
            f'{sized(1e6 * largest.size)}'
        )
    if report.drift is not None:
        rows.append(f'drift in {report.drift.duration:.1f} s: {sized(1e6 * report.drift.change)}')
    return rows


def _colour_words(report: NoiseReport) -> str:
    time = report.measured.noise.range.correlation_time
    if not time:
        return 'the noise is white'
    return f'correlation time of the slow part {time:.2f} s (+/- {report.u_correlation_time:.2f})'


def _peak_rows(report: NoiseReport) -> list[str]:
    return [
        f'peak of the {QUANTITIES[p.quantity]} at {p.frequency:.1f} Hz: {1e6 * p.rms:.3f} '
        f'{"um" if p.quantity == 0 else "urad"} rms'
        for p in report.peaks
    ] or ['no peaks in the spectrum']


def format_noise(report: NoiseReport) -> str:
    """Return the text for a terminal: warnings first."""
    measured = report.measured
    lines = [f'WARNING {text}' for text in report.warnings]
    lines += [
        f'{report.standstills} standstills; used {report.duration:.1f} s, '
        f'{measured.samples} samples at {report.rate:.0f} Hz in {measured.windows} windows, '
        f'{measured.left_out} louder ones left out; beam {report.distance:.2f} m',
        '',
        'noise (k = 1)     unit    total     +/-    white     +/-   kurtosis  tails',
        *_level_rows(report),
        '',
        _colour_words(report),
    ]
    lines += _event_rows(report)
    lines += _peak_rows(report)
    return '\n'.join(lines)


def write_noise(
    report: NoiseReport, folder: str | Path, about: Mapping[str, Any] | None = None
) -> list[Path]:
    """Write noise.svg, report.html, noise.txt and, last, noise.json.

    Parameters
    ----------
    report : NoiseReport
    folder : str or Path
    about : mapping, optional
        Block ``provenance`` of the JSON file; what is known without it if not given.

    Returns
    -------
    list of Path
    """
    folder = ensure_folder(folder)
    data = noise_to_dict(report) | {'provenance': about or provenance('noise')}
    names = ('report.html', 'noise.txt', 'noise.json')
    files = [draw_noise(report, folder), *(folder / name for name in names)]
    runs = data['provenance'].get('runs') or [{}]
    name = str(runs[0].get('name') or '')
    date = str(data['provenance']['written'])
    events = [*_event_rows(report), *_peak_rows(report)]
    write_text(files[1], noise_html(report, name, date, events, _colour_words(report)))
    write_text(files[2], format_noise(report) + '\n')
    content = json.dumps(data, indent=1, allow_nan=False)
    write_text(files[3], content + '\n')
    return files
