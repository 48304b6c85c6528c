# SPDX-License-Identifier: Apache-2.0
"""Samples: usual time from one to the next."""

import numpy as np
import pytest

from otf_core.model.observation import Samples


def test_usual_step_is_not_moved_by_lost_samples():
    stamp = 10**18 + np.delete(np.arange(1000) * 2_000_000, slice(100, 300))
    samples = Samples(stamp, np.zeros((len(stamp), 3)))
    assert samples.step_ns == 2_000_000
    assert samples.step == pytest.approx(0.002)


@pytest.mark.parametrize('count', [0, 1])
def test_single_sample_has_no_step(count):
    assert Samples(np.zeros(count, np.int64), np.zeros((count, 3))).step == 0.0
