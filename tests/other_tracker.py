# SPDX-License-Identifier: Apache-2.0
"""A second emScon server, written from the published description of the protocol alone.

Nothing here is shared with ``otf_tracker_driver``: layouts are offsets and numbers, one blocking
thread serves one client. Its target runs on a circle, so every point tells when it was measured.
"""

import math
import select
import socket
import struct
import threading
import time
from contextlib import contextmanager

RADIUS, TURN, HEIGHT = 1.5, 40.0, 0.25
"""m, s, m; of the circle about the tracker that the target runs on, and its height."""
GETS = {6: 5, 25: 24, 27: 26, 31: 30, 41: 40, 48: 47, 21: 20, 81: 80}
"""Commands that get what others set."""
EVENTS = {5: 6, 20: 2, 24: 17, 26: 12, 30: 19, 40: 7, 47: 8}
"""Events that settings give."""
NAMES = {11: 'TBR 0.5in', 12: 'CCR 1.5in'}
BEAM_LOST, NOT_READY, UNKNOWN = 701, 10014, 2


def text(value):
    return value.encode('utf-16-le').ljust(64, b'\0')


def point(at):
    """Where the target is at a time, s, m."""
    angle = 2 * math.pi * at / TURN
    return RADIUS * math.cos(angle), RADIUS * math.sin(angle), HEIGHT


def time_of(x, y):
    """When the target was there within its turn, s."""
    return math.atan2(y, x) % (2 * math.pi) * TURN / (2 * math.pi)


class OtherTracker:
    """Serves until closed; ``break_beam`` holds the beam off for a moment.

    Parameters
    ----------
    keeps : bool
        False: system settings (47) are acknowledged and not kept.
    moved : float, m
        Along x, of the transformation that is set.
    silent : bool
        Measurements are started, and nothing is sent.
    port : int
        0: any.
    """

    def __init__(self, keeps=True, moved=0.0, silent=False, port=0):
        self._keeps, self._moved, self.silent = keeps, moved, silent
        self.starts = []
        self._listening = socket.create_server(('127.0.0.1', port))
        self.port = self._listening.getsockname()[1]
        self._stop = threading.Event()
        self._set = {
            5: struct.pack('<5i', 1, 2, 0, 3, 0),
            20: struct.pack('<3d', 22.0, 710.0, 33.0),
            24: struct.pack('<i', 0),
            26: struct.pack('<i', 6),
            30: struct.pack('<4i', 50, 0, 0, 0),
            40: struct.pack('<i', 11),
            47: struct.pack('<9i', 1, 1, 1, 1, 0, 1, 1, 0, 0),
            80: struct.pack('<2i', 0, 1),
        }
        self._ready, self._seen, self._off_until = False, False, 0.0
        self._began = self._sent = None
        self._client = None
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def break_beam(self, lasting):
        self._off_until = time.monotonic() + lasting

    def close(self):
        self._stop.set()
        self._thread.join(10)
        self._listening.close()

    def _serve(self):
        while not self._stop.is_set():
            if select.select([self._listening], [], [], 0.05)[0]:
                self._client, _ = self._listening.accept()
                with self._client:
                    self._attend()
                self._began = None

    def _attend(self):
        waiting = b''
        while not self._stop.is_set():
            if select.select([self._client], [], [], 0.01)[0]:
                chunk = self._client.recv(4096)
                if not chunk:
                    return
                waiting += chunk
            while len(waiting) >= 4 and len(waiting) >= struct.unpack_from('<i', waiting)[0]:
                size, _, command = struct.unpack_from('<3i', waiting)
                self._obey(command, waiting[12:size])
                waiting = waiting[size:]
            self._measure()

    def _send(self, kind, body):
        self._client.sendall(struct.pack('<2i', 8 + len(body), kind) + body)

    def _answer(self, command, values=b'', status=0):
        self._send(0, struct.pack('<2i', command, status) + values)

    def _obey(self, command, values):
        if command in self._set:
            if command != 47 or self._keeps:
                self._set[command] = values
            self._answer(command)
            if command in EVENTS:
                self._send(8, struct.pack('<i', EVENTS[command]))
        elif command in GETS:
            self._answer(command, self._set[GETS[command]])
        elif command == 1:
            self._answer(
                1, struct.pack('<10i', 0, 5 if self._ready else 4, 3, 0, 3, 8, 1, 1, 0, 99)
            )
        elif command == 7:
            time.sleep(0.2)
            self._ready = True
            self._answer(7)
        elif command == 13:
            self._answer(13, bytes(48))
        elif command == 15:
            self._answer(15, struct.pack('<7d', self._moved, 0, 0, 0, 0, 0, 1))
        elif command == 42:
            for number, name in NAMES.items():
                head = struct.pack('<3id', len(NAMES), number, 5, 0.0)
                self._answer(42, head + text(name))
        elif command == 122:
            self._answer(122, struct.pack('<2i', 0, 1 | (2048 if self._seen else 0)))
        elif command in (54, 63):
            self._seen = time.monotonic() > self._off_until
            self._answer(command, status=0 if self._seen else NOT_READY)
        elif command == 49:
            self._answer(49, status=0 if self._seen else NOT_READY)
            self._began, self._sent = time.monotonic(), 0
            self.starts.append(self._began)
        elif command == 52:
            self._began = None
            self._answer(52)
        else:
            self._answer(command, status=UNKNOWN)

    def _measure(self):
        """Send a third of a second of samples, if it is over."""
        if self._began is None or self.silent:
            return
        if time.monotonic() < self._off_until:
            self._began, self._seen = None, False
            self._send(1, struct.pack('<2i', 64, BEAM_LOST))
            return
        step = struct.unpack_from('<i', self._set[30])[0]
        ready = int((time.monotonic() - self._began) * 1e3) // step
        count = 333 // step
        while ready - self._sent >= count:  # a client that does not read may have held it up
            numbers = range(self._sent, self._sent + count)
            samples = b''.join(self._sample(k * step) for k in numbers)
            head = struct.pack('<4i3d', 0, count, 1, 0, 22.0, 710.0, 33.0)
            self._send(10, head + samples)
            self._sent += count

    def _sample(self, ms):
        values = point(self._began + ms / 1e3)
        assert self._set[5] == bytes(20) and self._set[26] == bytes(4), 'metres, right-handed'
        head = struct.pack('<3i', 0, ms // 1000, ms % 1000 * 1000)
        return head + struct.pack('<10d', *values, *[1e-5] * 7)


@contextmanager
def other_tracker(**given):
    """Run it on a free port, unless one is given."""
    tracker = OtherTracker(**given)
    try:
        yield tracker
    finally:
        tracker.close()
