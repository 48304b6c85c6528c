# SPDX-License-Identifier: Apache-2.0
"""The emulated tracker, asked by a client that knows nothing of the driver; and recorded facts."""

import asyncio
import math
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import emulator as emulator_module
import numpy as np
import pytest
from cells import write_machine
from emulated import DRIFT, cell, emulator
from emulator import Device, Faults, read_faults

from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.axis_path import AxisPath
from otf_core.model.machine import load_machine
from otf_core.model.plan import plan_along
from otf_tracker_driver.backends.emscon_link import Command

TRUNNION = Path(__file__).parents[2] / 'bags' / 'trunnion'
RECORDED = {5: (66, 67, 0.651), 10: (33, 34, 0.321), 20: (16, 17, 0.661)}
"""Samples per packet of recorded trackers, and the share of the larger, by ms between samples."""


class Client:
    """Asks in raw bytes."""

    def __init__(self, port):
        self._socket = socket.create_connection(('127.0.0.1', port), 10)
        self._buffer = b''
        self.unasked = []

    def packet(self):
        while len(self._buffer) < 8 or len(self._buffer) < self._size():
            chunk = self._socket.recv(4096)
            if not chunk:
                raise EOFError
            self._buffer += chunk
        size = self._size()
        packet, self._buffer = self._buffer[:size], self._buffer[size:]
        return packet

    def _size(self):
        return struct.unpack_from('<i', self._buffer)[0]

    def ask(self, command, arguments=b''):
        """Status and values of the answer; what comes before it is kept."""
        self._socket.sendall(struct.pack('<3i', 12 + len(arguments), 0, command) + arguments)
        while True:
            packet = self.packet()
            _, kind, number = struct.unpack_from('<3i', packet)
            if kind == 0 and number == command:
                return struct.unpack_from('<i', packet, 12)[0], packet[16:]
            self.unasked.append(packet)

    def measured(self):
        """Next packet of samples: rows of status, seconds, microseconds and values."""
        while True:
            packet = self.packet()
            if struct.unpack_from('<i', packet, 4)[0] in (3, 10):
                count = struct.unpack_from('<i', packet, 12)[0]
                stride = (len(packet) - 48) // max(count, 1)
                return [struct.unpack_from('<3i3d', packet, 48 + stride * k) for k in range(count)]
            self.unasked.append(packet)

    def close(self):
        self._socket.close()


@pytest.fixture
def client():
    with emulator('initialize=0.2') as running:
        made = Client(running.port)
        try:
            yield made
        finally:
            made.close()


def started(client, interval_ms=2):
    """Have it initialised, on target and measuring in metres."""
    assert client.ask(7)[0] == 0
    assert client.ask(5, struct.pack('<5i', 0, 0, 0, 0, 0))[0] == 0
    assert client.ask(24, struct.pack('<i', 1))[0] == 0
    assert client.ask(30, struct.pack('<4i', interval_ms, 0, 0, 0))[0] == 0
    assert client.ask(63, struct.pack('<d', 3.0))[0] == 0
    client.unasked.clear()
    assert client.ask(49)[0] == 0


def test_commands_are_refused_with_the_codes_of_the_protocol(client):
    assert client.ask(77)[0] == 2
    assert client.ask(49)[0] == 39
    assert client.ask(7)[0] == 0
    assert client.ask(49)[0] == 37
    assert client.ask(40, struct.pack('<i', 1234))[0] == 23
    assert client.ask(5, struct.pack('<5i', 0, 9, 0, 0, 0))[0] == 5
    assert client.ask(5, b'')[0] == 3


def test_measurement_starts_as_recorded_with_an_event_and_time_zero(client):
    started(client)
    assert [struct.unpack('<3i', packet) for packet in client.unasked] == [(12, 8, 12)]
    rows = client.measured() + client.measured()
    device = [s + 1e-6 * us for _, s, us, *_ in rows]
    assert device == pytest.approx(np.arange(len(rows)) * 0.002, abs=1e-9)
    assert {status for status, *_ in rows} == {0}


def test_samples_are_spherical_until_told_otherwise_and_have_the_units_that_are_set(client):
    started(client)
    horizontal, zenith, distance = client.measured()[0][3:]
    client.ask(52)
    client.ask(26, struct.pack('<i', 0))
    client.ask(5, struct.pack('<5i', 1, 0, 0, 0, 0))
    client.ask(49)
    client.measured()
    point = np.array(client.measured()[0][3:]) / 1e3
    assert np.linalg.norm(point) == pytest.approx(distance, abs=1e-4)
    assert math.atan2(point[1], point[0]) == pytest.approx(horizontal, abs=1e-4)
    assert math.acos(point[2] / distance) == pytest.approx(zenith, abs=1e-4)


def test_lost_beam_is_told_as_recorded_and_nothing_comes_after():
    with emulator('beam_loss=1,beam_out=0.3') as running:
        client = Client(running.port)
        started(client)
        while struct.unpack_from('<i', packet := client.packet(), 4)[0] != 1:
            pass
        assert struct.unpack('<4i', packet) == (16, 1, 64, 701)
        assert client.ask(49)[0] == 37 and not client.unasked[1:]
        assert client.ask(63, struct.pack('<d', 3.0))[0] in (0, 10004)
        time.sleep(0.4)
        assert client.ask(63, struct.pack('<d', 3.0))[0] == 0
        assert client.ask(49)[0] == 0
        client.close()


