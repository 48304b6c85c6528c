# SPDX-License-Identifier: Apache-2.0
"""Recorded points to samples: wrong stamps, other clocks, order of reception, points left out."""

import numpy as np
import pytest
from bag_cells import PATH_MESSAGE, START, point_messages, write_mcap

from otf_core.bags.bag import read_bag
from otf_core.bags.sample_order import of_one_clock, sort_by_time
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


# ---------------------------------------------------------------- clocks that go back


@pytest.mark.parametrize('back', [5 * S, 3600 * S, (1 << 32) * 1_000_000])
def test_a_clock_that_goes_back_is_refused_with_its_place(back):
    stamps = np.concatenate([STAMPS[:900], STAMPS[900:] - back])
    with pytest.raises(InputError, match=rf'goes back by {back / S - 0.01:.3f} s at sample 900'):
        ordered(stamps)


@pytest.mark.parametrize('wrong', [0, 2**31 * S, START - 5 * S])
@pytest.mark.parametrize('count', [1, 3])
def test_single_wrong_stamps_are_no_seams(wrong, count):
    stamps = STAMPS.copy()
    stamps[700 : 700 + count] = wrong
    samples, remarks = ordered(stamps)
    np.testing.assert_array_equal(samples.stamp_ns, np.delete(STAMPS, range(700, 700 + count)))
    assert f'dropped {count} of {COUNT} points whose stamps are off' in remarks[0]


# ---------------------------------------------------------------- sorted to and fro


@pytest.mark.parametrize('reach', [2, 20, 90])
def test_samples_that_transport_has_shuffled_are_sorted(reach):
    order = np.argsort(np.arange(COUNT) + np.random.default_rng(3).uniform(0, reach, COUNT))
    samples, remarks = ordered(STAMPS[order], XYZ[order])
    assert samples.xyz.tobytes() == XYZ.tobytes()
    assert 'sorted by stamp' in remarks[0]


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
    with pytest.raises(InputError, match='mixed'):
        read_bag(write_mcap(tmp_path / 'run.mcap', rows))


# ---------------------------------------------------------------- clocks

CLOCK = 1_700_000_000 * S + np.arange(1000) * S // 100
WRONG = (0, -5 * S, 1_700_003_600 * S, (2**31 - 1) * S, 1_699_999_990 * S)


def left_out(stamps):
    """Indices that are left out; what is told of them is the same."""
    told = []
    kept = of_one_clock(stamps, lambda off, newest: told.extend(off))
    if kept is None:
        assert not told
        return []
    out = np.setdiff1d(np.arange(len(stamps)), kept)
    assert sorted(told) == sorted(stamps[out].tolist())
    return out.tolist()


@pytest.mark.parametrize('wrong', WRONG)
@pytest.mark.parametrize('at', [[7], [500], [500, 501, 502, 503], [990, 997]])
def test_single_wrong_stamps_are_left_out(wrong, at):
    stamps = CLOCK.copy()
    stamps[at] = wrong
    assert left_out(stamps) == at


@pytest.mark.parametrize(('at', 'off'), [(0, 3600 * S), (999, -3600 * S)])
def test_wrong_stamps_at_either_end_are_left_out(at, off):
    stamps = CLOCK.copy()
    stamps[at] += off
    assert left_out(stamps) == [at]


def test_pauses_and_what_transport_delays_are_no_wrong_stamps():
    stamps = CLOCK.copy()
    stamps[500:] += 60 * S
    stamps[700:800] = stamps[700:800][::-1]
    stamps[100] -= S // 2
    assert left_out(stamps) == []


def test_of_two_trackers_one_is_left_out_whoever_is_ahead():
    for apart in (3600 * S, -3600 * S):
        for burst in (1, 20):
            other = np.arange(1000) // burst % 2 == 1
            out = left_out(CLOCK + apart * other)
            assert 450 <= len(out) <= 550 and len(set(other[out].tolist())) == 1


# ---------------------------------------------------------------- points left out

POINTS = np.ones((8, 3))
POINTS[5] = np.nan
