# SPDX-License-Identifier: Apache-2.0
"""Points as lines: two unlike formats over real sockets, and bad lines."""

import json
import random
import socket
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml
from streaming import CARTESIAN, SPHERICAL, described, sender

from otf_core.errors import ConfigError, InputError
from otf_tracker_driver.backends import CommonConfig
from otf_tracker_driver.backends.base import join_samples
from otf_tracker_driver.backends.lines import (
    LONGEST,
    Lines,
    Unreadable,
    read_description,
    read_point,
)
from otf_tracker_driver.backends.stream import Stream, StreamConfig

PATIENCE = 20.0
"""s"""
CART = Path(__file__).parents[2] / 'src/otf_core/test/data/cart_stream.csv'


@pytest.fixture
def make():
    made = []

    def make(path):
        made.append(Stream(CommonConfig(), StreamConfig(source=str(path))))
        return made[-1]

    yield make
    for backend in made:
        backend.disconnect()


def until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, 'waited in vain'
        time.sleep(0.005)


def take(backend, count, meanwhile=lambda: None):
    parts = []

    def enough():
        meanwhile()
        parts.append(backend.poll())
        return sum(map(len, parts)) >= count

    until(enough)
    return join_samples(parts)


@pytest.mark.parametrize(('kind', 'look'), [('tcp', CARTESIAN), ('udp', SPHERICAL)])
def test_two_unlike_sources_give_the_points_and_times_that_were_sent(make, tmp_path, kind, look):
    with sender(kind, look) as source:
        path = tmp_path / 'source.yaml'
        path.write_text(yaml.safe_dump({**look, 'source': source.url}))
        backend = make(path)
        assert source.url in backend.connect()
        backend.start()
        samples = take(backend, 600)
        assert backend.trouble == ''
    rows = np.array(source.sent)
    at = {tuple(np.round(row[1:], 6)): row[0] for row in rows}
    true = np.array([at[tuple(np.round(point, 6))] for point in samples.xyz])
    assert np.all(np.diff(samples.stamp_ns) > 0)
    # offset of the two clocks: common to all samples
    off = samples.stamp_ns / 1e9 - true
    assert np.ptp(off) < 0.01


def test_host_stamps_are_taken_only_where_declared_and_with_a_warning(make, tmp_path):
    with pytest.raises(ConfigError, match='stamp: missing'):
        make(described(tmp_path, source='udp://127.0.0.1:9', stamp=None)).connect()
    with sender('udp', CARTESIAN) as source:
        backend = make(described(tmp_path, source=source.url, stamp='host', time=None))
        backend.connect()
        backend.start()
        before = time.time_ns()
        samples = take(backend, 100)
        assert 'WARNING: stamped on arrival' in backend.remark
        assert np.all(np.diff(samples.stamp_ns) > 0)
        assert abs(samples.stamp_ns[0] - before) < 5e9


def test_datagrams_of_others_than_the_peer_are_not_taken(make, tmp_path):
    with sender('udp', CARTESIAN) as source:
        backend = make(described(tmp_path, source=source.url, peer='127.0.0.2'))
        backend.connect()
        backend.start()
        until(lambda: 'sends nothing; is it on?' in backend.trouble)
        assert len(backend.poll()) == 0


