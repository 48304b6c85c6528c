# SPDX-License-Identifier: Apache-2.0
"""A driver whose process stands still loses nothing that TCP keeps, and blames nobody."""

import socket

import numpy as np
import pytest
from other_tracker import RADIUS, other_tracker, time_of
from polled import polled
from streaming import CARTESIAN, INTERVAL, described, sender
from test_other_tracker import off

from otf_tracker_driver.backends.lines import Source, open_source

SENT = 20_000
"""Datagrams of a kilobyte, more than any buffer holds."""
STEP = 2_000_000
"""ns; from sample to sample of the tracker."""
FIRST = 'no reflector in the beam'
"""Said before the stream flows: the tracker has to find it."""
NEAR = 0.02
"""s; far from how long the process stands still."""


def test_no_sample_of_a_tracker_is_lost_while_the_process_stands_still(tmp_path):
    lasting = 5.0
    with (
        other_tracker() as tracker,
        polled(tmp_path / 'got.npz', 'emscon', port=tracker.port, reflector='CCR 1.5in') as driver,
    ):
        driver.wait_for(1000)
        driver.stand_still(lasting)
        driver.wait_for(500 * lasting + 500)
        got = driver.end()
    turned = np.unwrap([time_of(x, y) for x, y, _ in got.xyz], period=40.0)
    assert np.diff(turned) * 1e9 == pytest.approx(np.full(len(turned) - 1, STEP), abs=1e3)
    assert np.diff(got.stamp_ns) == pytest.approx(np.full(len(turned) - 1, STEP), rel=0.01)
    assert np.abs(off(got)).max() < NEAR
    assert np.allclose(np.hypot(*got.xyz[:, :2].T), RADIUS)
    assert [text for text in got.said if text and not text.startswith(FIRST)] == []
    assert not got.left_out and got.gaps == got.interruptions == 0


def test_no_point_of_a_stream_is_lost_while_the_process_stands_still(tmp_path):
    lasting = 4.0
    with sender('tcp', CARTESIAN) as source:
        path = described(tmp_path, source=source.url)
        with polled(tmp_path / 'got.npz', 'stream', source=str(path)) as driver:
            driver.wait_for(1000)
            driver.stand_still(lasting)
            driver.wait_for(lasting / INTERVAL + 200)
            got = driver.end()
    assert np.diff(got.xyz[:, 0]) == pytest.approx(np.full(len(got.xyz) - 1, 1e-3), abs=1e-8)
    assert np.diff(got.stamp_ns) == pytest.approx(np.full(len(got.xyz) - 1, 4e6), rel=0.01)
    assert got.said == [''] and not got.left_out and got.gaps == got.interruptions == 0


def test_datagrams_that_found_no_room_are_counted():
    filler = ' ' * 1000
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(('127.0.0.1', 0))
            port = free.getsockname()[1]
        source.connect(('127.0.0.1', port))
        transport = open_source(Source('udp', '127.0.0.1', port))
        try:
            for k in range(SENT):
                source.send(f'{k};1;2;3{filler}'.encode())
            got = 0
            while transport.receive(0.1):
                got += 1
            source.send(b'last')
            assert transport.receive(1.0) == b'last'
            assert 0 < got < SENT and transport.dropped == SENT - got
        finally:
            transport.close()
