# SPDX-License-Identifier: Apache-2.0
"""Work that another process does while this one goes on."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from otf_core.aside import Aside, share_out

COPIES = sys.platform == 'linux' and len(os.sched_getaffinity(0)) > 1
copies = pytest.mark.skipif(not COPIES, reason='no second process here')


def runs(process):
    """Tell whether a process is there and has not ended."""
    try:
        state = Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()[0]
    except OSError:
        return False
    return state != 'Z'


@copies
def test_work_is_done_by_another_process():
    with Aside(os.getpid) as other:
        assert other.result() != os.getpid()
        assert other.result() == other.result()


@copies
def test_what_a_killed_process_did_not_send_is_done_here():
    here = os.getpid()

    def killed():
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return 'done'

    with Aside(killed) as other:
        assert other.result() == 'done'


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


@pytest.mark.parametrize('count', [0, 1, 2, 3, 500])
def test_results_come_in_the_order_of_the_items(count):
    assert share_out(lambda k: 3 * k, range(count)) == [3 * k for k in range(count)]
