# SPDX-License-Identifier: Apache-2.0
"""A backend in a process of its own, which a test may stop; what it gave is in a file at the end.

Run as ``python polled.py FILE BACKEND NAME=VALUE ...``; ends when its input ends.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np

from otf_tracker_driver.backends import BACKENDS, CommonConfig
from otf_tracker_driver.backends.base import join_samples


def poll(file, name, own):
    """Poll the backend until the input ends, then write what it gave and how it was."""
    kind = BACKENDS[name]
    backend = kind(CommonConfig(), kind.parameters(**own))
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    parts, said = [], {}
    backend.connect()
    while backend.preparing:
        time.sleep(0.01)
    backend.start()
    while not ended.is_set():
        parts.append(backend.poll())
        said.setdefault(backend.trouble)
        if sum(map(len, parts[-2:])):
            sys.stdout.write(f'{sum(map(len, parts))}\n')
            sys.stdout.flush()
        time.sleep(0.005)
    parts.append(backend.poll())
    health, samples = backend.health, join_samples(parts)
    backend.disconnect()
    words = {'said': list(said), 'gaps': len(health.gaps), 'left_out': health.left_out}
    words |= {'interruptions': health.interruptions}
    np.savez(file, stamp_ns=samples.stamp_ns, xyz=samples.xyz, words=json.dumps(words))


class Polled:
    """The process, from outside."""

    def __init__(self, file, name, own):
        arguments = [f'{key}={json.dumps(value)}' for key, value in own.items()]
        self._file = file
        self._process = subprocess.Popen(
            [sys.executable, __file__, str(file), name, *arguments],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._count = 0
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()

    def _read(self):
        for line in self._process.stdout:
            self._count = int(line)

    def wait_for(self, more, patience=40.0):
        """Wait until so many more samples have come."""
        wanted, until = self._count + more, time.monotonic() + patience
        while self._count < wanted:
            assert time.monotonic() < until and self._process.poll() is None
            time.sleep(0.01)

    def stand_still(self, lasting):
        """Stop the process for so many seconds."""
        os.kill(self._process.pid, signal.SIGSTOP)
        time.sleep(lasting)
        os.kill(self._process.pid, signal.SIGCONT)

    def end(self):
        """End it; return stamps, points, and what was said."""
        self._process.stdin.close()
        assert self._process.wait(20) == 0
        self._reading.join(10)
        self._process.stdout.close()
        with np.load(self._file) as got:
            words = json.loads(str(got['words']))
            return SimpleNamespace(stamp_ns=got['stamp_ns'], xyz=got['xyz'], **words)

    def kill(self):
        """End it whatever it does."""
        self._process.kill()
        self._process.wait()
        self._process.stdin.close()


@contextmanager
def polled(file, name, **own):
    """Poll a backend in another process until the block ends."""
    process = Polled(file, name, own)
    try:
        yield process
    finally:
        process.kill()


if __name__ == '__main__':
    given = (argument.partition('=') for argument in sys.argv[3:])
    poll(sys.argv[1], sys.argv[2], {key: json.loads(value) for key, _, value in given})
