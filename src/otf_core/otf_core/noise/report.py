# SPDX-License-Identifier: Apache-2.0
"""Noise of a tracker as its standstills show it: level, colour, tails, peaks in the spectrum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.noise.colour import (
    Peak,
    Spectrum,
    Variogram,
    expected_density,
    find_peaks,
    jackknife_u,
    left_out_fits,
    longest_time,
    spectrum,
    variogram,
)
from otf_core.noise.standstill import (
    MAX_REPEATED_DIFFERENCE,
    MIN_DURATION,
    Drift,
    LostSamples,
    MeasuredNoise,
    Step,
    find_drift,
    find_standstills,
    find_steps,
    lost_samples,
    noise_of_windows,
    quiet_windows,
    trim_to_rest,
)

MIN_TOTAL = 1.0
"""s; with less standstill there is nothing to report."""
MIN_TOTAL_FOR_COLOUR = 5.0
"""s; with less, level and colour are rough."""
MAX_REPEATED_SHARE = 0.2
"""Share of successive samples without any change beyond which the recording is coarse."""
MAX_LOST_SHARE = 0.01
"""Share of lost samples that is warned of."""
MAX_LEVEL = 20e-6
"""m and rad; no laser tracker at work is louder, so the target itself moves."""
LONG_TIME_SHARE = 0.95
"""Share of the longest correlation time searched for, from which on it may be longer."""
NEAREST = 0.02
"""m; no reflector comes nearer to the centre of a tracker."""
MIN_INTERVAL = 1e-4
"""s; no laser tracker measures at shorter intervals, so the stamps are of something else."""


@dataclass(frozen=True)
class NoiseReport:
    """Noise of range, horizontal and vertical angle.

    Attributes
    ----------
    u_total, u_white : ndarray, shape (3,), m, rad, rad
        Standard uncertainties of the levels by leaving out part of the windows; nan if there is
        too little to leave out.
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
    lost : LostSamples
        Of the whole recording.
    drift : Drift or None
        None without a long standstill.
    """

    measured: MeasuredNoise
    u_total: Array
    u_white: Array
    u_correlation_time: float
    standstills: int
    duration: float
    rate: float
    distance: float
    peaks: tuple[Peak, ...]
    lost: LostSamples
    steps: tuple[Step, ...]
    drift: Drift | None
    variogram: Variogram
    spectrum: Spectrum
    warnings: tuple[str, ...]


def _known_to(windows: list[Array], step: float) -> tuple[Array, Array, float]:
    """Standard uncertainties of total, white and correlation time."""
    fits = left_out_fits(windows, step)
    rows = [np.array([*f.level, *f.white, f.range.correlation_time]) for f in fits]
    u = jackknife_u(np.reshape(rows, (-1, 7)))
    return u[:3], u[3:6], float(u[6])


def _coarse(windows: list[Array]) -> str | None:
    """State whether samples repeat, and whether by rounding or because a point is held."""
    new = [np.concatenate([[True], np.diff(w, axis=0).any(axis=1)]) for w in windows]
    count = sum(len(w) for w in windows)
    share = 1.0 - sum(int(n.sum()) for n in new) / count
    if share <= MAX_REPEATED_SHARE:
        return None
    # a rounded value comes back after others have been seen, a held one does not
    visits = sum(int(n.sum()) for n in new)
    distinct = sum(len(np.unique(w, axis=0)) for w in windows)
    if distinct > 0.9 * visits:
        return (
            f'{100 * share:.0f} % of samples repeat the one before: points are held, the tracker '
            f'measures {count / visits:.1f} times slower than the stamps say; the white part is '
            f'larger than stated'
        )
    return (
        f'{100 * share:.0f} % of successive samples are identical: the recording is rounded; '
        f'white part and tails are those of the rounding'
    )


def _warnings(
    measured: MeasuredNoise, windows: list[Array], duration: float, lost: LostSamples, count: int
) -> tuple[str, ...]:
    coarse = _coarse(windows)
    warnings = [coarse] if coarse else []
    if lost.samples > MAX_LOST_SHARE * count:
        warnings.append(
            f'{lost.samples} samples lost in {lost.gaps} gaps '
            f'({100 * lost.samples / (lost.samples + count):.0f} %), the longest '
            f'{lost.longest:.2f} s: check tracker, driver and network'
        )
    if duration < MIN_TOTAL_FOR_COLOUR:
        warnings.append(
            f'only {duration:.1f} s of standstill: levels and colour are rough; '
            f'{MIN_TOTAL_FOR_COLOUR:g} s or more in stops of a second or more are needed'
        )
    if measured.left_out > measured.windows:
        warnings.append(
            f'in {measured.left_out} of {measured.left_out + measured.windows} windows the target '
            f'itself seems to have moved; left out'
        )
    time = measured.noise.range.correlation_time
    if time > LONG_TIME_SHARE * longest_time(windows, duration / measured.samples):
        warnings.append(
            f'the slow part is slower than the standstills can show: its correlation time is '
            f'{time:.1f} s or more, and its level a lower bound'
        )
    if measured.noise.level.max() > MAX_LEVEL:
        warnings.append(
            'noisier than laser trackers are: the target itself seems to move; fasten it and '
            'record again'
        )
    return tuple(warnings)


def noise_report(samples: Samples, standstill_speed: float, parts: int = 1) -> NoiseReport:
    """Judge the noise in the standstills of a recording.

    Parameters
    ----------
    standstill_speed : float
        m/s; slower counts as standstill.
    parts : int
        Of the run; the beam is broken between them.

    Raises
    ------
    InputError
        If there is hardly any standstill, or the stamps are not those of measurements.
    """
    step = samples.step
    if 0.0 < step < MIN_INTERVAL:
        raise InputError(
            f'stamps are {1e6 * step:.0f} us apart, faster than trackers measure: they seem to '
            f'be times of arrival in bursts; the driver has to stamp the time of measurement'
        )
    if np.median(np.linalg.norm(samples.xyz, axis=1)) < NEAREST:
        raise InputError(
            f'the points lie within {1e3 * NEAREST:g} mm of the origin, which has to be the beam '
            f'origin of the tracker: export coordinates in its frame, not relative to a nest'
        )
    runs = find_standstills(samples, standstill_speed)
    windows, left_out = quiet_windows(samples, runs) if len(runs) else ([], 0)
    duration = sum(len(w) for w in windows) * step
    if duration < MIN_TOTAL:
        if len(runs) and all(
            np.ptp(samples.xyz[a:b], axis=0).max() <= MAX_REPEATED_DIFFERENCE for a, b in runs
        ):
            raise InputError(
                'the points of the standstills repeat without any noise: they are held or '
                'rounded; record what the tracker measures, unfiltered and with all digits'
            )
        raise InputError(
            f'{duration:.1f} s of standstill in stops of {MIN_DURATION:g} s or more; at least '
            f'{MIN_TOTAL:g} s are needed: record while the target stands still for some seconds'
        )
    measured = noise_of_windows(windows, step, left_out)
    u_total, u_white, u_time = _known_to(windows, step)
    seen = spectrum(windows, step)
    shape = expected_density(seen.frequency, measured.noise)
    still = np.concatenate([np.arange(a, b) for a, b in runs])
    lost = lost_samples(samples, parts)
    return NoiseReport(
        measured=measured,
        u_total=u_total,
        u_white=u_white,
        u_correlation_time=u_time,
        standstills=len(runs),
        duration=duration,
        rate=1.0 / step,
        distance=float(np.linalg.norm(samples.xyz[still], axis=1).mean()),
        peaks=find_peaks(seen, shape),
        lost=lost,
        steps=find_steps(samples, runs),
        drift=find_drift(samples, trim_to_rest(samples, runs)),
        variogram=variogram(windows),
        spectrum=seen,
        warnings=_warnings(measured, windows, duration, lost, len(samples)),
    )
