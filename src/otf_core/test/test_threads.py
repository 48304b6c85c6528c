# SPDX-License-Identifier: Apache-2.0
"""Work side by side: results in order, no more threads at once than there are workers."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import otf_core
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


THREADS = """
import otf_core.cli, otf_core.cli.__main__

def used():
    import scipy.linalg, threadpoolctl
    found = [i for i in threadpoolctl.threadpool_info() if i['internal_api'] == 'openblas']
    return max((i['num_threads'] for i in found), default=1)

otf_core.cli.main = used
otf_core.cli.__main__.run()
"""
"""A command that ends with the number of threads as its exit code."""


@pytest.mark.parametrize('given', ['', '2'])
def test_command_begins_no_threads_of_linear_algebra_unless_it_is_told_to(given):
    pytest.importorskip('threadpoolctl', reason='optional: there is no rosdep key for it')
    environment = {k: v for k, v in os.environ.items() if k != 'OPENBLAS_NUM_THREADS'}
    environment |= {'PYTHONPATH': str(Path(otf_core.__file__).parents[1])}
    environment |= {'OPENBLAS_NUM_THREADS': given} if given else {}
    done = subprocess.run([sys.executable, '-c', THREADS], env=environment)
    assert done.returncode == min(int(given or 1), os.cpu_count())
