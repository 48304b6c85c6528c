# SPDX-License-Identifier: Apache-2.0
"""Where a run begins and ends, whatever order samples and status arrive in."""

import time
from concurrent.futures import Future

import numpy as np
import pytest

from otf_calibrator.inputs import GONE, GONE_BESIDE, PublisherOfRun
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.run import ALIVE, LATE, SAME_RUN, SILENT, Collector
from otf_calibrator.session import Session
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


def announce(collector, name, published, state, now=0.0, last=None):
    """State so many samples, of which the last one is the sample number ``last``."""
    last_ns = 0 if last is None else last * 2_000_000
    collector.announce(name, published, state == 'STREAMING', state == 'FINISHED', now, last_ns)


def complete(collector, now=0.0):
    return collector.reason_to_end(now, at_stream_end=True, idle_timeout=10.0)


def test_stream_is_complete_when_all_announced_samples_are_here(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 90)
    announce(collector, 'a', 100, 'FINISHED')
    assert not complete(collector)
    add(collector, 10, start=90)
    assert complete(collector) == 'the stream has ended'
    assert collector.count_lost(0.0) == 0


def test_missing_samples_are_waited_for_and_then_counted_as_lost(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 90)
    announce(collector, 'a', 100, 'FINISHED', now=5.0)
    assert not complete(collector, now=5.0 + 0.9 * LATE)
    assert complete(collector, now=5.0 + 1.1 * LATE)
    assert collector.count_lost(5.0 + 1.1 * LATE) == 10


def test_rest_of_a_stream_is_of_its_run_although_its_end_was_heard_first_and_samples_are_lost():
    said = []
    collector = Collector(CalibrationConfig, said.append)
    collector.set_path(PATH)
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 50)
    announce(collector, 'a', 200, 'FINISHED', last=199)
    add(collector, 20, start=60 + 2000, now=10.0)  # 10 were overwritten, and stamps pause
    assert not complete(collector, now=10.0 + 0.9 * LATE)
    add(collector, 20, start=80 + 2000, now=10.0 + 3 * LATE)  # it was held up for long
    assert (len(collector.buffer), collector.run, said) == (90, 1, [])
    assert complete(collector, now=10.0 + 5 * LATE) == 'the stream has ended'
    assert collector.count_lost(10.0 + 5 * LATE) == 110
    collector.taken = True
    add(collector, 30, start=100 + 2000, now=10.0 + 6 * LATE)  # what is later still is no run
    assert (collector.taken, collector.run, said) == (True, 1, [])
    announce(collector, 'b', 0, 'STREAMING', now=10.0 + 7 * LATE)
    add(collector, 30, start=5000, now=10.0 + 7 * LATE)
    assert (len(collector.buffer), collector.taken) == (30, False)


@pytest.mark.parametrize('seconds', [0.2, 0.3])
def test_standstill_at_the_end_ends_a_run_whether_or_not_the_target_has_moved_on(seconds):
    config = CalibratorConfig(machine_file='none.yaml'), CalibrationConfig()
    session, verdict, now = Session(lambda: config, print), Future(), time.monotonic()
    session.worker.look = lambda look, samples: verdict
    session.collector.set_path(PATH)
    add(session.collector, 101, now=now)
    for k in range(101, 201 + round(500 * seconds)):
        session.collector.add(k * 2_000_000, 0.1, 1e-3 * min(k - 100, 100), 0.0, now)
        assert not session.reason_to_end()
    session.collector.add((k + 1) * 2_000_000, 0.09, 0.1, 0.0, now)
    assert not session.reason_to_end()  # nobody knows yet where that was
    verdict.set_result(True)
    ended = session.reason_to_end()
    assert ended == ('standstill at the end point' if seconds > 0.25 else '')
    assert not session.reason_to_end()


def test_end_of_a_stream_waits_for_no_verdict_on_its_standstill():
    config = CalibratorConfig(machine_file='none.yaml'), CalibrationConfig()
    session, now = Session(lambda: config, print), time.monotonic()
    session.worker.look = lambda look, samples: Future()
    session.collector.set_path(PATH)
    announce(session.collector, 'a', 0, 'STREAMING', now)
    add(session.collector, 101, now=now)
    for k in range(101, 501):
        session.collector.add(k * 2_000_000, 0.1, 1e-3 * min(k - 100, 100), 0.0, now)
    assert not session.reason_to_end() and session.judging
    announce(session.collector, 'a', 501, 'FINISHED', now)
    assert session.reason_to_end() == 'the stream has ended'


