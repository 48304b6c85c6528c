# SPDX-License-Identifier: Apache-2.0
"""Noise of a sample in the path frame, against drawn ranges and angles."""

import numpy as np
import pytest

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


def test_along_the_beam_only_the_range_counts_and_across_only_the_angle():
    noise = NoiseModel.from_spec(TrackerSpec(1e-6, 4e-6))
    x, y, z = np.eye(3)[:, None]
    # path along Y, beam along X, 2 m away: a2 = X gets u_range, a3 = -Z or Z gets 2 m * u_angle
    a2, a3 = path_frame(y, x)
    np.testing.assert_allclose(np.abs(a2), np.abs(x), atol=1e-15)
    np.testing.assert_allclose(np.abs(a3), np.abs(z), atol=1e-15)
    found = variances(noise, np.array([2.0]), x, a2, a3)
    np.testing.assert_allclose(found, [1e-12, 64e-12], rtol=1e-12)


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
