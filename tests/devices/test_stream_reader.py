# SPDX-License-Identifier: Apache-2.0
"""The reader of a stream, step by step: what comes before a start, at a loss, after a defect."""

import json
import threading
import time

import numpy as np
import pytest
from streaming import described

from otf_tracker_driver.backends import CommonConfig, stream
from otf_tracker_driver.backends.lines import Transport, read_description

PATIENCE = 20.0
"""s"""


class Scripted(Transport):
    """Gives what a script says, one step a call: bytes, a stream on or off, or its loss."""

    datagrams, age_ns, dropped = False, 0, 0

    def __init__(self, *steps):
        self._steps, self.reader = iter(steps), None
        self.ready, self.done = threading.Event(), threading.Event()

    def receive(self, timeout):
        assert self.ready.wait(PATIENCE)
        step = next(self._steps, None)
        if step is None:
            self.done.set()
            time.sleep(0.005)
        elif step == 'lost':
            raise ConnectionError(step)
        elif isinstance(step, bytes):
            return step
        else:
            self.reader.start() if step == 'on' else self.reader.stop()
        return None

    def send(self, data):
        return True

    def close(self):
        pass


@pytest.fixture
def scripted(tmp_path, monkeypatch):
    """Run a reader through transports, of which each follows when the one before is lost."""
    made = []

    def run(*transports, awaited=True, **changes):
        first, *others = transports
        monkeypatch.setattr(stream, 'open_source', lambda *_: others.pop(0))
        made.append(stream.Stream(CommonConfig(), stream.StreamConfig()))
        made[-1].read(read_description(described(tmp_path, **changes)), first)
        for transport in transports:
            transport.reader = made[-1]
            transport.ready.set()
        assert not awaited or transports[-1].done.wait(PATIENCE)
        return made[-1]

    yield run
    for one in made:
        one.disconnect()


def test_defect_of_the_reader_is_not_silence(scripted, monkeypatch):
    monkeypatch.setattr(stream, 'read_point', lambda *_: 1 / 0)
    run = scripted(Scripted('on', b'1;2;3;4\n'), awaited=False)
    run._thread.join(PATIENCE)
    with pytest.raises(RuntimeError, match='is not read any more'):
        run.poll()


def test_what_waits_for_its_stamp_does_not_come_with_the_next_stream(scripted):
    old, new = b'1.0;10;20;30\n1.1;11;20;30\n', b'9.0;12;20;30\n'
    run = scripted(Scripted('on', old, 'off', b'\n', 'on', new, 'lost'), Scripted())
    np.testing.assert_allclose(run.poll().xyz[:, 0], [0.012])


def test_what_waits_for_its_stamp_comes_before_the_gap(scripted):
    first = Scripted('on', b'1.0;10;20;30\n1.1;11;20;30\n', 'lost')
    run = scripted(first, Scripted(b'2.0;12;20;30\n', 'lost'), Scripted())
    samples = run.poll()
    np.testing.assert_allclose(samples.xyz[:, 0], [0.010, 0.011, 0.012])
    assert run.interruptions == 1  # the second one did not go on
    assert [gap[:2] for gap in run.gaps] == [tuple(samples.stamp_ns[1:])]


def test_object_in_a_datagram_may_have_many_lines(scripted):
    class Datagrams(Scripted):
        datagrams = True

    objects = [{'x': k, 'y': 2, 'z': 3} for k in (1, 4)]
    pretty, lines = json.dumps(objects[0], indent=1), '\n'.join(map(json.dumps, objects))
    look = {'format': 'json', 'columns': None, 'separator': None, 'stamp': 'host', 'time': None}
    keys = {'x': 'x', 'y': 'y', 'z': 'z'}
    run = scripted(Datagrams('on', pretty.encode(), lines.encode()), keys=keys, **look)
    np.testing.assert_allclose(run.poll().xyz[:, 0], [0.001, 0.001, 0.004])


def test_line_that_began_before_the_stream_is_read_whole(scripted):
    steps = b'7;8;9\n1', 'on', b'2.5;20;30\n4;5;6\n'
    run = scripted(Scripted(*steps), columns={'x': 0, 'y': 1, 'z': 2}, stamp='host', time=None)
    points = run.poll().xyz
    np.testing.assert_allclose(points, [[0.0125, 0.02, 0.03], [0.004, 0.005, 0.006]])