def test_calibration_that_is_asked_for_takes_what_has_arrived_and_ends_a_run_that_is_complete():
    config = CalibratorConfig(machine_file='none.yaml'), CalibrationConfig()
    now, arriving = time.monotonic(), [80, 90]

    def collect():
        if arriving:
            add(session.collector, 10, start=arriving.pop(0), now=now)

    session = Session(lambda: config, lambda text: None, collect=collect)
    session.collector.set_path(PATH)
    announce(session.collector, 'a', 0, 'STREAMING', now)
    add(session.collector, 80, now=now)
    announce(session.collector, 'a', 100, 'FINISHED', now)
    started, said = session.calibrate()
    assert started and 'of 90 samples' in said and not session.collector.taken
    assert not session.calibrate()[0]  # one at a time
    while not session.take_finished():
        time.sleep(0.01)
    started, said = session.calibrate()
    assert started and 'of 100 samples' in said and session.collector.taken
    session.close()


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
    assert (len(collector.buffer), collector.taken) == (50, False)
    assert complete(collector) and collector.count_lost(0.0) == 0


@pytest.mark.parametrize('status', [True, False])
def test_target_that_stands_after_a_calibrated_run_is_ignored_until_it_moves_on(collector, status):
    if status:
        announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    collector.taken = True
    for k in range(100, 150):
        collector.add(k * 2_000_000, 0.099, 0.0, 1e-6 * (k % 2), 0.0)
    assert (len(collector.buffer), collector.taken) == (100, True)
    collector.add(150 * 2_000_000, 2.0, 0.0, 0.0, 0.0)  # a single stray point
    collector.add(151 * 2_000_000, 0.099, 0.0, 0.0, 0.0)
    assert collector.taken
    if status:
        announce(collector, 'a', 152, 'STREAMING')
    add(collector, 120, start=152)
    assert not collector.taken and 100 < len(collector.buffer) < 120
    if status:
        announce(collector, 'a', 272, 'FINISHED')
        assert complete(collector)
    assert collector.count_lost(0.0) == 0 and collector.remarks == []


@pytest.mark.parametrize('away', [0.3 * ALIVE, 2 * ALIVE, 2 * SAME_RUN])
def test_run_goes_on_with_a_driver_that_was_killed_and_started_again_unless_much_later(
    collector, away
):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    announce(collector, 'a', 104, 'STREAMING', last=103)
    announce(collector, 'b', 0, 'STREAMING', now=away)
    add(collector, 10, start=600, now=away)
    announce(collector, 'b', 12, 'FINISHED', now=away + ALIVE)
    much_later = away > SAME_RUN
    assert len(collector.buffer) == (10 if much_later else 110)
    assert collector.count_lost(away + 3 * ALIVE) == (2 if much_later else 4 + 2)
    said = [*collector.remarks, *collector.restarts.remarks]
    assert len(said) == 1
    assert ('gap of 1.00 s' in said[0]) != much_later == ('much later' in said[0])


def test_driver_whose_stamps_begin_anew_begins_a_run(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100, start=10_000)
    announce(collector, 'b', 0, 'STREAMING', now=2 * ALIVE)
    add(collector, 10, now=2 * ALIVE)
    collector.decide(2 * ALIVE + 1.1 * SILENT)
    assert len(collector.buffer) == 10
    assert '100 samples before this run were set aside' in collector.remarks[0]


