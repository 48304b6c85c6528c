# SPDX-License-Identifier: Apache-2.0
"""The tracker session against the emulator over real sockets, and against other servers."""

import contextlib
import socket
import threading
import time

import numpy as np
import pytest
from emulated import emulator

from otf_core.errors import OtfError
from otf_tracker_driver.backends import CommonConfig
from otf_tracker_driver.backends import emscon_link as codes
from otf_tracker_driver.backends.base import join_samples
from otf_tracker_driver.backends.emscon import Emscon, EmsconConfig, two_face_check

PATIENCE = 40.0
"""s"""
NEAR = 20.0
"""ms; far from a third of a second, and from what a busy computer adds to all delays."""


@pytest.fixture
def make():
    made = []

    def make(port, **given):
        made.append(Emscon(CommonConfig(), EmsconConfig(port=port, **given)))
        return made[-1]

    yield make
    for backend in made:
        backend.disconnect()


def until(condition, patience=PATIENCE):
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline, 'waited in vain'
        time.sleep(0.005)


def take(backend, count=1500, patience=PATIENCE):
    """Poll until so many samples are there."""
    parts = []

    def enough():
        parts.append(backend.poll())
        return sum(map(len, parts)) >= count

    until(enough, patience)
    return join_samples(parts)


def test_tracker_is_initialised_and_set_up_and_read_back(make):
    with emulator('initialize=0.5') as running:
        backend = make(running.port, reflector='CCR-1.5in', environment='21.5,990,40')
        said = backend.connect()
        assert all(word in said for word in ('EMULATED 7007', '3.6.0', 'CCR-1.5in', '990.0 mbar'))
        kept = running.tracker.device.kept
        assert running.tracker.device.initialised
        assert kept[codes.Command.GET_UNITS] == (0, 0, 0, 0, 0)
        assert kept[codes.Command.GET_COORDINATE_SYSTEM] == (0,)
        assert kept[codes.Command.GET_MEASUREMENT_MODE] == (1,)
        assert kept[codes.Command.GET_CONTINUOUS_TIME] == (2, 0, 0, 0)
        assert kept[codes.Command.GET_REFLECTOR] == (7,)
        assert kept[codes.Command.GET_SYSTEM_SETTINGS] == (0, 0, 0, 1, 1, 0, 0, 0, 0)


def test_tracker_that_is_busy_is_asked_again(make):
    with emulator('busy=0.6', seed=6) as running:
        backend = make(running.port, reflector='CCR-1.5in')
        backend.connect()
        until(lambda: not backend.preparing)
        assert backend.tracker.reflector == 'CCR-1.5in'


def test_tracker_that_initialises_for_long_is_waited_for_after_connect(make, monkeypatch):
    monkeypatch.setattr('otf_tracker_driver.backends.emscon.INITIALISED', 0.3)
    with emulator('initialize=1.5') as running:
        backend = make(running.port)
        backend.connect()
        assert 'initialises' in backend.preparing
        until(lambda: not backend.preparing)


@pytest.mark.parametrize('faults', ['', 'split,merge'])
def test_samples_have_the_time_at_which_they_were_measured(make, faults):
    with emulator(faults) as running:
        backend = make(running.port)
        backend.connect()
        for _ in range(2):
            backend.start()
            samples = take(backend)
            backend.stop()
            assert np.all(np.diff(samples.stamp_ns) > 0)
            assert np.abs(running.error_ms(samples)).max() < NEAR
            assert np.median(np.diff(samples.stamp_ns)) == pytest.approx(2e6, rel=2e-3)
        assert backend.trouble == '' and backend.health.clock.settled
        assert backend.health.clock.jumps == backend.health.interruptions == 0


