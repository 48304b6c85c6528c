# SPDX-License-Identifier: Apache-2.0
"""Figure of a noise report: variogram with the fitted colour, spectrum with its peaks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from otf_core.noise.model import QUANTITIES
from otf_core.noise.report import NoiseReport
from otf_core.reports.plots.figure import COLOURS, new_figure, save_figure


def _draw_variogram(axes: Any, report: NoiseReport, quantity: int) -> None:
    seen, noise = report.variogram, tuple(report.measured.noise)[quantity]
    lag = seen.lag / report.rate
    axes.loglog(lag, 1e6 * np.sqrt(seen.value[quantity]), 'o', ms=3, color=COLOURS[0])
    time = np.geomspace(lag[0], lag[-1], 200)
    rise = 1.0 - np.exp(-time / noise.correlation_time) if noise.correlation_time else 0.0 * time
    model = np.sqrt(noise.white**2 + noise.slow**2 * rise)
    axes.loglog(time, 1e6 * model, '-', color=COLOURS[1])
    axes.set_title(QUANTITIES[quantity])
    axes.set_xlabel('time between samples (s)')
    axes.set_ylabel(f'root of the variogram ({"um" if quantity == 0 else "urad"})')


def _draw_spectrum(axes: Any, report: NoiseReport, quantity: int) -> None:
    seen = report.spectrum
    density = 1e6 * np.sqrt(seen.density[quantity])
    axes.loglog(seen.frequency[1:], density[1:], '-', lw=0.8, color=COLOURS[0])
    for peak in report.peaks:
        if peak.quantity == quantity:
            axes.axvline(peak.frequency, color=COLOURS[1], lw=0.6)
    axes.set_xlabel('frequency (Hz)')
    axes.set_ylabel(f'{"um" if quantity == 0 else "urad"} per root Hz')


def draw_noise(report: NoiseReport, folder: str | Path) -> Path:
    """Write noise.svg: one column a quantity, dots as seen, lines as fitted, peaks marked."""
    figure = new_figure(11, 6)
    axes = figure.subplots(2, 3)
    for quantity in range(3):
        _draw_variogram(axes[0, quantity], report, quantity)
        _draw_spectrum(axes[1, quantity], report, quantity)
    return save_figure(figure, folder, 'noise')
