# SPDX-License-Identifier: Apache-2.0
"""Work side by side: results in order, no more threads at once than there are workers."""

import threading

import pytest

from otf_core.threads import WORKERS, side_by_side


def test_what_is_side_by_side_within_another_adds_no_threads():
    seen, most, lock = set(), [], threading.Lock()

    def inner(item):
        with lock:
            seen.add(threading.get_ident())
            most.append(len(seen))
        return item

    def outer(item):
        return side_by_side(inner, [10 * item + k for k in range(5)])

    assert side_by_side(outer, [1, 2, 3, 4]) == [
        [10 * item + k for k in range(5)] for item in (1, 2, 3, 4)
    ]
    assert max(most) <= WORKERS and threading.get_ident() not in seen


def test_error_of_the_first_item_that_fails_is_raised():
    def fails(item):
        if item:
            raise ValueError(item)
        return item

    with pytest.raises(ValueError, match='1'):
        side_by_side(fails, [0, 1, 2])
