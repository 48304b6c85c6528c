# SPDX-License-Identifier: Apache-2.0
"""Packets of a device whose clock runs at its own rate, with the true time of every sample."""

from dataclasses import dataclass

import numpy as np

EPOCH = 1_750_000_000 * 10**9
PERIOD = 0.3332065
"""s; from packet to packet on the device's clock, as recorded."""


@dataclass(frozen=True)
class Delays:
    """Exponential delays of a mean, and a share of packets that are late by up to ``late``."""

    mean: float = 2e-3
    share: float = 0.01
    late: float = 0.06

    def draw(self, rng):
        extra = rng.uniform(0, self.late) if rng.random() < self.share else 0.0
        return rng.exponential(self.mean) + extra


def packets(seed, duration, drift, interval=0.002, delays=None, jumps=()):
    """Yield device time, true time, arrival of one packet after another, in ns.

    ``jumps`` are pairs of true time and what the device's clock jumps ahead then, s.
    """
    rng, delays = np.random.default_rng(seed), delays or Delays()
    sample = np.arange(0, duration * (1 + drift), interval)
    true = sample / (1 + drift)
    device = sample.copy()
    for at, ahead in jumps:
        device[true >= at] += ahead
    ends = np.arange(PERIOD, duration, PERIOD) / (1 + drift)
    arrival = 0.0
    for first, last in zip(np.r_[0.0, ends[:-1]], ends, strict=True):
        chosen = (true >= first) & (true < last)
        arrival = max(arrival, last + delays.draw(rng))
        ns = [np.rint(values * 1e9).astype(np.int64) for values in (device, true)]
        yield ns[0][chosen], EPOCH + ns[1][chosen], EPOCH + round(arrival * 1e9)