def test_reflector_that_is_moved_by_hand_is_found_again_at_the_next_target(monkeypatch):
    monkeypatch.setattr(emulator_module, 'BY_HAND', 1000)
    machine = load_machine(TRUNNION / 'machine.yaml')
    q = np.zeros((2, 2, 5))
    q[0, 1, 0], q[1, 1, 3] = 0.02, 0.02
    paths = [
        AxisPath(machine.axis_names, own, name)
        for own, name in zip(q, ('tool', 'nest-1'), strict=True)
    ]
    plan = plan_along(machine, paths, PlannerConfig())
    simulated = emulator_module.Cell(machine, PlannerConfig(), 1, DRIFT, None, plan)
    with emulator(simulated=simulated) as running:
        client = Client(running.port)
        started(client)
        while struct.unpack_from('<i', packet := client.packet(), 4)[0] != 1:
            pass
        assert struct.unpack('<4i', packet) == (16, 1, 64, 701)
        assert client.ask(63, struct.pack('<d', 3.0))[0] == 10004  # it is in somebody's hand
        until = time.monotonic() + 5.0
        while client.ask(63, struct.pack('<d', 3.0))[0] and time.monotonic() < until:
            pass
        count = len(running.true_ns)
        assert client.ask(49)[0] == 0
        while len(running.true_ns) < count + 100:
            client.packet()
        client.close()
    points = np.array([np.frombuffer(point) for point in running.true_ns])
    assert np.linalg.norm(points[:count] - points[0], axis=1).max() < 0.021
    assert np.linalg.norm(points[count:] - points[-1], axis=1).max() < 0.021
    assert np.linalg.norm(points[-1] - points[0]) > 0.05


def test_server_says_that_it_closes():
    with emulator('close_after=0.5') as running:
        client = Client(running.port)
        assert struct.unpack('<3i', client.packet()) == (12, 8, 998)
        with pytest.raises(EOFError):
            client.packet()
        client.close()


@pytest.mark.parametrize('interval_ms', RECORDED)
def test_packets_hold_as_many_samples_as_recorded_ones(monkeypatch, interval_ms):
    sizes, packets = Counter(), 600
    device = Device()
    device.kept[Command.GET_CONTINUOUS_TIME] = (interval_ms, 0, 0, 0)

    async def no_sleep(_):
        if sizes.total() >= packets:
            raise asyncio.CancelledError

    def count(packet):
        sizes[struct.unpack_from('<i', packet, 12)[0]] += 1

    monkeypatch.setattr(emulator_module, '_until', no_sleep)
    made = emulator_module.Measuring(
        device, cell(), emulator_module.Drive(), DRIFT, Faults(), random.Random(1), count
    )
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(made.run())
    less, more, share = RECORDED[interval_ms]
    assert set(sizes) == {less, more}
    assert sizes[more] / packets == pytest.approx(share, abs=0.02)


def test_faults_are_read_and_mistakes_named():
    faults = read_faults('beam_loss=0.01,split, merge ,close_after=20')
    assert (faults.beam_loss, faults.split, faults.merge, faults.close_after) == (0.01, 1, 1, 20)
    for spec, said in (
        ('bem_loss=1', "'bem_loss' is unknown; did you mean beam_loss"),
        ('split=2', 'split: 2 is out of range'),
        ('split=x', "split: 'x' is not a number"),
    ):
        with pytest.raises(ConfigError, match=f'--faults: {said}'):
            read_faults(spec)


def run(*arguments):
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, str(Path(emulator_module.__file__)), *arguments]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_command_says_where_it_listens_and_ends_when_interrupted(tmp_path):
    machine = str(write_machine(tmp_path))
    with run('--machine', machine, '--port', '0', '--passes', '1', '--levels', '2') as process:
        where = process.stdout.readline()
        assert where.startswith('listening on 127.0.0.1:')
        client = Client(int(where.rpartition(':')[2]))
        assert client.ask(1)[0] == 0
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
        assert process.stderr.read() == ''
        client.close()


@pytest.mark.parametrize(
    ('arguments', 'code', 'said'),
    [
        (['--faults', 'splt'], 2, "'splt' is unknown"),
        (['--machine', 'none.yaml'], 2, 'none.yaml: cannot be read'),
        (['--port', '70000'], 3, 'cannot listen on 127.0.0.1:70000'),
        (['--passes', '0'], 2, 'passes: 0 is out of range'),
    ],
)
def test_command_says_mistakes_in_one_line(tmp_path, arguments, code, said):
    machine = str(write_machine(tmp_path))
    given = ['--machine', machine, '--levels', '2', '--passes', '1', *arguments]
    with run(*given) as process:
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err.count('\n')) == (code, '', 1)
    assert err.startswith('error: ') and said in err