def test_source_of_datagrams_is_told_to_start_as_soon_as_it_is_heard(make, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
        source.bind(('127.0.0.1', 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(('127.0.0.1', 0))
            place = free.getsockname()
        backend = make(described(tmp_path, source=f'udp://127.0.0.1:{place[1]}', start='GO'))
        backend.connect()
        backend.start()
        until(lambda: backend.served)
        source.sendto(b'here', place)
        source.settimeout(PATIENCE)
        assert source.recv(100) == b'GO'


def test_connection_whose_other_end_is_gone_is_noticed(make, tmp_path):
    with connection(make, tmp_path) as (backend, _):
        probed = backend._transport._socket
        assert probed.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        assert probed.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == 3


@pytest.mark.parametrize('separator', ['\t', r'\t'])
def test_columns_may_be_separated_by_tabs(tmp_path, separator):
    how = read_description(described(tmp_path, separator=separator))
    assert read_point('7\t1000\t2000\t3000\tA b', how) == (7 * 10**9, (1.0, 2.0, 3.0))


def test_decimal_commas_are_read_where_the_description_says_so(tmp_path):
    how = read_description(described(tmp_path, decimal=','))
    assert read_point('7,5;1000,5;-20;1e3', how) == (7_500_000_000, (1.0005, -0.02, 1.0))
    for line in ('7;1.000,5;20;30', '7;1.5;20;30'):
        with pytest.raises(Unreadable, match='column 1 is not a number'):
            read_point(line, how)
    with pytest.raises(ConfigError, match="decimal: ',' separates the columns, too"):
        read_description(described(tmp_path, decimal=',', separator=','))


def test_recorded_stream_of_a_tracker_is_read(tmp_path):
    how = read_description(described(tmp_path, separator=',', columns={'x': 1, 'y': 2, 'z': 3}))
    lines = CART.read_text().splitlines()
    points = []
    for line in lines:
        try:
            points.append(read_point(line, how))
        except Unreadable:
            assert not line[0].isdigit()
    assert len(points) > 100
    assert points[0] == (7_200_000_000, pytest.approx((1.7908069, 10.4635057, 1.5273263)))


def test_source_that_goes_away_is_connected_to_again(make, tmp_path):
    with sender('tcp', CARTESIAN, close_after=2.5) as source:
        backend = make(described(tmp_path, source=source.url))
        backend.connect()
        backend.start()
        take(backend, 200)
        assert backend.health.connections == 1
        until(lambda: 'connecting again' in backend.trouble)
        take(backend, 200)
        assert backend.health.connections >= 2
        assert backend.trouble == ''


@pytest.mark.parametrize(
    ('line', 'said'),
    [
        ('hello', "column 1 is missing, there are 1; check .* 'hello'|column 1 is missing"),
        ('0.1;1;two;3', 'column 2 is not a number'),
        ('0.1;1;nan;3', 'column 2 is not a number'),
        ('0.1;0;0;0', 'is implausible'),
        ('0.1;1e9;0;0', 'check length'),
        ('9e99;1;2;3', 'stamp is out of range'),
        ('-9e9;1;2;3', 'stamp is out of range'),
    ],
)
def test_lines_without_a_point_are_said_and_left_out(make, tmp_path, line, said):
    with pytest.raises(Unreadable, match=said):
        read_point(line, read_description(described(tmp_path)))
    with sender('udp', CARTESIAN, lines=[line]) as source:
        backend = make(described(tmp_path, source=source.url))
        backend.connect()
        backend.start()
        until(lambda: 'check the description' in backend.trouble)
        assert len(backend.poll()) == 0 and '\n' not in backend.trouble


@contextmanager
def connection(make, folder, **changes):
    """A backend that streams, and the other end of its connection."""
    with socket.create_server(('127.0.0.1', 0)) as server:
        url = f'tcp://127.0.0.1:{server.getsockname()[1]}'
        backend = make(described(folder, source=url, **changes))
        backend.connect()
        with server.accept()[0] as peer:
            backend.start()
            yield backend, peer


@pytest.mark.parametrize(
    ('sent', 'said'),
    [
        (b'1;10;20;30\0', 'no end of line'),
        (b'x' * (LONGEST + 1) + b'\n', f'line of more than {LONGEST} bytes; check'),
    ],
)
def test_bytes_that_make_no_line_are_said(make, tmp_path, sent, said):
    with connection(make, tmp_path) as (backend, peer):

        def heard():
            peer.sendall(sent)
            return said in backend.trouble

        until(heard)


def test_wrong_lines_are_said_by_few_examples(make, tmp_path):
    lines = [f'{k};a;2;3' for k in range(2000)]
    with sender('tcp', CARTESIAN, lines=lines) as source:
        backend = make(described(tmp_path, source=source.url))
        backend.connect()
        backend.start()
        said = set()

        def many():
            said.add(backend.trouble)
            return backend.health.unreadable > 600

        until(many)
        assert 'column 1 is not a number in line' in backend.trouble and len(said) < 10


def test_lines_of_text_between_points_are_no_trouble(make, tmp_path):
    lines = [f'{4 * k};1;2;3' if k % 2 else '# ready' for k in range(5000)]
    with sender('tcp', CARTESIAN, lines=lines) as source:
        backend = make(described(tmp_path, source=source.url, time='ms'))
        backend.connect()
        backend.start()
        said = set()
        take(backend, 400, lambda: said.add(backend.trouble))
        assert said == {''} and backend.health.unreadable > 100


def test_points_whose_times_repeat_are_left_out_and_counted(make, tmp_path):
    with sender('tcp', CARTESIAN, lines=['1;10;20;30', '1;11;20;30', '2;12;20;30']) as source:
        backend = make(described(tmp_path, source=source.url))
        backend.connect()
        backend.start()
        until(lambda: backend.health.left_out.get('time had been there', 0) > 60)


@pytest.mark.parametrize(
    ('changes', 'said'),
    [
        ({'source': 'http://x:1'}, "source: 'http://x:1'; give tcp://"),
        ({'source': 'tcp://x:70000'}, 'source: port 70000'),
        ({'format': 'xml'}, "format: 'xml'; possible: text, json"),
        ({'length': 'cm'}, "length: 'cm'; possible: m, mm"),
        ({'length': None}, 'length: missing'),
        ({'columns': {'x': 'a', 'y': 1, 'z': 2}}, "columns: x: 'a'; give the number"),
        ({'columns': {'x': 0, 'y': 1}}, 'columns: z: missing'),
        ({'unit': 'mm'}, 'unit: unknown key'),
        ({'stamp': -1}, 'stamp: -1; give the number'),
    ],
)
def test_mistakes_in_a_description_are_said_by_their_key(tmp_path, changes, said):
    with pytest.raises(ConfigError, match=f'source.yaml: {said}'):
        read_description(described(tmp_path, **changes))


@pytest.mark.parametrize('url', ['tcp://127.0.0.1:1', 'udp://no.such.host.invalid:9'])
def test_source_that_cannot_be_opened_is_said_in_one_line(make, tmp_path, url):
    with pytest.raises(InputError, match='cannot be opened') as caught:
        make(described(tmp_path, source=url)).connect()
    assert '\n' not in str(caught.value)


def test_lines_are_cut_from_any_pieces_and_endless_ones_are_left_out():
    rng = random.Random(2)
    wanted = [f'line {k} ' + 'x' * rng.randrange(100) for k in range(200)]
    stream = b''.join(w.encode() + rng.choice((b'\n', b'\r\n', b'\r')) for w in wanted)
    stream += b'y' * (3 * LONGEST) + b'\nlast\n'
    lines, got = Lines(), []
    while stream:
        cut = rng.randint(1, 300)
        got += lines.feed(stream[:cut])
        stream = stream[cut:]
        assert len(lines._held) <= LONGEST
    assert got == [w.strip() for w in [*wanted, 'last']] and lines.too_long == 1


def fuzz(folder, count, seed):
    """Feed damaged lines of both formats; return how many held a point."""
    rng, read = random.Random(seed), 0
    text = read_description(described(folder))
    look = {**SPHERICAL, 'source': 'udp://127.0.0.1:9'}
    (folder / 'json.yaml').write_text(yaml.safe_dump(look))
    objects = read_description(folder / 'json.yaml')
    good = {
        id(text): '12.345678;1000.5;-20.25;7.125',
        id(objects): json.dumps({'t': 12, 'pose': {'hz': 10.0, 'v': 80.0, 'd': 3.0}}),
    }
    extra = ['[' * 900, '9' * 900, '1e999', 'NaN', '-', '"', '\0', '{}', '٣', '1e400', 'Infinity']
    for _ in range(count):
        how = rng.choice((text, objects))
        line = good[id(how)]
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(len(line) + 1)
            put = rng.choice([*extra, chr(rng.randrange(1, 300))])
            line = line[:at] + put + line[at + rng.randrange(3) :]
        try:
            stamp, point = read_point(line, how)
        except Unreadable as error:
            assert '\n' not in str(error)
        else:
            read += 1
            assert abs(stamp) < 2**63 and np.all(np.isfinite(point))
    return read


def test_damaged_lines_are_read_or_refused_and_nothing_else(tmp_path):
    assert 20 < fuzz(tmp_path, 2000, 3) < 1950
