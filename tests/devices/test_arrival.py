# SPDX-License-Identifier: Apache-2.0
"""Bytes that are read late carry the time at which they arrived."""

import socket
import time

import pytest

from otf_tracker_driver.clock import Arrivals

LATE = 0.08
"""s; between arrival and reading."""

LEAST = 0.9 * LATE * 1e9
"""ns"""
STARTING = 20
"""Packets until the kernel stamps them, which it begins to do after it is asked, at the most."""


def pair(kind):
    """Two connected sockets of this computer, the second one with the arrivals at it."""
    listening = socket.socket(socket.AF_INET, kind)
    listening.bind(('127.0.0.1', 0))
    sender = socket.socket(socket.AF_INET, kind)
    if kind == socket.SOCK_STREAM:
        listening.listen()
        sender.connect(listening.getsockname())
        receiver, _ = listening.accept()
        listening.close()
    else:
        receiver = listening
        sender.connect(listening.getsockname())
    return sender, receiver, Arrivals(receiver)


@pytest.mark.parametrize('kind', [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_age_of_what_is_read_late_is_told(kind):
    sender, receiver, arrivals = pair(kind)
    with sender, receiver:
        for _ in range(STARTING):
            before = time.monotonic_ns()
            sender.send(b'packet')
            time.sleep(LATE)
            data, age, _ = arrivals.receive(100)
            longest = time.monotonic_ns() - before
            if age > LEAST:
                break
    assert data == b'packet'
    assert LEAST < age <= 1.01 * longest  # the time of day may be slewed


@pytest.mark.parametrize('step', [-3600, 3600])
def test_time_of_day_that_is_set_makes_no_age(monkeypatch, step):
    sender, receiver, arrivals = pair(socket.SOCK_STREAM)
    with sender, receiver:
        sender.send(b'packet')
        now = time.time_ns()
        monkeypatch.setattr(time, 'time_ns', lambda: now + step * 10**9)
        assert arrivals.receive(100)[:2] == (b'packet', 0)


def test_age_holds_after_a_process_has_stood_still_for_long(monkeypatch):
    sender, receiver, arrivals = pair(socket.SOCK_STREAM)
    with sender, receiver:
        for _ in range(STARTING):
            sender.send(b'packet')
            time.sleep(LATE)
            if arrivals.receive(100)[1]:
                break
        sender.send(b'packet')
        now, monotonic, still = time.time_ns(), time.monotonic_ns(), 60 * 10**9
        monkeypatch.setattr(time, 'time_ns', lambda: now + still)
        monkeypatch.setattr(time, 'monotonic_ns', lambda: monotonic + still)
        assert arrivals.receive(100)[1] == pytest.approx(still, rel=0.01)