def test_lost_beam_is_said_found_again_and_its_gap_is_marked(make):
    with emulator('beam_loss=0.2,beam_out=0.5', seed=3) as running:
        backend = make(running.port)
        backend.connect()
        backend.start()
        parts, said = [], []

        def found_again():
            parts.append(backend.poll())
            said.append(backend.trouble)
            return len(backend.health.gaps) >= 1

        until(found_again)
        samples = join_samples(parts)
        assert any('beam lost' in text and 'searches' in text for text in said)
        assert np.all(np.diff(samples.stamp_ns) > 0)
        assert np.abs(running.error_ms(samples)).max() < NEAR
        for last, first, reason in backend.health.gaps:
            assert reason.startswith('beam lost')
            assert {last, first} <= set(samples.stamp_ns.tolist())
            assert first - last > 5e8


def test_beam_is_not_searched_for_where_that_is_forbidden(make):
    with emulator() as running:
        backend = make(running.port, find_reflector=False)
        backend.connect()
        backend.start()
        until(lambda: 'bring the beam back' in backend.trouble)
        running.tracker.device.seen = True
        take(backend)


@pytest.mark.parametrize('faults', ['close_after=3', 'cut_after=3.5', 'silent=0.15'])
def test_stream_goes_on_after_the_connection_or_the_stream_broke_off(make, faults):
    with emulator(faults, seed=2) as running:
        backend = make(running.port)
        backend.connect()
        backend.start()
        samples, said = [], set()

        def gone_on():
            samples.append(backend.poll())
            said.add(backend.trouble)
            return len(backend.health.gaps) >= 1

        until(gone_on)
        samples = join_samples(samples)
        assert np.all(np.diff(samples.stamp_ns) > 0)
        assert len(said - {''}) >= 1


def test_samples_of_a_target_too_fast_and_unknown_packets_are_left_out_and_counted(make):
    with emulator('speed_exceeded=0.3,speed_warning=0.3,unknown=0.5') as running:
        backend = make(running.port)
        backend.connect()
        backend.start()
        samples = take(backend, 2500)
        assert np.abs(running.error_ms(samples)).max() < NEAR
        assert backend.left_out['target too fast'] >= 10
        assert backend.left_out['sample status 77'] >= 10


def test_samples_in_millimetres_never_pass(make):
    with emulator('foreign=0.15', seed=4) as running:
        backend = make(running.port)
        backend.connect()
        backend.start()
        parts, said = [], set()

        def changed():
            parts.append(backend.poll())
            said.add(backend.trouble)
            return backend.connections >= 3

        until(changed)
        samples = join_samples(parts)
        assert np.linalg.norm(samples.xyz, axis=1).max() < 2.0
        assert any('another program has changed the units' in text for text in said)


def test_clock_that_jumps_is_followed(make):
    with emulator('clock_jump=0.05', seed=5) as running:
        backend = make(running.port)
        backend.connect()
        backend.start()
        samples = take(backend, 5000)
        assert backend.health.clock.jumps >= 1
        assert np.all(np.diff(samples.stamp_ns) > 0)
        off = np.abs(running.error_ms(samples))
        assert np.mean(off < NEAR) > 0.8


def test_second_client_is_told_that_another_one_is_there(make):
    with emulator() as running:
        make(running.port).connect()
        with pytest.raises(OtfError, match=f'127.0.0.1:{running.port}: .*another client'):
            make(running.port).connect()


def test_tracker_is_told_to_stop_by_a_driver_that_ends(make):
    with emulator() as running:
        backend = make(running.port)
        backend.connect()
        backend.start()
        take(backend, 100)
        stopped = []
        running.tracker._stop, stop = lambda: (stopped.append(1), stop()), running.tracker._stop
        backend.disconnect()
        until(lambda: len(stopped) >= 2)  # by the command, and by the end of the connection


def test_unknown_reflector_is_refused_with_those_there_are(make):
    with emulator() as running:
        said = r"'CCR-1.5' is unknown .* mean CCR-1.5in\? possible: RRR-0.5in, CCR-1.5in, TBR"
        with pytest.raises(OtfError, match=said):
            make(running.port, reflector='CCR-1.5').connect()


