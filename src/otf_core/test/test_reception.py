# SPDX-License-Identifier: Apache-2.0
"""Order of reception against order of stamps, and two publishers on one topic."""

import numpy as np
import pytest
from bag_cells import PATH_MESSAGE, START, point_messages, write_mcap

from otf_core.bags.bag import read_bag
from otf_core.bags.sample_order import PERIODS, sort_by_time
from otf_core.errors import InputError
from otf_core.model.observation import Samples

COUNT, STEP = 2000, 10_000_000
STAMPS = START + STEP * np.arange(COUNT)
S = 1_000_000_000


def track(count=COUNT, seed=1, place=(1.5, -2.0, 0.5)):
    """A target that goes forth and back at 0.2 m/s, 100 Hz, with the noise of a tracker."""
    way = 0.002 * np.arange(count)
    along = np.abs((way + 0.1) % 1.2 - 0.6)
    xyz = np.stack([along, 0.3 * along, 0.1 * np.floor(way / 1.2)], axis=1) + place
    return xyz + np.random.default_rng(seed).normal(0, 2e-6, xyz.shape)


XYZ = track()


def ordered(stamps, xyz=XYZ):
    remarks = []
    samples = sort_by_time('run', np.asarray(stamps, np.int64), xyz, remarks)
    return samples, remarks


def since(stamps):
    return np.asarray(stamps) - stamps[0]


# ---------------------------------------------------------------- counters that begin again


@pytest.mark.parametrize('what', [name for name, period in PERIODS.items() if period > 2 * S])
@pytest.mark.parametrize('at', [300, 1500])
def test_a_counter_that_wraps_goes_on(what, at):
    period = PERIODS[what]
    stamps = (STAMPS - STAMPS[at] + 100 * period) % period
    samples, remarks = ordered(stamps)
    np.testing.assert_array_equal(since(samples.stamp_ns), since(STAMPS))
    assert samples.xyz.tobytes() == XYZ.tobytes()
    assert len(remarks) == 1
    assert period < 5 * S or f'first at sample {at}' in remarks[0]
    assert f'{1e-9 * period:.9g} s' in remarks[0]


def test_parts_of_a_second_alone_wrap_every_second():
    samples, remarks = ordered(STAMPS % S)
    np.testing.assert_array_equal(since(samples.stamp_ns), since(STAMPS))
    assert 'go back 20 times by about 1 s' in remarks[0]


@pytest.mark.parametrize('back', [5 * S, 37 * S + 123, 100_000 * S])
def test_a_clock_set_back_while_the_target_goes_on_is_continued(back):
    stamps = np.concatenate([STAMPS[:900], STAMPS[900:] - back])
    samples, remarks = ordered(stamps)
    np.testing.assert_array_equal(since(samples.stamp_ns), since(STAMPS))
    assert 'the clock was set back' in remarks[0] and 'sample 900' in remarks[0]
    assert 'usual step of 10 ms' in remarks[0]


@pytest.mark.parametrize('wrong', [0, 2**31 * S, START - 5 * S])
@pytest.mark.parametrize('count', [1, 3])
def test_single_wrong_stamps_are_no_seams(wrong, count):
    stamps = STAMPS.copy()
    stamps[700 : 700 + count] = wrong
    samples, remarks = ordered(stamps)
    np.testing.assert_array_equal(samples.stamp_ns, np.delete(STAMPS, range(700, 700 + count)))
    assert f'dropped {count} of {COUNT} points whose stamps are off' in remarks[0]
    wrapped = stamps.copy()
    wrapped[1300:] -= 3600 * S
    samples, remarks = ordered(wrapped)
    np.testing.assert_array_equal(samples.stamp_ns, np.delete(STAMPS, range(700, 700 + count)))
    assert len(remarks) == 2


def test_two_runs_after_each_other_are_not_joined():
    stamps = np.concatenate([STAMPS[:900] + 100 * S, STAMPS[:1100]])
    xyz = np.concatenate([XYZ[:900], XYZ[:1100] + np.array([0.0, 0.4, 0.0])])
    with pytest.raises(InputError, match=r'goes back by .* s at sample 900'):
        ordered(stamps, xyz)


# ---------------------------------------------------------------- sorted to and fro


def lost_zeros(stamps):
    return [int(f'{t // S}{str(t % S).ljust(9, "0")}') for t in stamps.tolist()]


def test_stamps_joined_without_leading_zeros_are_refused():
    with pytest.raises(InputError, match='back and forth when sorted by stamp'):
        ordered(lost_zeros(STAMPS + 123_456))


@pytest.mark.parametrize('reach', [2, 20, 90])
def test_samples_that_transport_has_shuffled_are_sorted(reach):
    order = np.argsort(np.arange(COUNT) + np.random.default_rng(3).uniform(0, reach, COUNT))
    samples, remarks = ordered(STAMPS[order], XYZ[order])
    assert samples.xyz.tobytes() == XYZ.tobytes()
    assert 'sorted by stamp' in remarks[0]


def test_shuffled_at_a_standstill_are_sorted():
    xyz = np.tile(XYZ[0], (COUNT, 1)) + np.random.default_rng(4).normal(0, 2e-6, XYZ.shape)
    order = np.argsort(np.arange(COUNT) + np.random.default_rng(5).uniform(0, 20, COUNT))
    samples, _ = ordered(STAMPS[order], xyz[order])
    assert samples.xyz.tobytes() == xyz.tobytes()


@pytest.mark.parametrize('apart', [-49 * S, 10 * S, 10**15])
@pytest.mark.parametrize('gap', [0, 700])
def test_two_publishers_on_one_topic_are_refused(tmp_path, apart, gap):
    other = track(seed=2, place=(-1.0, 3.0, 0.2))
    messages = [PATH_MESSAGE]
    for k in range(COUNT):
        messages += point_messages(Samples(STAMPS[k : k + 1], XYZ[k : k + 1]))
        if k >= gap:
            messages += point_messages(Samples(STAMPS[k : k + 1] + apart, other[k : k + 1]))
    rows = [(a, b, START + i, d) for i, (a, b, _, d) in enumerate(messages)]
    with pytest.raises(InputError, match='runs or trackers are mixed; record each in its own bag'):
        read_bag(write_mcap(tmp_path / 'run.mcap', rows))
