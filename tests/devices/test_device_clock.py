# SPDX-License-Identifier: Apache-2.0
"""Stamps from a device's clock: near the truth, increasing, whatever clock and network do."""

import time

import numpy as np
import pytest
from device_times import EPOCH, Delays, packets

from otf_tracker_driver.clock import HostClock, Stamper

MILLISECOND = 1e6


def stamped(source, stamper=None):
    """Stamps and true times of all samples, ns; the samples carry their true time."""
    stamper = stamper or Stamper()
    out = []
    for device, true, arrival in source:
        xyz = np.zeros((len(device), 3))
        xyz[:, 0] = true - EPOCH
        out += stamper.take(device, xyz, arrival)
    out += stamper.flush()
    stamps = np.concatenate([part.stamp_ns for part in out])
    return stamps, EPOCH + np.concatenate([part.xyz[:, 0] for part in out]).astype(np.int64)


@pytest.mark.parametrize('drift', [15e-6, -20e-6, 28e-6])
@pytest.mark.parametrize('seed', range(2))
def test_drifting_clock_is_followed_within_a_millisecond(drift, seed):
    stamper = Stamper()
    stamps, true = stamped(packets(seed, 200, drift), stamper)
    assert np.all(np.diff(stamps) > 0)
    assert len(stamps) > 99_000
    off = np.abs(stamps - true)
    assert off.max() < 1.5 * MILLISECOND
    assert off[true > EPOCH + 5 * 10**9].max() < MILLISECOND
    assert stamper.clock.rate == pytest.approx(-drift, abs=8e-6)
    assert stamper.clock.jumps == 0


def test_arrival_times_would_be_wrong_by_a_third_of_a_second():
    wrong = [arrival - true[0] for _, true, arrival in packets(1, 20, 18e-6)]
    assert min(wrong) > 300 * MILLISECOND


def test_packets_late_by_seconds_change_nothing():
    def held_up():
        held = []
        for k, (device, true, arrival) in enumerate(packets(3, 120, 18e-6)):
            if 100 <= k < 108:  # a stalled network delivers them together
                held.append((device, true))
                continue
            for old in held:
                yield *old, arrival
            held = []
            yield device, true, arrival

    stamper = Stamper()
    stamps, true = stamped(held_up(), stamper)
    assert np.all(np.diff(stamps) > 0)
    assert np.abs(stamps - true).max() < MILLISECOND
    assert stamper.clock.late == 8 and stamper.clock.jumps == 0


