# SPDX-License-Identifier: Apache-2.0
"""Noise of standstills: level, colour, tails, peaks, and what is left out."""

import numpy as np
import pytest
from core_cells import START_NS, some_machine

from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.noise.noise_model import NoiseModel
from otf_core.noise.report import noise_report
from otf_core.noise.standstill import find_standstills, noise_model, standstill_noise
from otf_core.reports.noise_report import format_noise
from otf_core.sim.tracker import measure


def text_of(report):
    return format_noise(report.to_dict())


SPEED = 0.002
RATE = 500.0


def stops(places, seconds, seed=0, rate=RATE, share=0.5, correlation_time=0.3, add=None):
    """Samples of a target that stands at random places and moves quickly between them."""
    rng = np.random.default_rng(seed)
    count, rows = int(seconds * rate), []
    for k in range(places):
        place = np.array([1.0, 0.8, 0.2]) + rng.uniform(-0.3, 0.3, 3)
        still = np.tile(place, (count, 1))
        if add is not None:
            still += add(k, np.arange(count) / rate)
        rows.append(still)
        if k < places - 1:
            rows.append(still[-1] + np.linspace(0, 0.1, int(0.3 * rate))[:, None] * [1, 0, 0])
    true = np.concatenate(rows)
    noise = NoiseModel.from_spec(some_machine().tracker, 1.0 - share, correlation_time)
    xyz = measure(true, noise, rate, rng)
    return Samples(START_NS + np.rint(np.arange(len(true)) / rate * 1e9).astype(np.int64), xyz)


def relative(noise):
    """Total and white part over what the machine of the tests specifies."""
    spec = some_machine().tracker
    size = np.array([spec.u_range, spec.u_angle, spec.u_angle])
    return noise.level / size, noise.white / size


@pytest.mark.parametrize(
    ('places', 'seconds', 'share', 'correlation_time', 'tolerance'),
    [  # tolerance: 4 standard deviations over some hundred drawn recordings
        (2, 3.0, 0.5, 0.3, 0.35),
        (1, 60.0, 0.5, 0.3, 0.10),
        (1, 60.0, 0.9, 0.1, 0.08),
        (30, 1.0, 0.5, 0.3, 0.25),
        (100, 0.5, 0.5, 0.3, 0.25),
        (10, 5.0, 0.8, 0.03, 0.05),
    ],
)
def test_level_and_colour_are_those_of_the_simulation(
    places, seconds, share, correlation_time, tolerance
):
    samples = stops(places, seconds, share=share, correlation_time=correlation_time)
    noise = standstill_noise(samples, find_standstills(samples, SPEED), min_total=1.0).noise
    total, white = relative(noise)
    np.testing.assert_allclose(total, 1.0, atol=tolerance)
    np.testing.assert_allclose(white, np.sqrt(1 - share), atol=0.05)
    assert 0.4 < noise.range.correlation_time / correlation_time < 2.5


def test_standstills_in_which_the_target_creeps_are_left_out():
    def creep(k, time):
        return (k % 2) * 60e-6 * np.exp(-time)[:, None] * [1, 1, 0]

    samples = stops(20, 2.0, add=creep)
    report = noise_report(samples, SPEED)
    assert report.windows_left_out >= 8
    np.testing.assert_allclose(relative(report.noise)[0], 1.0, atol=0.3)


def test_a_step_is_told_and_is_no_noise():
    def step(k, time):
        return 15e-6 * (time > 1.5)[:, None] * np.array([1.0, 0.8, 0.2]) / 1.3 * (k == 2)

    report = noise_report(stops(6, 4.0, add=step), SPEED)
    assert len(report.steps) == 1
    assert report.steps[0].size[0] == pytest.approx(15e-6, rel=0.1)
    assert report.steps[0].time == pytest.approx(2 * 4.3 + 1.5, abs=0.2)
    np.testing.assert_allclose(relative(report.noise)[0], 1.0, atol=0.3)
    assert '1 steps within standstills, the largest at 10.' in text_of(report)
    assert not noise_report(stops(6, 4.0), SPEED).steps


def test_slow_drift_is_told_and_is_no_noise():
    def drift(k, time):
        return 2e-6 * time[:, None] * np.array([1.0, 0.8, 0.2]) / 1.3

    steady, drifting = (noise_report(stops(1, 20.0, add=a), SPEED) for a in (None, drift))
    rates = [r.drift.change[0] / r.drift.duration for r in (steady, drifting)]
    assert rates[1] - rates[0] == pytest.approx(2e-6, rel=0.05)
    np.testing.assert_allclose(drifting.noise.level, steady.noise.level, rtol=0.05)


