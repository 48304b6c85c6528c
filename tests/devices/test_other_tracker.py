# SPDX-License-Identifier: Apache-2.0
"""The backend against an emScon server that shares no code with it or with the emulator."""

import time

import numpy as np
import pytest
from other_tracker import RADIUS, TURN, other_tracker, time_of

from otf_core.errors import OtfError
from otf_tracker_driver.backends import CommonConfig
from otf_tracker_driver.backends.base import Beam, Flow, join_samples
from otf_tracker_driver.backends.emscon import Emscon, EmsconConfig

PATIENCE = 40.0
"""s"""
NEAR = 0.02
"""s; far from a third of a second, and from what a busy computer adds to all delays."""


SILENCES = (1.0, 2.0, 4.0)
"""s; before the measurement of a silent tracker is started again."""


def off(samples):
    """Stamps less the times that the points tell, s."""
    ahead = time.time_ns() - time.monotonic_ns()
    stamps = (samples.stamp_ns - ahead) / 1e9
    told = np.array([time_of(x, y) for x, y, _ in samples.xyz])
    return (stamps - told + TURN / 2) % TURN - TURN / 2


def until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, 'waited in vain'
        time.sleep(0.005)


def test_another_server_is_set_up_followed_and_helped_after_a_broken_beam():
    with other_tracker() as tracker:
        backend = Emscon(CommonConfig(), EmsconConfig(port=tracker.port, reflector='CCR 1.5in'))
        try:
            said = backend.connect()
            assert 'emScon 3.8.1' in said and 'CCR 1.5in' in said and '710.0 mbar' in said
            backend.start()
            parts, seen, until = [], set(), time.monotonic() + PATIENCE
            broken = False
            while not backend.health.gaps:
                assert time.monotonic() < until, backend.trouble
                parts.append(backend.poll())
                seen.add(backend.health.beam)
                if sum(map(len, parts)) > 1000 and not broken:
                    assert backend.health.interruptions == 0
                    broken = True
                    tracker.break_beam(0.5)
                time.sleep(0.005)
            samples = join_samples([*parts, backend.poll()])
            (gap,) = backend.health.gaps
            assert backend.health.interruptions == 1
        finally:
            backend.disconnect()
    assert {Beam.ON_TARGET, Beam.SEARCHING} <= seen
    assert 'beam lost' in gap.reason and 5e8 < gap.first_ns - gap.last_ns < 1e10
    assert np.all(np.diff(samples.stamp_ns) > 0)
    assert np.allclose(np.hypot(*samples.xyz[:, :2].T), RADIUS)
    assert np.abs(off(samples)).max() < NEAR


@pytest.fixture
def connected():
    made = []

    def connected(tracker):
        own = EmsconConfig(port=tracker.port, reflector='CCR 1.5in')
        made.append(Emscon(CommonConfig(), own))
        made[-1].connect()
        return made[-1]

    yield connected
    for backend in made:
        backend.disconnect()


def test_settings_that_are_acknowledged_and_not_kept_are_warned_of_where_they_move_nothing(
    connected,
):
    with other_tracker(keeps=False) as tracker:
        backend = connected(tracker)
        warnings = backend.health.warnings
        assert any('transformation' in text and 'identity' in text for text in warnings)
        assert any('station orientation' in text for text in warnings)
        assert all(text in backend.remark for text in warnings)
        backend.start()
        until(lambda: len(backend.poll()))


def test_transformation_that_stays_on_and_moves_samples_is_refused_by_its_name(connected):
    with (
        other_tracker(keeps=False, moved=0.1) as tracker,
        pytest.raises(
            OtfError, match=r'setting transformation \(command 47\) .*stays at 1.*reset'
        ),
    ):
        connected(tracker)


def test_silence_is_one_state_whose_restarts_grow_apart_and_are_counted(connected):
    with other_tracker(silent=True) as tracker:
        backend = connected(tracker)
        backend.start()
        kinds = set()

        def restarted():
            kinds.add(backend.hindrance.kind)
            return len(tracker.starts) > len(SILENCES)

        until(restarted)
        until(lambda: backend.hindrance.restarts == len(SILENCES))
        # STARTING lasts for a moment, in which a busy computer may not look
        assert kinds - {Flow.STARTING} == {Flow.BEAM_BROKEN, Flow.SILENT}
        assert 'sends nothing' in backend.trouble
        assert np.all(np.diff(tracker.starts) > SILENCES)
        assert backend.health.interruptions == 0 and not backend.health.gaps
        tracker.silent = False
        until(lambda: len(backend.poll()))
        assert backend.hindrance is None
        tracker.silent = True
        until(lambda: backend.hindrance)
        tracker.silent = False
        until(lambda: backend.health.gaps)
        assert backend.health.interruptions == 1