def test_stream_held_up_by_a_fault_goes_on(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    announce(collector, 'a', 100, 'IDLE')
    announce(collector, 'a', 100, 'STREAMING')
    for k in range(100, 110):
        collector.add(k * 2_000_000, 0.1, 0.0, 0.0, LATE + 1.0)
    assert len(collector.buffer) == 110


def test_samples_on_their_way_are_not_lost_yet(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    announce(collector, 'a', 130, 'STREAMING')
    assert collector.count_lost(0.0) == 0
    announce(collector, 'a', 130, 'FINISHED')
    assert collector.count_lost(0.0) == 0
    assert collector.count_lost(2 * LATE) == 30


def test_samples_lost_in_a_run_are_not_counted_in_the_next(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    announce(collector, 'a', 130, 'STREAMING')
    collector.reset()
    add(collector, 100, start=130)
    announce(collector, 'a', 235, 'FINISHED')
    assert collector.count_lost(2 * LATE) == 5


def test_stopped_stream_is_not_calibrated_by_itself(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 100)
    announce(collector, 'a', 100, 'IDLE')
    assert not complete(collector, now=1000.0)


@pytest.mark.parametrize('taken', [True, False])
def test_stamps_that_jump_back_begin_a_new_run_and_it_is_said(taken):
    said = []
    collector = Collector(CalibrationConfig, lambda why: said.append((why, len(collector.buffer))))
    collector.set_path(PATH)
    add(collector, 100, start=10_000)
    collector.taken = taken
    add(collector, 10)
    assert collector.held == 10 and collector.undecided(0.9 * SILENT) and not said
    collector.decide(1.1 * SILENT)
    assert (len(collector.buffer), collector.taken) == (10, False)
    assert said == [('the stamps went back by 20.2 s', 100)]
    assert len(collector.remarks) == (not taken)


@pytest.mark.parametrize('burst', [1, 20])
@pytest.mark.parametrize('apart', [3600, -3600])
@pytest.mark.parametrize('publishers', [1, 2])
def test_two_trackers_at_once_begin_no_runs(collector, burst, apart, publishers):
    collector.publishers, run = publishers, collector.run
    for k in range(2000):
        other = k // burst % 2
        collector.add(other * apart * 10**9 + k * 2_000_000, 1e-3 * k, 0.0, 0.0, 2e-3 * k)
    assert collector.run == run and len(collector.buffer) >= 1000 - burst
    assert 'whose stamps are off' in collector.screening.remarks()[0]


@pytest.mark.parametrize('publishers', [1, 2])
def test_driver_started_again_begins_a_run_while_the_graph_still_knows_the_dead_one(publishers):
    said = []
    collector = Collector(CalibrationConfig, said.append)
    collector.set_path(PATH)
    collector.publishers = publishers
    add(collector, 100, start=10_000)
    for k in range(400):
        collector.add(k * 2_000_000, 1e-3 * k, 0.0, 0.0, 1.0 + 2e-3 * k)
    assert len(said) == 1 and len(collector.buffer) == 400
    assert collector.buffer.snapshot().stamp_ns[0] == 0


@pytest.mark.parametrize('wrong', [[0], [-5], [3600], [2**31 - 1], [0, 3600, -5, 7200]])
@pytest.mark.parametrize('taken', [True, False])
def test_single_wrong_stamps_are_left_out(collector, wrong, taken):
    add(collector, 100, start=10_000)
    collector.taken, run = taken, collector.run
    for stamp in wrong:
        collector.add(stamp * 10**9, 10.1, 0.0, 0.0, 0.0)
    for k in range(10_100, 10_150):
        collector.add(k * 2_000_000, 10.1, 0.0, 0.0, 2.0 * SILENT)
    assert (collector.run, collector.held) == (run, 0)
    kept = collector.buffer.snapshot().stamp_ns
    assert kept.tolist() == [k * 2_000_000 for k in range(10_000, 10_100 if taken else 10_150)]
    assert bool(collector.screening.remarks()) == (not taken)


def test_samples_after_a_pause_are_all_there(collector):
    add(collector, 100)
    add(collector, 3, start=10_000)
    assert len(collector.buffer) == 100 and collector.undecided(0.0)
    collector.decide(1.1 * SILENT)
    assert len(collector.buffer) == 103
    add(collector, 5, start=20_000)
    assert len(collector.buffer) == 108


def test_two_drivers_at_once_lose_nothing(collector):
    published = 1000
    for k in range(8):
        announce(collector, 'ab'[k % 2], published + 50 * k, 'STREAMING')
        add(collector, 100, start=100 * k)
    announce(collector, 'b', published, 'IDLE')
    add(collector, 100, start=800)
    announce(collector, 'a', published, 'STREAMING')
    assert (len(collector.buffer), collector.count_lost(0.0)) == (900, 0)
    assert collector.remarks == collector.restarts.remarks == []


def test_end_of_a_second_drivers_stream_is_not_that_of_the_run(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 50)
    announce(collector, 'b', 0, 'STREAMING')
    announce(collector, 'a', 50, 'STREAMING')
    announce(collector, 'b', 0, 'FINISHED', now=1.0)
    assert not complete(collector, now=4.0)
    announce(collector, 'b', 0, 'FINISHED', now=20.0)  # the first has been silent for long
    assert complete(collector, now=40.0) == 'the stream has ended'


def test_silence_after_the_path_completes_a_run_without_status(collector):
    add(collector, 100)
    assert not complete(collector, now=1000.0)  # half of the path: a pause
    add(collector, 100, start=100)
    assert not complete(collector, now=9.0)
    assert complete(collector, now=11.0) == 'no sample for 11 s'
    assert not collector.reason_to_end(11.0, at_stream_end=True, idle_timeout=0.0)


def test_silence_completes_nothing_while_the_driver_says_that_its_stream_goes_on(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 190)
    announce(collector, 'a', 190, 'STREAMING')
    assert not complete(collector, now=1000.0)
    collector.publishers = 0  # it is gone
    assert complete(collector, now=1000.0)


def test_stray_points_are_no_travel_and_a_broken_beam_is(collector):
    add(collector, 50)
    collector.add(50 * 2_000_000, 3.0, 1.0, 0.0, 0.0)
    add(collector, 9, start=51)
    assert collector.travelled == pytest.approx(0.059, abs=0.002)
    collector.add(300 * 2_000_000, 0.3, 0.0, 0.0, 0.0)
    assert collector.travelled == pytest.approx(0.300, abs=0.003)


def test_silence_without_motion_completes_nothing(collector):
    collector.add(0, 1.0, 0.0, 0.0, 0.0)
    assert not complete(collector, now=100.0)


def test_path_that_comes_late_keeps_the_samples():
    collector = Collector(CalibrationConfig)
    add(collector, 100)
    assert not complete(collector, now=100.0)
    collector.set_path(PATH)
    assert len(collector.buffer) == 100
    assert collector.travelled == pytest.approx(0.099)


@pytest.mark.parametrize('over', [True, False])
def test_another_path_starts_over(collector, over):
    add(collector, 100 if over else 5)
    collector.taken = over
    collector.set_path(NominalPath(PATH.points + 0.1))
    assert (len(collector.buffer), collector.taken) == (0, False)


def test_target_that_leaves_a_calibrated_run_does_not_drive_the_next_one_yet(collector):
    add(collector, 100)
    collector.taken = True
    collector.path = NominalPath(PATH.points * 10.0)
    add(collector, 50, start=120)  # 2 % of the path
    assert not collector.taken and collector.travelled > 0.01 and not collector.driving


def test_silence_after_nearly_the_whole_path_completes_a_run_whatever_the_driver_says(collector):
    announce(collector, 'a', 0, 'STREAMING')
    add(collector, 196)
    assert not complete(collector, now=100.0)  # 97.5 %
    add(collector, 3, start=196)
    assert not complete(collector, now=9.0)
    assert complete(collector, now=11.0) == 'no sample for 11 s'


def chosen(run, numbers, now):
    """Those of the messages named like their numbers that are of the run."""
    return run.select(numbers, numbers, now)


def test_samples_of_a_second_publisher_are_left_out_however_long_it_goes_on():
    run = PublisherOfRun(lambda: 2)
    assert chosen(run, [7, 8], 0.0) == [7, 8]
    assert chosen(run, [4001, 4002], 0.1) == []
    assert chosen(run, [9, 4003, 12, 4004], 0.2) == [9, 12]
    assert chosen(run, [4005], 0.2 + 0.9 * GONE_BESIDE) == []
    assert chosen(run, [13, 4006], 20 * GONE_BESIDE) == [13]  # the node stood still


def test_publisher_after_one_that_was_killed_is_that_of_the_run():
    known = [2]
    run = PublisherOfRun(lambda: known[0])
    assert chosen(run, [500], 0.0) == [500]
    assert chosen(run, [1], 0.9 * GONE) == []
    assert chosen(run, [2, 3], 1.1 * GONE) == [2, 3]
    known[0] = 1  # the graph does not know the dead one any more
    assert chosen(run, [1, 2], 1.2 * GONE) == [1, 2]
    assert chosen(run, [5000], 1.3 * GONE) == [5000]
    assert chosen(run, [1], 1.4 * GONE) == [1]


def test_publishers_that_give_no_numbers_are_not_told_apart():
    assert chosen(PublisherOfRun(lambda: 2), [None, None], 0.0) == [None, None]


def restarted(collector, same):
    """100 samples, a calibrator that was ended and comes back, then 50 more samples."""
    announce(collector, 'a', 90, 'STREAMING')
    add(collector, 100)
    collector.resume_run()
    announce(collector, 'a' if same else 'b', 250 if same else 60, 'STREAMING')
    add(collector, 50, start=200)
    collector.decide(2 * SILENT)
    announce(collector, 'a' if same else 'b', 250 if same else 110, 'IDLE')


@pytest.mark.parametrize(('same', 'lost'), [(True, 100), (False, 0)])
def test_loss_while_the_calibrator_was_away_is_exact_if_the_driver_went_on_and_a_gap_else(
    collector, same, lost
):
    restarted(collector, same)
    assert collector.count_lost(2 * LATE) == lost
    (said,) = collector.restarts.remarks
    assert said == 'driver or calibrator restarted at stamp 0.198 s: gap of 0.20 s'


@pytest.mark.parametrize('late', [0, 1])
def test_loss_is_known_while_the_stream_goes_on_whichever_comes_first(collector, late):
    announce(collector, 'a', 100, 'STREAMING', last=99)
    add(collector, 100)
    collector.resume_run()
    add(collector, late, start=240)  # those from 100 to 239 are lost
    announce(collector, 'a', 241, 'STREAMING', last=240)
    add(collector, 60 - late, start=240 + late)
    assert collector.count_lost(0.0) == 140
    announce(collector, 'a', 320, 'STREAMING', last=319)
    assert collector.count_lost(0.0) == 140
    collector.reset()
    add(collector, 20, start=300)
    announce(collector, 'a', 320, 'STREAMING', last=319)
    assert collector.count_lost(0.0) == 0
