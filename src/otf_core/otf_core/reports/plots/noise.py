# SPDX-License-Identifier: Apache-2.0
"""Figure of a noise report: variogram with the fitted colour, spectrum with its peaks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from otf_core.noise.model import QUANTITIES
from otf_core.noise.report import NoiseReport
from otf_core.reports.drawing.panel import Panel
from otf_core.reports.drawing.scale import decades
from otf_core.reports.drawing.sheet import write_sheet

CAPTION = (
    'Above: root of the variogram, the scatter of the difference of two samples over root 2, '
    'against the time between them; dots as seen, line as fitted, band U (k = 2) of the fitted '
    'level. Below: amplitude spectrum; strokes mark peaks.'
)


def _unit(quantity: int) -> str:
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
        decades(np.concatenate([value, low, high]), f'scatter ({_unit(quantity)})'),
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
        decades(density, f'{_unit(quantity)} per root Hz'),
    )
    marks = [panel.line(frequency, density, 'after thin')]
    for peak in report.peaks:
        if peak.quantity == quantity:
            ends = np.array([peak.frequency]), [panel.y.low], [panel.y.high]
            marks.append(panel.ranges(*ends, 'before thin'))
    return panel.draw(marks, f'spectrum of the {QUANTITIES[quantity]}')


def draw_noise(report: NoiseReport, folder: str | Path) -> Path:
    """Write noise.svg: one column a quantity, dots as seen, lines as fitted, peaks marked."""
    pictures = [draw(report, k) for draw in (draw_variogram, draw_spectrum) for k in range(3)]
    title = (
        f'Tracker noise at rest: {report.standstills} standstills, {report.duration:.1f} s at '
        f'{report.rate:.0f} Hz, beam {report.distance:.2f} m'
    )
    key = (('after', 'seen'), ('before', 'fitted, peaks'))
    return write_sheet(folder, 'noise', pictures, 3, title, CAPTION, key)