def test_lost_samples_leave_level_and_colour():
    samples = stops(10, 4.0)
    rng = np.random.default_rng(3)
    kept = rng.random(len(samples)) > 0.1
    report = noise_report(Samples(samples.stamp_ns[kept], samples.xyz[kept]), SPEED)
    assert report.lost.samples == pytest.approx(np.sum(~kept), abs=3)
    np.testing.assert_allclose(relative(report.noise)[0], 1.0, atol=0.2)
    assert 0.5 < report.noise.range.correlation_time / 0.3 < 2.0
    assert '(10 %)' in text_of(report)
    late = samples.stamp_ns + np.where(np.arange(len(samples)) < 900, 0, 4_000_000_000)
    for parts, gaps in ((1, 1), (2, 0)):  # between two parts a reflector is moved by hand
        assert noise_report(Samples(late, samples.xyz), SPEED, parts).lost.gaps == gaps


def test_rounding_to_a_micrometre_changes_levels_by_its_own_noise():
    samples = stops(10, 4.0, rate=100.0)
    exact = noise_report(samples, SPEED).noise
    coarse = Samples(samples.stamp_ns, samples.xyz.round(6))
    rounded = noise_report(coarse, SPEED).noise
    own = 1e-6 / np.sqrt(12) / np.array([1.0, 1.3, 1.3])
    np.testing.assert_allclose(rounded.white**2, exact.white**2 + own**2, rtol=0.1)
    np.testing.assert_allclose(rounded.level**2, exact.level**2 + own**2, rtol=0.1)


def test_held_points_are_told_from_rounded_ones():
    samples = stops(4, 5.0)
    held = samples.xyz[np.arange(len(samples)) // 4 * 4]
    text = text_of(noise_report(Samples(samples.stamp_ns, held), SPEED))
    assert 'measures 4.0 times slower than the stamps say' in text
    assert 'rounded' not in text


def test_stamps_of_arrival_in_bursts_are_refused():
    samples = stops(1, 5.0)
    packet = np.arange(len(samples)) // 167
    late = START_NS + packet * 334_000_000 + (np.arange(len(samples)) % 167) * 40_000
    with pytest.raises(InputError, match='times of arrival in bursts'):
        noise_report(Samples(late, samples.xyz), SPEED)


def test_short_stops_give_a_noise_model_without_bias():
    ratio = []
    spec = some_machine().tracker
    for seed in range(12):
        samples = stops(100, 0.4, seed=seed, rate=100.0)
        noise = noise_model(samples, spec, SPEED)
        slow = noise.vertical.slow**2 * noise.vertical.correlation_time
        ratio.append(slow / (spec.u_angle**2 * 0.5 * 0.3))
    # what a mean over a long leg keeps of the noise: variance of the slow part times its time
    assert abs(np.median(ratio) - 1.0) < 0.1
    assert min(ratio) > 0.7 and max(ratio) < 1.4


def test_vibration_is_a_peak_with_its_frequency_and_size():
    def shaken(k, time):
        return 0.6e-6 * np.sin(2 * np.pi * 37.0 * time)[:, None] * np.array([1.0, 0.8, 0.2]) / 1.3

    report = noise_report(stops(6, 5.0, add=shaken), SPEED)
    along = [p for p in report.peaks if p.of == 'range']
    assert [round(p.frequency) for p in along] == [37]
    assert along[0].rms == pytest.approx(0.6e-6 / np.sqrt(2), rel=0.3)
    assert 'peak of the range at 37' in text_of(report)


def test_heavy_tails_are_told_from_normal_ones():
    rng = np.random.default_rng(0)
    samples = stops(4, 5.0, share=0.0)
    normal = noise_report(samples, SPEED).tails.values()
    assert all(t.student_freedom is None and abs(t.excess_kurtosis) < 0.2 for t in normal)
    beam = samples.xyz / np.linalg.norm(samples.xyz, axis=1, keepdims=True)
    heavy = Samples(
        samples.stamp_ns, samples.xyz + 2e-6 * rng.standard_t(4, len(beam))[:, None] * beam
    )
    tail = noise_report(heavy, SPEED).tails['range']
    assert tail.excess_kurtosis > 1.0
    assert 3.0 < tail.student_freedom < 6.0
