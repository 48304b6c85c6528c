# SPDX-License-Identifier: Apache-2.0
"""How far stamps are off the true times of measurement, by delays of the packets.

Usage: PYTHONPATH=src/otf_core:src/otf_tracker_driver python3 bench/tracker_clock.py [SEED]
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'tests'))
from device_times import EPOCH, Delays, packets

from otf_core.model.observation import Samples
from otf_tracker_driver.clock import Stamper

RUNS, LENGTH, DRIFT = 8, 240.0, 18e-6


def errors(seed, delays):
    """Time since the start, s, and error of every stamp, ms."""
    stamper, parts = Stamper(), []
    for device, true, arrival in packets(seed, LENGTH, DRIFT, delays=delays):
        xyz = np.zeros((len(device), 3))
        xyz[:, 0] = true - EPOCH
        parts += stamper.take(device, xyz, arrival)
    parts += stamper.flush()
    whole = Samples(*(np.concatenate([getattr(p, n) for p in parts]) for n in ('stamp_ns', 'xyz')))
    since = whole.xyz[:, 0]
    return since / 1e9, (whole.stamp_ns - EPOCH - since) / 1e6


def main(first=300):
    """Print the worst stamp of all runs, of the whole and after the first minute."""
    for mean in (1e-3, 2e-3, 5e-3):
        whole, later = [], []
        for seed in range(first, first + RUNS):
            since, off = errors(seed, Delays(mean))
            whole.append(np.abs(off).max())
            later.append(np.abs(off)[since > 60].max())
        print(f'delays of {1e3 * mean:g} ms, ms off: {summary(whole)}; later {summary(later)}')


def summary(worst):
    """Largest and median of the worst stamps of all runs."""
    return f'{max(worst):.2f} at worst, {np.median(worst):.2f} in the median run'


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
