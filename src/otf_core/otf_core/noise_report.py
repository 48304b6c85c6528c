# SPDX-License-Identifier: Apache-2.0
"""Noise of a tracker as its standstills show it: level, colour, tails, peaks in the spectrum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import InputError
from otf_core.noise_colour import Variogram, variogram
from otf_core.noise_spectrum import Peak, Spectrum, find_peaks, spectrum
from otf_core.noise_tails import Tails, tails
from otf_core.observation import Samples
from otf_core.standstill import (
    MIN_DURATION,
    StandstillNoise,
    find_standstills,
    noise_of_windows,
    quiet_windows,
)

Array = NDArray[np.float64]

SCHEMA = 'otf-noise/1'
MIN_TOTAL = 1.0
"""s; with less standstill there is nothing to report."""
ENOUGH = 5.0
"""s; with less, level and colour are rough."""
JACKKNIFE = 10
"""Groups of windows, each left out once, that tell how well level and colour are known."""
REPEATED = 0.2
"""Share of successive samples without any change beyond which the recording is coarse."""
QUANTITIES = ('range', 'horizontal angle', 'vertical angle')


@dataclass(frozen=True)
class NoiseReport:
    """Noise of range, horizontal and vertical angle.

    Attributes
    ----------
    noise : StandstillNoise
    u_total, u_white : ndarray, shape (3,), m, rad, rad
        Standard uncertainties of the levels by leaving out part of the windows; nan for one
        window.
    u_correlation_time : float
        s.
    standstills : int
        Stops found.
    duration : float
        s, of standstill used.
    rate : float
        Hz.
    distance : float
        m, mean length of the beam in the standstills.
    tails : tuple of Tails
    peaks : tuple of Peak
    variogram : Variogram
    spectrum : Spectrum
    warnings : tuple of str
    """

    noise: StandstillNoise
    u_total: Array
    u_white: Array
    u_correlation_time: float
    standstills: int
    duration: float
    rate: float
    distance: float
    tails: tuple[Tails, ...]
    peaks: tuple[Peak, ...]
    variogram: Variogram
    spectrum: Spectrum
    warnings: tuple[str, ...]


def _jackknife(windows: list[Array], step: float) -> tuple[Array, Array, float]:
    """Standard uncertainties of total, white and correlation time."""
    groups = min(JACKKNIFE, len(windows))
    if groups < 2:
        return np.full(3, np.nan), np.full(3, np.nan), float('nan')
    rows = []
    for g in range(groups):
        kept = [w for k, w in enumerate(windows) if k % groups != g]
        noise = noise_of_windows(kept, step)
        rows.append(np.concatenate([noise.total, noise.white, [noise.correlation_time]]))
    u = np.std(rows, axis=0) * np.sqrt(groups - 1.0)
    return u[:3], u[3:6], float(u[6])


def _warnings(
    noise: StandstillNoise, windows: list[Array], duration: float
) -> tuple[str, ...]:
    found = []
    same = np.mean(np.concatenate([np.diff(w, axis=0) == 0 for w in windows]), axis=0)
    for name, share in zip(QUANTITIES, same, strict=True):
        if share > REPEATED:
            found.append(
                f'{name}: unchanged in {100 * share:.0f} % of successive samples: the recording '
                f'is rounded, its white part and tails are those of the rounding'
            )
    if duration < ENOUGH:
        found.append(
            f'only {duration:.1f} s of standstill: levels and colour are rough; {ENOUGH:g} s or '
            f'more in stops of a second or more tell them'
        )
    if noise.left_out > noise.standstills:
        found.append(
            f'in {noise.left_out} of {noise.left_out + noise.standstills} windows the target '
            f'itself seems to have moved; left out'
        )
    return tuple(found)


def noise_report(samples: Samples, standstill_speed: float) -> NoiseReport:
    """Judge the noise in the standstills of a recording.

    Parameters
    ----------
    samples : Samples
    standstill_speed : float
        m/s; slower counts as standstill.

    Raises
    ------
    InputError
        If there is hardly any standstill.
    """
    step = float(np.median(np.diff(samples.stamp_ns))) * 1e-9 if len(samples) > 1 else 0.0
    runs = find_standstills(samples, standstill_speed)
    windows, left_out = quiet_windows(samples, runs) if len(runs) else ([], 0)
    duration = sum(len(w) for w in windows) * step
    if duration < MIN_TOTAL:
        raise InputError(
            f'{duration:.1f} s of standstill in stops of {MIN_DURATION:g} s or more; at least '
            f'{MIN_TOTAL:g} s are needed: record while the target stands still for some seconds'
        )
    noise = noise_of_windows(windows, step, left_out)
    u_total, u_white, u_time = _jackknife(windows, step)
    seen = spectrum(windows, step)
    still = np.concatenate([np.arange(a, b) for a, b in runs])
    return NoiseReport(
        noise=noise,
        u_total=u_total,
        u_white=u_white,
        u_correlation_time=u_time,
        standstills=len(runs),
        duration=duration,
        rate=1.0 / step,
        distance=float(np.linalg.norm(samples.xyz[still], axis=1).mean()),
        tails=tails(windows, step),
        peaks=find_peaks(seen),
        variogram=variogram(windows),
        spectrum=seen,
        warnings=_warnings(noise, windows, duration),
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def noise_to_dict(report: NoiseReport) -> dict[str, Any]:
    """Return a report as plain data in the layout of noise.json."""
    noise = report.noise
    return {
        'schema': SCHEMA,
        'u_range': float(noise.total[0]),
        'u_angle': noise.total[1:].tolist(),
        'white_range': float(noise.white[0]),
        'white_angle': noise.white[1:].tolist(),
        'correlation_time': noise.correlation_time,
        'standstills': report.standstills,
        'samples': noise.samples,
        'uncertainty': {
            'u_range': _number(report.u_total[0]),
            'u_angle': [_number(v) for v in report.u_total[1:]],
            'white_range': _number(report.u_white[0]),
            'white_angle': [_number(v) for v in report.u_white[1:]],
            'correlation_time': _number(report.u_correlation_time),
        },
        'windows': noise.standstills,
        'windows_left_out': noise.left_out,
        'duration': report.duration,
        'rate': report.rate,
        'distance': report.distance,
        'tails': {
            name: {
                'excess_kurtosis': tail.excess_kurtosis,
                'student_freedom': tail.freedom,
                'beyond_4_sigma': tail.beyond,
            }
            for name, tail in zip(QUANTITIES, report.tails, strict=True)
        },
        'peaks': [
            {'of': QUANTITIES[p.quantity], 'frequency': p.frequency, 'rms': p.rms}
            for p in report.peaks
        ],
        'warnings': list(report.warnings),
    }


def _level_rows(report: NoiseReport) -> list[str]:
    rows = []
    for k, name in enumerate(QUANTITIES):
        tail, unit = report.tails[k], 'um' if k == 0 else 'urad'
        freedom = 'normal' if tail.freedom is None else f't({tail.freedom:.0f})'
        rows.append(
            f'{name:<18}{unit:<5}{1e6 * report.noise.total[k]:>8.3f}'
            f'{1e6 * report.u_total[k]:>8.3f}{1e6 * report.noise.white[k]:>9.3f}'
            f'{1e6 * report.u_white[k]:>8.3f}{tail.excess_kurtosis:>11.2f}  {freedom}'
        )
    return rows


def format_noise(report: NoiseReport) -> str:
    """Return the text for a terminal: warnings first."""
    noise = report.noise
    colour = (
        f'correlation time of the slow part {noise.correlation_time:.2f} s '
        f'(+/- {report.u_correlation_time:.2f})'
        if noise.correlation_time
        else 'the noise is white'
    )
    lines = [f'WARNING {text}' for text in report.warnings]
    lines += [
        f'{report.standstills} standstills; used {report.duration:.1f} s, {noise.samples} samples '
        f'at {report.rate:.0f} Hz in {noise.standstills} windows, {noise.left_out} louder ones '
        f'left out; beam {report.distance:.2f} m',
        '',
        'noise (k = 1)     unit    total     +/-    white     +/-   kurtosis  tails',
        *_level_rows(report),
        '',
        colour,
    ]
    lines += [
        f'peak of the {QUANTITIES[p.quantity]} at {p.frequency:.1f} Hz: {1e6 * p.rms:.3f} '
        f'{"um" if p.quantity == 0 else "urad"} rms'
        for p in report.peaks
    ] or ['no peaks in the spectrum']
    return '\n'.join(lines)
