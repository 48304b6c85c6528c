# SPDX-License-Identifier: Apache-2.0
"""Noise of a tracker as its standstills show it: level, colour, tails, peaks in the spectrum."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.documents import Document, ResultDocument, stated
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.model.provenance import Origin, provenance
from otf_core.noise.colour import (
    Peak,
    expected_density,
    find_peaks,
    jackknife_u,
    left_out_fits,
    longest_time,
    spectrum,
    variogram,
)
from otf_core.noise.noise_model import QUANTITIES, NoiseModel, noise_to_fields
from otf_core.noise.standstill import (
    MAX_REPEATED_DIFFERENCE,
    MIN_DURATION,
    Drift,
    LostSamples,
    MeasuredNoise,
    Step,
    Tails,
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
class NoiseUncertainty(Document):
    """Standard uncertainties by leaving out part of the windows; null: too little to leave out."""

    u_range: float = stated('of the total level along the beam', 'm', unknown=True)
    u_angle: Array = stated('of both angles', 'rad', shape=(2,), unknown=True)
    white_range: float = stated('of the white part along the beam', 'm', unknown=True)
    white_angle: Array = stated('of both angles', 'rad', shape=(2,), unknown=True)
    correlation_time: float = stated('of the correlation time', 's', unknown=True)


@dataclass(frozen=True)
class VariogramCurve(Document):
    """Half the mean square of differences; five significant digits."""

    lag: Array = stated('time between samples', 's', shape=('n',))
    value: Array = stated('of range and angles', 'm^2, rad^2', shape=(3, 'n'))


@dataclass(frozen=True)
class SpectrumCurve(Document):
    """Power spectral density; five significant digits."""

    frequency: Array = stated('frequency', 'Hz', shape=('n',))
    density: Array = stated('of range and angles', 'm^2/Hz, rad^2/Hz', shape=(3, 'n'))


@dataclass(frozen=True)
class NoiseReport(ResultDocument):
    """Noise of range, horizontal and vertical angle of a tracker whose target stands still."""

    file = 'noise.json'

    u_range: float = stated('standard deviation of a sample along the beam', 'm')
    u_angle: Array = stated('of the horizontal and the vertical angle', 'rad', shape=(2,))
    white_range: float = stated('the part of it that averages out', 'm')
    white_angle: Array = stated('the same of both angles', 'rad', shape=(2,))
    correlation_time: Any = stated('of the rest: one number, or three', 's')
    standstills: int = stated('stops found')
    samples: int = stated('samples in the windows')
    uncertainty: NoiseUncertainty = stated('of these numbers')
    windows: int = stated('windows of standstill')
    windows_left_out: int = stated('windows in which the target seems to have moved')
    duration: float = stated('standstill used', 's')
    rate: float = stated('rate of the samples', 'Hz')
    distance: float = stated('mean length of the beam in the standstills', 'm')
    tails: Mapping[str, Tails] = stated('by quantity')
    peaks: tuple[Peak, ...] = stated('lines in the spectrum')
    lost: LostSamples = stated('of the whole recording')
    steps: tuple[Step, ...] = stated('within standstills')
    drift: Drift | None = stated('null without a long standstill')
    variogram: VariogramCurve = stated('of the standstills')
    spectrum: SpectrumCurve = stated('of the standstills')
    warnings: tuple[str, ...] = stated('what the user should read')
    events: tuple[str, ...] = stated('lost samples, steps, drift and peaks in words')
    schema: str = stated('otf-noise/1', default='otf-noise/1')
    provenance: Mapping[str, Any] = stated('when, from what, by what', factory=dict)
    noise: NoiseModel | None = None


def _rounded(values: NDArray[np.floating[Any]]) -> Array:
    """Five significant digits, for curves."""
    return np.array([float(f'{v:.5g}') for v in values.ravel()]).reshape(values.shape)


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


def _events(
    lost: LostSamples, steps: Sequence[Step], drift: Drift | None, peaks: Sequence[Peak]
) -> Iterator[str]:
    """Lost samples, steps, drift and peaks in words."""

    def sized(values: Array) -> str:
        a, b, c = 1e6 * values
        return f'{a:+.2f} um, {b:+.2f} urad, {c:+.2f} urad'

    yield (
        f'{lost.samples} samples lost in {lost.gaps} gaps, longest {lost.longest:.2f} s'
        if lost.samples
        else 'no samples lost'
    )
    if steps:
        largest = max(steps, key=lambda s: float(np.max(np.abs(s.size))))
        yield (f'{len(steps)} steps within standstills, the largest at {largest.time:.1f} s: '
               f'{sized(largest.size)}')  # fmt: skip
    if drift is not None:
        yield f'drift in {drift.duration:.1f} s: {sized(drift.change)}'
    for p in peaks:
        unit = 'um' if p.of == QUANTITIES[0] else 'urad'
        yield f'peak of the {p.of} at {p.frequency:.1f} Hz: {1e6 * p.rms:.3f} {unit} rms'
    if not peaks:
        yield 'no peaks in the spectrum'


def noise_report(
    samples: Samples, standstill_speed: float, parts: int = 1, origin: Origin | None = None
) -> NoiseReport:
    """Judge the noise in the standstills of a recording.

    Parameters
    ----------
    standstill_speed : float
        m/s; slower counts as standstill.
    parts : int
        Of the run; the beam is broken between them.
    origin : Origin, optional
        The recording.

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
    curve, fields = variogram(windows), noise_to_fields(measured.noise)
    steps, peaks = find_steps(samples, runs), find_peaks(seen, shape)
    drift = find_drift(samples, trim_to_rest(samples, runs))
    return NoiseReport(
        **fields | {'tails': dict(zip(QUANTITIES, measured.tails, strict=True))},
        standstills=len(runs),
        samples=measured.samples,
        uncertainty=NoiseUncertainty(
            float(u_total[0]), u_total[1:], float(u_white[0]), u_white[1:], u_time
        ),
        windows=measured.windows,
        windows_left_out=measured.left_out,
        duration=duration,
        rate=1.0 / step,
        distance=float(np.linalg.norm(samples.xyz[still], axis=1).mean()),
        peaks=peaks,
        lost=lost,
        steps=steps,
        drift=drift,
        events=tuple(_events(lost, steps, drift, peaks)),
        variogram=VariogramCurve(_rounded(curve.lag * step), _rounded(curve.value)),
        spectrum=SpectrumCurve(_rounded(seen.frequency), _rounded(seen.density)),
        warnings=_warnings(measured, windows, duration, lost, len(samples)),
        provenance=provenance('noise', runs=[] if origin is None else [origin]),
        noise=measured.noise,
    )
