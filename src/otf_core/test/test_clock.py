# SPDX-License-Identifier: Apache-2.0
"""Which stamps are wrong, and which are of another clock."""

import numpy as np
import pytest

from otf_core.bags.sample_order import CLOCK_CHANGE_SAMPLES, of_one_clock

S = 1_000_000_000
STAMPS = 1_700_000_000 * S + np.arange(1000) * S // 100
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
    stamps = STAMPS.copy()
    stamps[at] = wrong
    assert left_out(stamps) == at


@pytest.mark.parametrize(('at', 'off'), [(0, 3600 * S), (999, -3600 * S)])
def test_wrong_stamps_at_either_end_are_left_out(at, off):
    stamps = STAMPS.copy()
    stamps[at] += off
    assert left_out(stamps) == [at]


def test_pauses_and_what_transport_delays_are_no_wrong_stamps():
    stamps = STAMPS.copy()
    stamps[500:] += 60 * S
    stamps[700:800] = stamps[700:800][::-1]
    stamps[100] -= S // 2
    assert left_out(stamps) == []


@pytest.mark.parametrize('at', [500, 1000 - CLOCK_CHANGE_SAMPLES])
def test_clock_that_was_set_back_is_not_left_out(at):
    stamps = STAMPS.copy()
    stamps[at:] -= 20 * S
    assert left_out(stamps) == []


def test_of_two_trackers_one_is_left_out_whoever_is_ahead():
    for apart in (3600 * S, -3600 * S):
        for burst in (1, 20):
            other = np.arange(1000) // burst % 2 == 1
            out = left_out(STAMPS + apart * other)
            assert 450 <= len(out) <= 550 and len(set(other[out].tolist())) == 1
