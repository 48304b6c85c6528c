# SPDX-License-Identifier: Apache-2.0
"""The backend against an emScon server that shares no code with it or with the emulator."""

import time

import numpy as np
from other_tracker import RADIUS, TURN, other_tracker, time_of

from otf_tracker_driver.backends import CommonConfig
from otf_tracker_driver.backends.base import joined
from otf_tracker_driver.backends.emscon import Emscon, EmsconConfig
from otf_tracker_driver.health import Beam

PATIENCE = 40.0
"""s"""
NEAR = 0.02
"""s; far from a third of a second, and from what a busy computer adds to all delays."""


def off(samples):
    """Stamps less the times that the points tell, s."""
    ahead = time.time_ns() - time.monotonic_ns()
    stamps = (samples.stamp_ns - ahead) / 1e9
    told = np.array([time_of(x, y) for x, y, _ in samples.xyz])
    return (stamps - told + TURN / 2) % TURN - TURN / 2


def test_another_server_is_set_up_followed_and_helped_after_a_broken_beam():
    with other_tracker() as tracker:
        backend = Emscon(CommonConfig(), EmsconConfig(port=tracker.port, reflector='CCR 1.5in'))
        try:
            said = backend.connect()
            assert 'emScon 3.8.1' in said and 'CCR 1.5in' in said and '710.0 mbar' in said
            backend.start()
            parts, seen, until = [], set(), time.monotonic() + PATIENCE
            while not backend.health.gaps:
                assert time.monotonic() < until, backend.trouble
                parts.append(backend.poll())
                seen.add(backend.health.beam)
                if sum(map(len, parts)) > 1000 and not backend.health.interruptions:
                    tracker.break_beam(0.5)
                time.sleep(0.005)
            samples = joined([*parts, backend.poll()])
            (gap,) = backend.health.gaps
        finally:
            backend.disconnect()
    assert {Beam.ON_TARGET, Beam.SEARCHING} <= seen
    assert 'beam lost' in gap.reason and 5e8 < gap.first_ns - gap.last_ns < 1e10
    assert np.all(np.diff(samples.stamp_ns) > 0)
    assert np.allclose(np.hypot(*samples.xyz[:, :2].T), RADIUS)
    assert np.abs(off(samples)).max() < NEAR
