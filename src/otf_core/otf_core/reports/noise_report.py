# SPDX-License-Identifier: Apache-2.0
"""What ``otf noise`` writes and says: page, noise.json, text for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.files.writing import ensure_folder
from otf_core.model.expanded import COVERAGE_FACTOR, micro_with_expanded
from otf_core.model.provenance import provenance
from otf_core.noise.noise_model import QUANTITIES, noise_to_fields
from otf_core.noise.report import NoiseReport
from otf_core.reports.charts import Panel, decades
from otf_core.reports.page import Heading, Picture, Section, State, Table, page_html, write_result

NOISE_CAPTION = (
    'Above: root of the variogram, the scatter of the difference of two samples over root 2, '
    'against the time between them; dots: measured, line: fitted, band: U (k = 2) of the fitted '
    'level. Below: amplitude spectrum; marks: peaks.'
)
QUANTITY_UNITS = ('m', 'rad', 'rad')
"""Of range, horizontal and vertical angle."""
SCHEMA = 'otf-noise/1'


def _millionths(quantity: int) -> str:
    return 'µm' if quantity == 0 else 'µrad'


def draw_variogram(report: NoiseReport, quantity: int) -> str:
    """Scatter against the time between samples, as seen and as fitted."""
    seen, noise = report.variogram, tuple(report.measured.noise)[quantity]
    lag = seen.lag / report.rate
    value = 1e6 * np.sqrt(seen.value[quantity])
    time = np.geomspace(lag[0], lag[-1], 100)
    rise = 1.0 - np.exp(-time / noise.correlation_time) if noise.correlation_time else 0.0 * time
    model = 1e6 * np.sqrt(noise.white**2 + noise.slow**2 * rise)
    u = report.u_total[quantity] / noise.level if noise.level > 0 else 0.0
    wide = 2.0 * float(u) if np.isfinite(u) else 0.0
    low, high = model * max(1.0 - wide, 0.1), model * (1.0 + wide)
    panel = Panel(
        decades(lag, 'time between samples (s)'),
        decades(np.concatenate([value, low, high]), f'scatter ({_millionths(quantity)})'),
    )
    marks = [panel.band(time, low, high, 'before band'), panel.line(time, model, 'before'),
             panel.dots(lag, value, 'after node')]  # fmt: skip
    return panel.draw(marks, f'variogram of the {QUANTITIES[quantity]}', QUANTITIES[quantity])


def draw_spectrum(report: NoiseReport, quantity: int) -> str:
    """Amplitude spectrum with its peaks."""
    frequency = report.spectrum.frequency[1:]
    density = 1e6 * np.sqrt(report.spectrum.density[quantity][1:])
    panel = Panel(
        decades(frequency, 'frequency (Hz)'),
        decades(density, f'{_millionths(quantity)} per root Hz'),
    )
    marks = [panel.line(frequency, density, 'after thin')]
    for peak in report.peaks:
        if peak.quantity == quantity:
            ends = np.array([peak.frequency]), [panel.y.low], [panel.y.high]
            marks.append(panel.ranges(*ends, 'before thin'))
    return panel.draw(marks, f'spectrum of the {QUANTITIES[quantity]}')


def noise_html(
    report: NoiseReport, name: str, date: str, events: Sequence[str], colour: str
) -> str:
    """Return the page.

    Parameters
    ----------
    name : str
        Of the recording.
    date : str
        When this was written.
    events : sequence of str
        Lost samples, steps, drift and peaks in words.
    colour : str
        How the noise is correlated.
    """
    measured = report.measured
    levels = [_level_words(report.measured.noise.level[k], report.u_total[k], k) for k in range(3)]
    tiles = tuple(
        (what[:1].upper() + what[1:], value, 'standard deviation of a single sample, ± U (k = 2)')
        for what, value in zip(QUANTITIES, levels, strict=True)
    )
    warned = len(report.warnings)
    badge = (
        State(f'{warned} warning{"s" if warned > 1 else ""}', 'open')
        if warned
        else State('no warnings', 'good')
    )
    heading = Heading(
        f'Noise of the tracker at rest{f", {name}" if name else ""}',
        f'A single sample scatters by {levels[0]} along the beam, {levels[1]} and {levels[2]} in '
        f'the angles; {colour}.',
        (badge,),
        tiles,
        f'noise of the tracker, run {name}, {date}' if name else f'noise of the tracker, {date}',
    )
    facts = (
        ('standstills', f'{report.standstills}, of which {report.duration:.1f} s are used'),
        ('samples', f'{measured.samples} at {report.rate:.0f} Hz in {measured.windows} windows, '
         f'{measured.left_out} noisier ones left out'),
        ('beam', f'{report.distance:.2f} m long on average'),
    )  # fmt: skip
    sentences = tuple(f'{event[:1].upper()}{event[1:]}.' for event in events)
    words = tuple(f'Warning: {text}.' for text in report.warnings)
    sections = [
        Section('overview', '', words, draw=lambda: _noise_pictures(report)),
        Section('levels', 'Levels', tables=(_level_table(report),)),
        Section('standstills', 'Standstills', sentences, tables=(Table(('', ''), facts),)),
    ]
    return page_html(heading, sections)


def _level_words(level: float, u: float, quantity: int) -> str:
    wide = COVERAGE_FACTOR * float(u)
    return micro_with_expanded(
        float(level), wide if np.isfinite(wide) else 0.0, QUANTITY_UNITS[quantity]
    )


def _noise_pictures(report: NoiseReport) -> Sequence[Picture]:
    panels = [draw(report, k) for draw in (draw_variogram, draw_spectrum) for k in range(3)]
    return [Picture(tuple(panels), NOISE_CAPTION, columns=3)]


def _level_table(report: NoiseReport) -> Table:
    rows, noise = [], report.measured.noise
    for k, name in enumerate(QUANTITIES):
        tail = report.measured.tails[k]
        kind = 'normal' if tail.freedom is None else f"Student's t, {tail.freedom:.0f} dof"
        rows.append((
            name, _level_words(noise.level[k], report.u_total[k], k),
            _level_words(noise.white[k], report.u_white[k], k),
            f'{tail.excess_kurtosis:.2f}', kind,
        ))  # fmt: skip
    head = ('Noise', 'Total (k = 1) ± U', 'White part (k = 1) ± U', 'Excess kurtosis', 'Tails')
    return Table(head, tuple(rows), numbers=(3,), stacked=True)


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
        f'{measured.left_out} noisier ones left out; beam {report.distance:.2f} m',
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
    """Write report.html and noise.json, with ``about`` as its provenance."""
    folder = ensure_folder(folder)
    data = noise_to_dict(report) | {'provenance': about or provenance('noise')}
    runs = data['provenance'].get('runs') or [{}]
    name = str(runs[0].get('name') or '')
    date = str(data['provenance']['written'])
    events = [*_event_rows(report), *_peak_rows(report)]
    page = noise_html(report, name, date, events, _colour_words(report))
    return write_result(folder, 'noise', page, data)