def test_operations_while_no_stream_is_wanted(make):
    with emulator() as running:
        backend = make(running.port)
        backend.connect()

        def done(name, **own):
            return backend.operate(name, EmsconConfig(port=running.port, **own)).result(5)

        assert done('list_reflectors') == 'RRR-0.5in, CCR-1.5in, TBR-0.5in'
        assert done('set_reflector', reflector='TBR-0.5in') == 'TBR-0.5in'
        done('bird_bath')
        assert done('two_face_check').startswith('horizontal 12.00 urad, vertical -8.00 urad')
        assert running.tracker.device.face == 1
        done('find_reflector')
        done('clear_errors')
        backend.start()
        take(backend, 100)
        with pytest.raises(OtfError, match='is measuring; stop it first'):
            done('bird_bath')


@pytest.mark.parametrize('second', [(0.7 - 6e-6, 1.2 + 4e-6), (0.7 + np.pi, -1.2)])
def test_angles_of_the_second_face_may_be_those_of_its_circles(second):
    class Still:
        seen = iter([(0.7 + 6e-6, 1.2 - 4e-6), (second[0] % (2 * np.pi), second[1] % (2 * np.pi))])

        def ask(self, command, *_):
            return next(self.seen) if command == codes.Command.GET_DIRECTION else ()

    found = two_face_check(Still())
    expected = (6e-6, -4e-6) if second[1] > 0 else (3e-6, -2e-6)
    assert found == pytest.approx(expected, abs=1e-12)


def test_connecting_is_given_up_when_the_process_is_asked_to_end(make):
    with emulator('initialize=60') as running:
        backend = make(running.port)
        backend.cancelled = lambda: backend.initialising
        with pytest.raises(OtfError, match='connecting was stopped'):
            backend.connect()


def served(answer):
    """Port of a server that answers every connection in its own way, and how to end it."""
    listening = socket.create_server(('127.0.0.1', 0))

    def serve():
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            with connection:
                answer(connection)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    return listening


def greet(connection):
    connection.sendall(b'SSH-2.0-OpenSSH_9.6\r\n')
    connection.recv(100)


def close_at_once(connection):
    pass


def noise(connection):
    rng = np.random.default_rng(1)
    with contextlib.suppress(OSError):
        for _ in range(100):
            connection.sendall(rng.bytes(5000))


def say_nothing(connection):
    connection.settimeout(3)
    connection.recv(100)
    with contextlib.suppress(TimeoutError):
        connection.recv(100)


@pytest.mark.parametrize(
    ('answer', 'said'),
    [
        (greet, 'not an emScon packet'),
        (close_at_once, 'closed the connection|connection lost'),
        (noise, 'not an emScon packet'),
        (say_nothing, 'no answer|is it an emScon server'),
    ],
)
def test_other_servers_are_refused_in_one_line(make, monkeypatch, answer, said):
    monkeypatch.setattr('otf_tracker_driver.backends.emscon_link.ANSWER_WITHIN', 1.0)
    with served(answer) as listening:
        port = listening.getsockname()[1]
        backend = make(port)
        with pytest.raises(OtfError, match=said) as caught:
            backend.connect()
        assert '\n' not in str(caught.value) and f'127.0.0.1:{port}' in str(caught.value)


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        ({'host': ''}, 'host: empty'),
        ({'host': 'no.such.host.invalid'}, 'no.such.host.invalid:1: no connection'),
        ({'host': 'a' * 70}, 'no connection'),
        ({}, '127.0.0.1:1: no connection'),
        ({'interval': 0.0015}, 'interval: 0.0015 s; trackers take whole milliseconds'),
        ({'environment': '20,1013'}, 'environment: .*such as 20.0'),
        ({'environment': '20,101300,50'}, 'environment: .*pressure in mbar'),
    ],
)
def test_wrong_parameters_and_unreachable_hosts_are_said_in_one_line(make, given, said):
    with pytest.raises(OtfError, match=said) as caught:
        make(1, **given).connect()
    assert '\n' not in str(caught.value)
