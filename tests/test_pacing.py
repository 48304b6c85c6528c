# SPDX-License-Identifier: Apache-2.0
"""Pacing of known samples: each once, when it is due, no flood, never far ahead of its readers."""

import numpy as np
import pytest

from otf_core.config import Parameters
from otf_core.model.observation import Samples
from otf_tracker_driver import streamer
from otf_tracker_driver.backends import CommonConfig
from otf_tracker_driver.backends.base import join_samples
from otf_tracker_driver.backends.paced import PacedBackend
from otf_tracker_driver.calibrators import UNTAKEN, Place


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


def test_place_of_a_calibrator_follows_what_it_takes_and_passes_what_it_never_will():
    place = Place(None, 0.0)
    place.hear(3000, 3500)
    assert place.passed == 3000
    for _ in range(UNTAKEN - 1):
        place.hear(0, 6000)  # it was started again, and has none of this stream
    assert place.passed == 3000
    place.hear(0, 6000)
    assert place.passed == 6000
    for _ in range(2 * UNTAKEN):  # all taken: nothing is missing
        place.hear(6000, 6000)
    assert place.passed == 6000


class Clock:
    """Time that the test moves."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        monkeypatch.setattr(streamer.time, 'monotonic', lambda: self.now)


def published(pace, clock, packets, ends):
    """Batches as they are published: packets of 500 Hz that come at their times, by tick."""
    batches, packets = [], dict(packets)
    while clock.now < ends:
        clock.now += streamer.PERIOD
        due = [at for at in packets if at <= clock.now]
        new = join_samples([packets.pop(at) for at in due])
        batches.append((clock.now, pace.take(new, True)))
    return batches


def packet(first, count):
    """Samples of 500 Hz from the sample of this number on."""
    stamps = (first + np.arange(count)) * 2_000_000
    return Samples(stamps, np.zeros((count, 3)))


def test_packets_are_spread_over_their_time_and_late_by_no_more_than_one(monkeypatch):
    clock = Clock(monkeypatch)
    begun, pace = clock.now, streamer.Pace()
    packets = [(begun + k / 3 + 0.02 * (k % 3), packet(500 * k // 3, 167)) for k in range(30)]
    packets = [(at, packet(own.stamp_ns[0] // 2_000_000, 166)) for at, own in packets]
    batches = published(pace, clock, packets, begun + 11.0)
    sizes = [len(batch) for _, batch in batches]
    assert sum(sizes) == 30 * 166 and max(sizes) < 10  # the depth of default subscriptions
    came = {int(s): at for at, own in packets for s in own.stamp_ns}
    late = [now - came[int(s)] for now, batch in batches for s in batch.stamp_ns]
    assert max(late) < 1 / 3 + 0.06
    assert pace.backlog < 0.1


def test_backlog_is_a_number_and_is_caught_up_with(monkeypatch):
    clock = Clock(monkeypatch)
    begun, pace = clock.now, streamer.Pace()
    held = [(begun + 0.1, packet(0, 5000))]
    later = [(begun + 0.4 + k / 3, packet(5000 + 166 * k, 166)) for k in range(60)]
    batches = published(pace, clock, held + later, begun + 0.5)
    assert pace.backlog == pytest.approx(9.0, abs=1.0)
    batches += published(pace, clock, later[1:], begun + 20.0)
    stamps = np.concatenate([batch.stamp_ns for _, batch in batches])
    assert np.all(np.diff(stamps) > 0) and len(stamps) > 5000 + 50 * 166
    assert pace.backlog < 0.5
