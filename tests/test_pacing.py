# SPDX-License-Identifier: Apache-2.0
"""Pacing of known samples: each once, when it is due, no flood, never far ahead of its readers."""

import numpy as np
import pytest

from otf_core.config import Parameters
from otf_core.model.observation import Samples
from otf_tracker_driver.backends import CommonConfig
from otf_tracker_driver.backends.paced import PacedBackend


class Known(PacedBackend):
    """Samples at 100 Hz, on a clock that the test moves."""

    def __init__(self, **common):
        self.now = 0.0
        super().__init__(CommonConfig(**common), Parameters(), clock=lambda: self.now)

    def connect(self):
        stamps = 1_700_000_000_000_000_000 + np.arange(1000) * 10_000_000
        self.load(Samples(stamps, np.arange(3000.0).reshape(-1, 3)))
        return ''

    def play(self, step):
        """Poll until the end; returns the batches."""
        self.start()
        batches = []
        while not self.finished:
            self.now += step
            batches.append(self.poll())
        return batches


@pytest.mark.parametrize('time_scale', [0.5, 1.0, 20.0])
def test_every_sample_comes_once_and_at_its_time(time_scale):
    backend = Known(time_scale=time_scale)
    backend.connect()
    batches = backend.play(0.01)
    stamps = np.concatenate([batch.stamp_ns for batch in batches])
    assert np.array_equal(np.diff(stamps), np.full(999, 10_000_000))
    assert backend.now == pytest.approx(9.99 / time_scale, abs=0.02)
    again = np.concatenate([batch.stamp_ns for batch in backend.play(0.01)])
    assert np.array_equal(again, stamps)


def test_long_pause_of_the_process_makes_no_flood():
    backend = Known()
    backend.connect()
    backend.start()
    backend.now += 5.0
    assert len(backend.poll()) <= 11


@pytest.mark.parametrize(('time_scale', 'behind'), [(0.5, 0.0), (1.0, 0.0), (20.0, 9.99 * 0.95)])
def test_stamps_of_now_keep_their_intervals_and_are_never_of_the_future(time_scale, behind):
    backend = Known(time_scale=time_scale)
    backend.of_now, begun_ns = True, 1_800_000_000_123_456_789
    backend.now_ns = lambda: begun_ns + round(backend.now * 1e9)
    backend.connect()
    for _ in range(2):  # each stream is of its own now
        begun = begun_ns + round(backend.now * 1e9)
        backend.start()
        latest, batches = [], []
        while not backend.finished:
            backend.now += 0.001
            batch = backend.poll()
            if len(batch):
                batches.append(batch)
                latest.append(backend.now_ns() - int(batch.stamp_ns[-1]))
        stamps = np.concatenate([batch.stamp_ns for batch in batches])
        assert np.array_equal(np.diff(stamps), np.full(999, 10_000_000))
        assert stamps[0] - begun == pytest.approx(-behind * 1e9, abs=2e3)
        assert min(latest) >= -2e3


def test_samples_that_were_recorded_keep_their_stamps():
    backend = Known()
    backend.connect()
    backend.start()
    assert backend.poll().stamp_ns[0] == 1_700_000_000_000_000_000


def test_source_waits_for_who_takes_its_samples_and_says_how_fast_it_is():
    backend = Known(time_scale=10.0)
    backend.connect()
    backend.start()
    backend.allowed, taken = 50, []
    while not backend.finished:
        backend.now += 0.1
        batch = backend.poll()
        taken.extend(batch.stamp_ns)
        assert len(batch) <= 50 and len(taken) <= backend.allowed
        assert len(taken) < 300 or backend.real_time_factor == pytest.approx(5.0, rel=0.1)
        assert not taken or backend.count_until(taken[-1]) == len(taken)
        backend.allowed += 50
    assert np.array_equal(np.diff(taken), np.full(999, 10_000_000))
    assert backend.real_time_factor == pytest.approx(5.0, rel=0.06)
