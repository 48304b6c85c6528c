# SPDX-License-Identifier: Apache-2.0
"""Work that another process does while this one goes on."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from otf_core.aside import Aside, share_out
from otf_core.effects import REGISTRY
from otf_core.effects.free import Free
from otf_core.effects.free_form import FreeForm

COPIES = sys.platform == 'linux' and len(os.sched_getaffinity(0)) > 1
copies = pytest.mark.skipif(not COPIES, reason='no second process here')


def children():
    """Processes that this one has started and not yet seen ending."""
    with open(f'/proc/self/task/{os.getpid()}/children') as file:
        return file.read().split()


def runs(process):
    """Tell whether a process is there and has not ended."""
    try:
        state = Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()[0]
    except OSError:
        return False
    return state != 'Z'


class Odd:
    """Something that can be told from its copies."""


@copies
def test_work_is_done_by_another_process():
    with Aside(os.getpid) as other:
        assert other.result() != os.getpid()
        assert other.result() == other.result()


def test_what_was_not_begun_is_done_here():
    assert Aside(os.getpid).result() == os.getpid()


def test_an_error_is_raised_where_the_result_is_asked_for():
    def fails():
        raise ValueError('no such thing')

    with Aside(fails) as other, pytest.raises(ValueError, match='no such thing'):
        other.result()


@copies
def test_what_a_killed_process_did_not_send_is_done_here():
    here = os.getpid()

    def killed():
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return 'done'

    with Aside(killed) as other:
        assert other.result() == 'done'


def test_what_cannot_be_sent_is_done_here():
    with Aside(lambda: lambda: 3) as other:
        assert other.result()() == 3


@copies
def test_work_that_is_not_asked_for_ends_with_its_context():
    before = children()
    with Aside(partial(time.sleep, 600.0)):
        assert len(children()) == len(before) + 1
    assert children() == before


@copies
def test_work_ends_with_the_process_that_wants_it():
    code = (
        'import functools, os, signal, time\n'
        'from otf_core.aside import Aside\n'
        'with Aside(functools.partial(time.sleep, 600.0)) as other:\n'
        '    print(other._process.pid, flush=True)\n'
        '    time.sleep(0.3)\n'
        '    os.kill(os.getpid(), signal.SIGKILL)\n'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    end = time.monotonic() + 10.0
    while runs(int(done.stdout)):
        assert time.monotonic() < end, 'the copy is still there'
        time.sleep(0.05)
    assert done.returncode == -signal.SIGKILL


@copies
def test_what_is_known_is_not_copied():
    known, unknown = Odd(), Odd()
    with Aside(lambda: (known, unknown, [known]), [known]) as other:
        first, second, (third,) = other.result()
    assert first is known and third is known
    assert isinstance(second, Odd) and second is not unknown


@dataclass(frozen=True)
class Holder:
    """Something that holds others."""

    odd: Odd
    more: tuple


@copies
def test_what_is_within_the_known_is_not_copied_either():
    known = Holder(Odd(), ([Odd()], {'key': Odd()}))
    with Aside(
        lambda: (known.odd, known.more[0][0], known.more[1]['key'], Odd()), [known]
    ) as other:
        *within, new = other.result()
    assert within[0] is known.odd and within[1] is known.more[0][0]
    assert within[2] is known.more[1]['key'] and isinstance(new, Odd)


@copies
def test_arrays_come_back_bit_by_bit():
    values = np.random.default_rng(3).normal(size=(400, 300))
    with Aside(lambda: values @ values.T) as other:
        assert np.array_equal(other.result(), values @ values.T)


@copies
def test_work_aside_starts_no_further_process():
    def inner():
        with Aside(os.getpid) as third:
            return third.result() == os.getpid()

    with Aside(inner) as other:
        assert other.result()


def test_a_thread_beside_others_makes_no_copy():
    found = []

    def work():
        with Aside(os.getpid) as other:
            found.append(other.result())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [os.getpid()]


@pytest.mark.parametrize('count', [0, 1, 2, 3, 500])
def test_results_come_in_the_order_of_the_items(count):
    assert share_out(lambda k: 3 * k, range(count)) == [3 * k for k in range(count)]


@copies
def test_two_processes_share_the_work(tmp_path):
    end = time.monotonic() + 30.0

    def who(item):  # waits for the other one
        (tmp_path / str(os.getpid())).touch()
        while len(list(tmp_path.iterdir())) < 2 and time.monotonic() < end:
            time.sleep(0.01)
        return os.getpid()

    found = share_out(who, range(40))
    assert len(set(found)) == 2 and os.getpid() in found


@copies
def test_items_of_a_process_that_was_killed_are_done_here():
    here = os.getpid()

    def dies(item):
        time.sleep(0.02)
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return item

    assert share_out(dies, range(10)) == list(range(10))


def test_an_error_in_an_item_is_raised_here():
    with pytest.raises(ZeroDivisionError):
        share_out(lambda k: 1 / (k - 5), range(10))


@copies
@pytest.mark.parametrize('name', sorted(REGISTRY))
def test_free_forms_come_back_as_the_same(name):
    made = FreeForm(REGISTRY[name], Free(('time',), (3,)), {'time': (0.0, 9.0)})
    with Aside(lambda: made, [REGISTRY[name]]) as other:
        found = other.result()
    assert found == made and found.parent is REGISTRY[name]
    assert vars(found).keys() == vars(made).keys()
