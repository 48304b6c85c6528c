# SPDX-License-Identifier: Apache-2.0
"""Noise of a sample in the path frame, against drawn ranges and angles."""

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.model.frames import RigidTransform
from otf_core.model.machine import TrackerSpec
from otf_core.noise.noise_model import (
    NoiseComponent,
    NoiseModel,
    beam_shares,
    mean_covariance,
    path_frame,
    sample_variance,
)
from otf_core.sim.tracker import draw_noise as drawn_noise
from otf_core.sim.tracker import measure


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def variances(noise, distance, beam, a2, a3):
    pose = RigidTransform(np.eye(3), np.zeros(3))
    return sample_variance(noise, beam_shares(distance * beam, pose, np.stack([a2, a3])))[:, 0]


def frames():
    rng = np.random.default_rng(0)
    direction, beam = unit(rng.normal(size=(40, 3))), unit(rng.normal(size=(40, 3)))
    beam[:4] = direction[:4]  # beam along the path
    beam[4:8] = -direction[4:8]
    beam[8] = unit(direction[8] + 1e-9 * beam[8])  # nearly so
    direction[9], beam[9] = [0, 0, 1], [0, 0, 1]
    direction[10], beam[10] = [1, 0, 0], [0, 1, 0]
    return direction, beam


def test_path_frame_is_right_handed_and_orthonormal_even_for_a_beam_along_the_path():
    direction, beam = frames()
    a2, a3 = path_frame(direction, beam)
    for basis in np.stack([direction, a2, a3], axis=1):
        np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(basis) == pytest.approx(1.0)


def test_second_axis_points_along_the_beam_as_far_as_it_can():
    direction, beam = frames()
    a2, a3 = path_frame(direction, beam)
    cosine = np.sum(beam * direction, axis=1)
    oblique = np.abs(cosine) < 0.999
    # the largest component a vector across the path can have is sin of the angle to the path
    np.testing.assert_allclose(
        np.sum(a2 * beam, axis=1)[oblique], np.sqrt(1 - cosine[oblique] ** 2), atol=1e-12
    )
    np.testing.assert_allclose(np.sum(a3 * beam, axis=1)[oblique], 0.0, atol=1e-12)


@pytest.mark.parametrize('seed', range(6))
def test_variances_are_those_of_drawn_ranges_and_beam_directions(seed):
    rng = np.random.default_rng(seed)
    noise = NoiseModel.from_spec(TrackerSpec(3e-6, 5e-6))
    distance = rng.uniform(0.3, 3.0)
    direction, beam = unit(rng.normal(size=(1, 3))), unit(rng.normal(size=(1, 3)))
    a2, a3 = path_frame(direction, beam)
    found = variances(noise, np.array([distance]), beam, a2, a3)
    # a beam turned by two small independent angles about two axes across it, range drawn too
    side = unit(np.cross(beam[0], rng.normal(size=3)))
    up = np.cross(beam[0], side)
    n = 40_000
    turned = beam + rng.normal(0, 5e-6, (n, 1)) * side + rng.normal(0, 5e-6, (n, 1)) * up
    points = rng.normal(distance, 3e-6, (n, 1)) * unit(turned)
    off = np.stack([(points - distance * beam) @ a2[0], (points - distance * beam) @ a3[0]])
    # the variance of n values has the relative standard deviation sqrt(2 / n) = 0.7 %; 5 of them
    np.testing.assert_allclose(np.var(off, axis=1), found, rtol=0.036)
    # the two components are weighted as independent; 5 / sqrt(n)
    assert abs(np.corrcoef(off)[0, 1]) < 0.025


def test_along_the_beam_only_the_range_counts_and_across_only_the_angle():
    noise = NoiseModel.from_spec(TrackerSpec(1e-6, 4e-6))
    x, y, z = np.eye(3)[:, None]
    # path along Y, beam along X, 2 m away: a2 = X gets u_range, a3 = -Z or Z gets 2 m * u_angle
    a2, a3 = path_frame(y, x)
    np.testing.assert_allclose(np.abs(a2), np.abs(x), atol=1e-15)
    np.testing.assert_allclose(np.abs(a3), np.abs(z), atol=1e-15)
    found = variances(noise, np.array([2.0]), x, a2, a3)
    np.testing.assert_allclose(found, [1e-12, 64e-12], rtol=1e-12)


def test_independent_samples_average_out():
    count = np.array([1, 4, 100])
    time, duration = np.array([0.0, 1.0, 2.0]), 0.01 * np.ones(3)
    found = mean_covariance(1.0, 0.3, time, duration, count)
    np.testing.assert_allclose(found, np.diag([1, 0.25, 0.01]), atol=1e-15)


def test_noise_slower_than_a_window_does_not_average_out():
    time, duration = np.array([0.0, 0.01]), 0.01 * np.ones(2)
    found = mean_covariance(0.0, 1e4, time, duration, np.array([1000, 1000]))
    np.testing.assert_allclose(found, np.ones((2, 2)), atol=1e-5)  # 0.01 s of 1e4 s


@pytest.mark.parametrize(
    ('white_share', 'correlation_time'), [(0.5, 0.3), (0.1, 0.02), (0.8, 1.0)]
)
def test_covariance_of_means_is_that_of_the_simulated_noise(white_share, correlation_time):
    rate, size, windows = 1000.0, 32, 6
    noise = NoiseComponent(1.0, np.sqrt(white_share), correlation_time)
    rng = np.random.default_rng(0)
    drawn = np.array([
        drawn_noise(noise, rng, size * windows, rate).reshape(windows, size).mean(axis=1)
        for _ in range(6000)
    ])  # fmt: skip
    time = size / rate * np.arange(windows)
    duration = np.full(windows, size / rate)
    found = mean_covariance(white_share, correlation_time, time, duration, np.full(windows, size))
    # relative standard deviation of a covariance of 6000 values: sqrt(2 / 6000) = 1.8 %; 4 of
    # them, and 1 % for samples 1 ms apart instead of a dense window
    np.testing.assert_allclose(np.cov(drawn.T), found, atol=0.08 * found.max())


def test_simulated_tracker_has_the_noise_of_its_specification():
    machine = some_machine()
    noise = NoiseModel.from_spec(machine.tracker, 1.0)
    point = np.array([[0.5, -0.8, 0.3]])
    n = 20_000
    off = measure(np.tile(point, (n, 1)), noise, 500.0, np.random.default_rng(0)) - point
    beam = unit(point[0])
    across = unit(np.cross(beam, [0.3, 0.2, 0.9]))
    distance = np.linalg.norm(point)
    # relative standard deviation of a standard deviation: 1 / sqrt(2 n) = 0.5 %; 5 of them
    assert np.std(off @ beam) == pytest.approx(machine.tracker.u_range, rel=0.025)
    assert np.std(off @ across) == pytest.approx(machine.tracker.u_angle * distance, rel=0.025)


def test_simulated_noise_has_unit_variance_and_the_stated_correlation():
    component = NoiseComponent(1.0, np.sqrt(0.4), 0.1)
    noise = drawn_noise(component, np.random.default_rng(1), 200_000, 100.0)
    # some 10 000 independent values: 1 % for a variance or a correlation, 4 of them
    assert np.var(noise) == pytest.approx(1.0, abs=0.06)
    lag = 10  # 0.1 s
    assert np.mean(noise[lag:] * noise[:-lag]) == pytest.approx(0.6 * np.exp(-1), abs=0.04)
