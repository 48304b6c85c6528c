# SPDX-License-Identifier: Apache-2.0
"""Where a run begins and ends, whatever order samples and status arrive in."""

import numpy as np
import pytest

from otf_calibrator.collector import LATE, Collector
from otf_core.config import CalibrationConfig
from otf_core.model.path import NominalPath

PATH = NominalPath(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0]]))


@pytest.fixture
def collector():
    made = Collector(CalibrationConfig)
    made.set_path(PATH)
    return made


def add(collector, count, start=0, now=0.0):
    """Samples of a target that moves 1 mm per 2 ms."""
    for k in range(start, start + count):
        collector.add(k * 2_000_000, 1e-3 * k, 0.0, 0.0, now)


def announce(collector, name, published, state, now=0.0):
    collector.announce(name, published, state == 'STREAMING', state == 'FINISHED', now)


def complete(collector, now=0.0):
    return collector.complete(now, at_stream_end=True, idle_timeout=10.0)


def test_stream_is_complete_when_all_announced_samples_are_here(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 90)
    announce(collector, 'a', 100, 'FINISHED')
    assert not complete(collector)
    add(collector, 10, start=90)
    assert complete(collector) == 'the stream has ended'
    assert collector.lost == 0


def test_missing_samples_are_waited_for_and_then_counted_as_lost(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 90)
    announce(collector, 'a', 100, 'FINISHED', now=5.0)
    assert not complete(collector, now=5.0 + 0.9 * LATE)
    assert complete(collector, now=5.0 + 1.1 * LATE)
    assert collector.lost == 10


@pytest.mark.parametrize('status_first', [True, False])
def test_next_stream_is_a_new_run_whichever_of_status_and_samples_comes_first(
    collector, status_first
):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    announce(collector, 'a', 100, 'FINISHED')
    collector.taken = True
    if status_first:
        announce(collector, 'b', 0, 'STREAMING')
    add(collector, 20, start=200)
    announce(collector, 'b', 20, 'STREAMING')
    add(collector, 30, start=220)
    announce(collector, 'b', 50, 'FINISHED')
    assert (len(collector.buffer), collector.taken, collector.lost) == (50, False, 0)
    assert complete(collector)


def test_samples_after_the_calibration_of_an_open_stream_are_ignored(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    collector.taken = True
    add(collector, 50, start=100)
    announce(collector, 'a', 150, 'FINISHED')
    assert (len(collector.buffer), collector.lost, complete(collector)) == (100, 0, '')


def test_new_driver_that_never_saw_the_old_one_end_begins_a_new_run(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    announce(collector, 'b', 0, 'STREAMING')
    add(collector, 10, start=500)
    assert len(collector.buffer) == 10


def test_stopped_stream_is_not_calibrated_by_itself(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    announce(collector, 'a', 100, 'IDLE')
    assert not complete(collector, now=1000.0)


def test_stamps_that_jump_back_begin_a_new_run(collector):
    add(collector, 100, start=10_000)
    collector.taken = True
    add(collector, 10)
    assert (len(collector.buffer), collector.taken) == (10, False)


def test_silence_after_motion_completes_a_run_without_status(collector):
    add(collector, 100)
    assert not complete(collector, now=9.0)
    assert complete(collector, now=11.0) == 'no sample for 11 s'
    assert not collector.complete(11.0, at_stream_end=True, idle_timeout=0.0)


def test_silence_without_motion_completes_nothing(collector):
    collector.add(0, 1.0, 0.0, 0.0, 0.0)
    assert not complete(collector, now=100.0)


def test_path_that_comes_late_keeps_the_samples():
    collector = Collector(CalibrationConfig)
    add(collector, 100)
    assert not complete(collector, now=100.0)
    assert collector.set_path(PATH) and not collector.set_path(PATH)
    assert len(collector.buffer) == 100
    assert collector.travelled == pytest.approx(0.099)


def test_new_path_after_a_calibration_starts_over(collector):
    add(collector, 100)
    collector.taken = True
    assert collector.set_path(NominalPath(PATH.points + 0.1))
    assert (len(collector.buffer), collector.taken) == (0, False)
