# SPDX-License-Identifier: Apache-2.0
"""Hints: what was begun ahead is the same call, and what nobody asks for leaves nothing behind."""

import os
import sys
import time

import numpy as np
import pytest

from otf_core.ahead import Ahead

COPIES = sys.platform == 'linux' and len(os.sched_getaffinity(0)) > 1
needs_copies = pytest.mark.skipif(not COPIES, reason='no second process here')


@needs_copies
def test_a_call_that_was_begun_is_made_in_another_process_and_others_are_made_here():
    with Ahead() as ahead:
        ahead.begin(os.getppid)
        assert ahead(os.getppid) == os.getpid()
        assert ahead(os.getpid) == os.getpid()


def test_the_result_is_the_same_with_the_hint_and_without():
    values = np.arange(6.0).reshape(2, 3)
    with Ahead() as ahead:
        without = ahead(np.dot, values, values.T)
        ahead.begin(np.dot, values, values.T)
        hinted = ahead(np.dot, values, values.T)
    np.testing.assert_array_equal(hinted, without)


def test_equal_arguments_that_are_not_the_same_are_another_call():
    mine, other = [os.getpid()], [os.getpid()]
    with Ahead() as ahead:
        ahead.begin(list, mine)
        assert ahead(list, other) == other


def test_errors_come_where_the_result_is_asked_for():
    with Ahead() as ahead:
        ahead.begin(divmod, 1, 0)
        with pytest.raises(ZeroDivisionError):
            ahead(divmod, 1, 0)


@needs_copies
def test_what_nobody_asks_for_is_given_up():
    start = time.monotonic()
    with Ahead() as ahead:
        ahead.begin(time.sleep, 600.0)
    assert time.monotonic() - start < 60.0