@pytest.mark.parametrize('still', [15, 60, 180])
def test_backlog_of_a_process_that_stood_still_changes_nothing(still):
    def read_late():
        known = list(packets(3, 120, 18e-6))
        for k, (device, true, arrival) in enumerate(known):
            if 100 <= k < 100 + still:  # as the kernel has kept them, together
                last = min(100 + 15 * ((k - 100) // 15 + 1), 100 + still) - 1
                if k >= 100 + still // 3:  # and what it had no room for comes afterwards
                    last = 100 + still
                yield device, true, known[last][2]
            else:
                yield device, true, arrival

    stamper = Stamper()
    stamps, true = stamped(read_late(), stamper)
    assert np.all(np.diff(stamps) > 0)
    assert np.abs(stamps - true).max() < MILLISECOND
    assert stamper.clock.jumps == 0


@pytest.mark.parametrize('ahead', [0.3, 5.0, 86_400.0, -0.4, -30.0])
@pytest.mark.parametrize('seed', range(2))
def test_jump_of_the_clock_is_found_and_its_packets_wait_for_the_new_line(ahead, seed):
    stamper = Stamper()
    source = packets(seed, 60, 18e-6, delays=Delays(1e-3), jumps=[(30.1, ahead)])
    stamps, true = stamped(source, stamper)
    assert np.all(np.diff(stamps) > 0)
    at = EPOCH + 30_100_000_000
    # the packet that the jump falls into has two clocks; all others have one
    other = (true < at - 0.34e9) | (true > at + 0.34e9)
    assert np.abs(stamps - true)[other].max() < 1.5 * MILLISECOND
    assert other.sum() > 0.98 * len(other)
    assert stamper.clock.jumps <= 1


def test_start_cannot_take_longer_than_earlier_packets_have_shown():
    """No answer comes quickly, but packets of the first measurement bound its start."""
    stamper, delays = Stamper(), Delays(5e-4)
    stamper.started(EPOCH - 10**5, EPOCH + 9 * 10**6)
    stamped(packets(1, 20, 18e-6, delays=delays), stamper)
    stamper.restart()
    shift, unsent = 30 * 10**9, 15 * 10**5  # the order has left late
    ordered = EPOCH + shift - 10**5
    stamper.started(ordered - unsent, ordered + 9 * 10**6, ordered)
    device, true, arrival = next(packets(2, 5, 18e-6, delays=Delays(8e-3)))
    stamps, _ = stamped([(device, true, arrival + shift)], stamper)
    assert np.abs(stamps - true - shift).max() < MILLISECOND


def test_clock_that_starts_again_with_every_measurement():
    stamper, out, now = Stamper(), [], 0
    for seed in range(5):
        for device, true, arrival in packets(seed, 20, 18e-6):
            shift = now * 10**9
            xyz = np.zeros((len(device), 3))
            xyz[:, 0] = true - EPOCH + shift
            out += stamper.take(device, xyz, arrival + shift)
        out += stamper.restart()
        now += 25
    stamps = np.concatenate([part.stamp_ns for part in out])
    true = EPOCH + np.concatenate([part.xyz[:, 0] for part in out]).astype(np.int64)
    assert len(stamps) > 49_000 and np.all(np.diff(stamps) > 0)
    assert np.abs(stamps - true).max() < MILLISECOND


def test_delay_of_all_packets_is_bounded_by_the_command_to_start():
    """A delay that every packet has cannot be seen in the packets."""
    worst, late = [], 2 * 10**6
    for ordered in (None, EPOCH - 10**5):
        stamper = Stamper()
        if ordered:
            stamper.started(ordered)
        source = packets(5, 30, 18e-6, delays=Delays(1e-4, late=0.0))
        stamps, true = stamped(((d, t, arrival + late) for d, t, arrival in source), stamper)
        worst.append(np.abs(stamps - true).max())
    assert worst[0] > 2 * MILLISECOND
    assert worst[1] < 1.5 * MILLISECOND


@pytest.mark.parametrize('seed', range(3))
def test_command_to_start_and_its_answer_tell_the_clock_at_once(seed):
    """Packets that a busy computer delivers late do not matter then."""
    stamper = Stamper()
    stamper.started(EPOCH - 3 * 10**5, EPOCH + 10**6)
    source = list(packets(seed, 60, 18e-6, delays=Delays(4e-3)))
    stamps, true = stamped(source[:1], stamper)
    assert len(stamps) == len(source[0][0])
    later, also = stamped(source[1:], stamper)
    off = np.abs(np.concatenate([stamps - true, later - also]))
    assert off.max() < MILLISECOND
    assert stamper.clock.jumps == 0


def test_answer_that_was_held_up_counts_as_the_quickest_did():
    stamper, out = Stamper(), []
    for epoch, answered in enumerate((4 * 10**5, 4 * 10**6)):
        shift = epoch * 30 * 10**9
        stamper.restart()
        stamper.started(EPOCH + shift - 10**5, EPOCH + shift + answered)
        source = list(packets(epoch, 5, 18e-6, delays=Delays(3e-3)))
        moved = [(d, t + shift, arrival + shift) for d, t, arrival in source]
        out += stamped(moved[:1], stamper)
    assert all(len(part) for part in out)  # with the first packet of either
    assert np.abs(out[2] - out[3]).max() < 0.5 * MILLISECOND


def test_answer_that_precedes_the_start_by_far_is_not_believed():
    """A tracker that answers at once and starts its clock 30 ms later."""
    stamper = Stamper()
    stamper.started(EPOCH - 30_400_000, EPOCH - 30_000_000)
    stamps, true = stamped(packets(8, 60, 18e-6, delays=Delays(1e-3)), stamper)
    assert np.abs(stamps - true).max() < MILLISECOND


def test_rate_of_the_quartz_is_kept_when_the_clock_starts_again():
    stamper = Stamper()
    stamped(packets(6, 100, 18e-6), stamper)
    stamper.restart()
    stamped(((d, t, arrival + 100 * 10**9) for d, t, arrival in packets(7, 5, 18e-6)), stamper)
    assert stamper.clock.rate == pytest.approx(-18e-6, abs=8e-6)


def test_repeated_and_old_samples_are_left_out():
    stamper = Stamper()
    source = list(packets(2, 20, 0.0))
    source[30:30] = [source[29], source[28]]
    late = [(device, true, max(arrival, source[29][2])) for device, true, arrival in source[30:]]
    stamps, true = stamped([*source[:30], *late], stamper)
    taken = sum(len(device) for device, _, _ in source)
    assert stamper.dropped == len(source[28][0]) + len(source[29][0])
    assert len(stamps) == taken - stamper.dropped
    assert np.abs(stamps - true).max() < MILLISECOND


def test_slow_rate_of_samples_counts_as_delay():
    """At 50 Hz the last sample of a packet is up to 20 ms old when the packet is sent."""
    stamper = Stamper()
    stamps, true = stamped(packets(1, 150, 17e-6, interval=0.02), stamper)
    settled = true > EPOCH + 60 * 10**9
    assert np.abs(stamps - true)[settled].max() < 2 * MILLISECOND
    assert stamper.clock.spread == pytest.approx(0.01, abs=0.004)


def test_nothing_is_stamped_before_the_clock_is_known_and_all_of_it_then():
    stamper, source = Stamper(), list(packets(1, 4, 18e-6))
    waited = 0
    for device, _, arrival in source:
        got = stamper.take(device, np.zeros((len(device), 3)), arrival)
        if got:
            break
        assert not stamper.clock.settled
        waited += len(device)
    assert 800 < waited < 1300
    assert sum(map(len, got)) == waited + len(device)
    assert stamper.clock.settled


def test_few_packets_are_stamped_when_nothing_more_will_come():
    stamper = Stamper()
    source = list(packets(1, 1.2, 0.0))
    stamps, true = stamped(source, stamper)
    assert len(stamps) == sum(len(device) for device, _, _ in source)
    assert np.abs(stamps - true).max() < 10 * MILLISECOND


def test_heavy_jitter_costs_a_few_milliseconds_at_first():
    stamps, true = stamped(packets(7, 200, 18e-6, delays=Delays(mean=7e-3)))
    off = np.abs(stamps - true)
    assert off.max() < 5 * MILLISECOND
    assert off[true > EPOCH + 60 * 10**9].max() < 1.5 * MILLISECOND


def test_host_clock_agrees_with_the_time_of_day():
    clock = HostClock()
    first = clock.now_ns()
    assert abs(first - time.time_ns()) < 10**8
    assert first <= clock.now_ns()
