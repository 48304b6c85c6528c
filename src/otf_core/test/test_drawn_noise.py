# SPDX-License-Identifier: Apache-2.0
"""Noise of a simulated tracker: the part that lasts is a first-order Gauss-Markov process."""

import numpy as np
import pytest
from scipy.signal import lfilter

from otf_core.noise.noise_model import NoiseComponent
from otf_core.sim.tracker import draw_noise


@pytest.mark.parametrize('time', [0.0, 0.02, 3.0])
def test_lasting_noise_is_the_recursion_over_its_own_past(time):
    level, rate, count = 2e-6, 500.0, 5000
    noise = NoiseComponent(level, 0.0, time)
    found = draw_noise(noise, np.random.default_rng(3), count, rate)
    decay = np.exp(-1.0 / (rate * time)) if time else 0.0
    rng = np.random.default_rng(3)
    drive = rng.standard_normal(count) * np.sqrt(1.0 - decay**2)
    drive[0] = rng.standard_normal()
    np.testing.assert_allclose(found, level * lfilter([1.0], [1.0, -decay], drive), atol=1e-18)
