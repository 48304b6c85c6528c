# SPDX-License-Identifier: Apache-2.0
"""Sources of points as lines: a clock of their own, two unlike formats."""

import json
import math
import socket
import threading
import time
from contextlib import contextmanager, suppress

import yaml

CARTESIAN = {
    'source': 'tcp://127.0.0.1:1',
    'format': 'text',
    'separator': ';',
    'columns': {'x': 1, 'y': 2, 'z': 3},
    'length': 'mm',
    'stamp': 0,
    'time': 's',
}
"""Semicolons, millimetres, seconds."""
SPHERICAL = {
    'source': 'udp://127.0.0.1:1',
    'format': 'json',
    'keys': {'azimuth': 'pose.hz', 'zenith': 'pose.v', 'distance': 'pose.d'},
    'length': 'm',
    'angle': 'gon',
    'azimuth_sense': 'clockwise',
    'stamp': 't',
    'time': 'ms',
}
"""JSON, angles of a total station in gon, milliseconds."""
INTERVAL = 0.004
"""s"""


def described(folder, **changes):
    """Write a description; None takes a key away."""
    content = {k: v for k, v in {**CARTESIAN, **changes}.items() if v is not None}
    path = folder / 'source.yaml'
    path.write_text(yaml.safe_dump(content))
    return path


class Sender:
    """Sends points until it is stopped.

    Attributes
    ----------
    url : str
    sent : list of tuple
        Time of measurement on the sender's clock, s, and point, m.
    """

    def __init__(self, kind, look, close_after=None, lines=None):
        self._kind, self._look, self._lines = kind, look, lines
        self._close_after = close_after
        self._stop = threading.Event()
        self.sent = []
        if kind == 'tcp':
            self._socket = socket.create_server(('127.0.0.1', 0))
            port = self._socket.getsockname()[1]
        else:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
                free.bind(('127.0.0.1', 0))
                port = free.getsockname()[1]
            self._socket.connect(('127.0.0.1', port))
        self.url = f'{kind}://127.0.0.1:{port}'
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def stop(self):
        self._stop.set()
        if self._kind == 'tcp':
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join(10)
        self._socket.close()

    def _work(self):
        while not self._stop.is_set():
            if self._kind == 'udp':
                self._send(self._socket)
                continue
            with suppress(OSError):
                connection, _ = self._socket.accept()
                with connection:
                    self._send(connection)

    def _send(self, connection):
        begun, k = time.monotonic(), 0
        while not self._stop.is_set():
            k += 1
            self._stop.wait(max(0.0, begun + k * INTERVAL - time.monotonic()))
            if self._close_after and k * INTERVAL > self._close_after:
                return
            line = self._lines[k % len(self._lines)] if self._lines else self._line(k)
            try:
                connection.send(line.encode() + b'\n')
            except ConnectionRefusedError:  # nobody listens to datagrams yet
                continue
            except OSError:
                return

    def _line(self, k):
        t = 100.0 + k * INTERVAL
        x, y, z = 1.0 + 1e-3 * k, -0.5, 0.25
        self.sent.append((t, x, y, z))
        if self._look['format'] == 'text':
            return f'{t:.6f};{1e3 * x:.6f};{1e3 * y:.6f};{1e3 * z:.6f}'
        d = math.sqrt(x * x + y * y + z * z)
        hz, v = math.atan2(-y, x) * 200 / math.pi, math.acos(z / d) * 200 / math.pi
        return json.dumps({'t': round(1e3 * t), 'pose': {'hz': hz, 'v': v, 'd': d}})


@contextmanager
def sender(kind, look, **options):
    """Send points from a free port."""
    made = Sender(kind, look, **options)
    try:
        yield made
    finally:
        made.stop()
