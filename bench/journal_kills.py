# SPDX-License-Identifier: Apache-2.0
"""Journal under kill -9 at random moments, 1000 samples/s: how old is the oldest sample lost?

python3 bench/journal_kills.py [KILLS] [SEED]
"""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from otf_core.bags.bag import read_points
from otf_core.bags.journal import Journal

RATE, BATCH = 1000, 20
LONGEST = 5.0
"""s after the start at which a process is killed at the latest."""


def feed(folder: Path) -> None:
    """Give a journal what a tracker gives, and tell when which sample was given."""
    journal, count = Journal(folder, {}), 0
    rng, begun = np.random.default_rng(0), time.monotonic()
    while True:
        stamp_ns = (10**9 + count + np.arange(BATCH)) * (10**9 // RATE)
        journal.points(stamp_ns, rng.normal(size=(BATCH, 3)), 'tracker')
        count += BATCH
        print(count, time.monotonic(), flush=True)
        time.sleep(max(0.0, begun + count / RATE - time.monotonic()))


def killed(after: float) -> tuple[float, int]:
    """Kill a feeding process; return the age of the oldest sample lost, s, and their number."""
    with tempfile.TemporaryDirectory() as name:
        command = [sys.executable, __file__, '--feed', name]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(after)
            moment = time.monotonic()
            process.send_signal(signal.SIGKILL)
            rows = [line.split() for line in process.stdout.read().splitlines()]
        given = [(int(row[0]), float(row[1])) for row in rows if len(row) == 2]
        (run,) = (p for p in Path(name).iterdir() if p.is_dir())
        found = len(read_points(run))
    lost = [at for count, at in given if count > found]
    return (moment - lost[0] if lost else 0.0), (given[-1][0] - found if given else 0)


def main() -> int:
    """Kill again and again; tell the worst."""
    if sys.argv[1:2] == ['--feed']:
        feed(Path(sys.argv[2]))
    logging.disable()
    kills = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    rng = np.random.default_rng(int(sys.argv[2]) if len(sys.argv) > 2 else 20261122)
    found = [killed(after) for after in rng.uniform(1.0, LONGEST, kills)]
    ages = [1e3 * age for age, _ in found]
    print(
        f'{kills} kills: the oldest sample lost was {max(ages):.0f} ms old, '
        f'{np.median(ages):.0f} ms in the median; at most {max(n for _, n in found)} lost'
    )
    return 0 if max(ages) < 500 else 1


if __name__ == '__main__':
    raise SystemExit(main())
