# SPDX-License-Identifier: Apache-2.0
"""Packets of the emScon protocol, by offsets and sizes of its description; and damaged ones."""

import pickle
import random
import struct

import numpy as np
import pytest
from emulator import encode_measurements

from otf_tracker_driver.backends import emscon_link
from otf_tracker_driver.backends.emscon_link import (
    LARGEST,
    Command,
    CommandRefused,
    Framer,
    PacketType,
    ProtocolError,
)

SIZES = {
    1: (12, 56), 2: (12, 20), 5: (32, 16), 6: (12, 36), 7: (12, 16), 13: (12, 64), 15: (12, 72),
    20: (36, 16), 21: (12, 40),
    24: (16, 16), 25: (12, 20), 26: (16, 16), 27: (12, 20), 30: (28, 16), 31: (12, 32),
    40: (16, 16), 41: (12, 20), 42: (12, 100), 47: (48, 16), 48: (12, 52), 49: (12, 16),
    52: (12, 16), 53: (12, 16), 54: (12, 16), 63: (20, 16), 66: (12, 32), 80: (20, 16),
    81: (12, 24), 98: (12, 20), 122: (12, 24), 130: (16, 16), 132: (12, 164), 142: (12, 80),
}  # fmt: skip
"""Bytes of request and answer, header included."""
MUTATIONS = 2000


def measurement(kind=3, count=3, stride=36, result=0):
    """One packet of a continuous measurement, written by offsets."""
    packet = bytearray(48 + stride * count)
    struct.pack_into('<6i3d', packet, 0, len(packet), kind, result, count, 1, 0, 20.5, 1013.0, 41)
    for k in range(count):
        at = 48 + stride * k
        struct.pack_into('<3i3d', packet, at, k % 5, 7, 2000 * k, 1.0 + k, -2.0, 0.25)
    return bytes(packet)


def answered(command, body):
    fields = emscon_link.ANSWERS.get(command, '')
    return emscon_link.read_values(fields, body, emscon_link.command_text(command))


def reflector(total, number, name):
    body = struct.pack('<3id', total, number, 1, 0.019) + name.encode('utf-16-le').ljust(64, b'\0')
    return struct.pack('<4i', 16 + len(body), 0, 42, 0) + body


GOOD = [
    measurement(),
    measurement(10, 2, 92),
    measurement(count=0),
    struct.pack('<4i', 16, 1, 64, 701),
    struct.pack('<3i', 12, 8, 998),
    struct.pack('<4i', 16, 0, 49, 0),
    struct.pack('<9i', 36, 0, 6, 0, 0, 0, 0, 0, 0),
    reflector(2, 7, 'CCR-1.5in'),
    struct.pack('<2i', 8, 77),
]


@pytest.mark.parametrize('number', SIZES)
def test_request_and_answer_have_the_sizes_of_the_protocol(number):
    command = Command(number)
    fields = emscon_link.REQUESTS.get(command, '')
    values = [0] * len(struct.unpack_from(f'<{fields}', bytes(200)))
    request = emscon_link.encode_request(command, *values)
    assert len(request) == SIZES[number][0]
    assert struct.unpack_from('<3i', request) == (len(request), 0, number)
    assert 16 + struct.calcsize(f'<{emscon_link.ANSWERS.get(command, "")}') == SIZES[number][1]


def test_all_commands_of_the_driver_are_in_that_list():
    assert {int(c) for c in Command} - {64} == set(SIZES)


@pytest.mark.parametrize(('kind', 'stride'), [(3, 36), (10, 92)])
def test_samples_of_both_continuous_packets(kind, stride):
    read = emscon_link.decode(measurement(kind, 3, stride, result=57))
    assert read.result == 57 and read.environment == (20.5, 1013.0, 41.0)
    assert read.status.tolist() == [0, 1, 2]
    assert read.device_ns.tolist() == [7_000_000_000, 7_002_000_000, 7_004_000_000]
    np.testing.assert_array_equal(read.value, [[1, -2, 0.25], [2, -2, 0.25], [3, -2, 0.25]])
    again = emscon_link.decode(encode_measurements(read, PacketType(kind)))
    np.testing.assert_array_equal(again.value, read.value)
    np.testing.assert_array_equal(again.device_ns, read.device_ns)


@pytest.mark.parametrize('count', [-1, 2, 4, 2**31 - 1])
def test_count_that_does_not_fill_the_packet_is_refused(count):
    packet = bytearray(measurement())
    struct.pack_into('<i', packet, 12, count)
    with pytest.raises(ProtocolError, match=f'says {count} samples'):
        emscon_link.decode(bytes(packet))


def test_unsolicited_packets_say_what_happened():
    assert emscon_link.decode(GOOD[3]) == emscon_link.ErrorReport(64, 701)
    assert emscon_link.decode(GOOD[4]) == emscon_link.StatusChange(998)
    assert emscon_link.decode(GOOD[-1]) is None
    assert emscon_link.status_text(701).startswith('beam lost')


def test_reflector_answer_has_its_name_and_longer_answers_are_read():
    read = emscon_link.decode(reflector(2, 7, 'CCR-1.5in'))
    values = answered(Command.GET_REFLECTORS, read.body)
    assert values == (2, 7, 1, 0.019, 'CCR-1.5in')
    assert answered(Command.GET_REFLECTORS, read.body + b'newer') == values
    with pytest.raises(ProtocolError, match='get reflectors'):
        answered(Command.GET_REFLECTORS, read.body[:-1])


def test_text_of_a_tracker_becomes_one_printable_line():
    raw = 'AT\n\x1b[31m'.encode('utf-16-le').ljust(64, b'\xd8')
    read = answered(Command.GET_SOFTWARE_VERSION, raw)[0]
    assert read.startswith('AT??[31m') and read.isprintable()


@pytest.mark.parametrize('number', [5, 13, 20, 99, 701, 424242, -1])
def test_every_code_has_a_text_with_its_number(number):
    for text in (emscon_link.status_text, emscon_link.command_text):
        assert str(number) in text(number)


def test_packets_split_and_merged_at_random_come_out_whole():
    rng = random.Random(1)
    for _ in range(50):
        sent = [rng.choice(GOOD) for _ in range(20)]
        stream, framer, got = b''.join(sent), Framer(), []
        while stream:
            cut = rng.randint(1, 200)
            got += framer.feed(stream[:cut])
            stream = stream[cut:]
        assert got == sent


@pytest.mark.parametrize('size', [-1, 0, 7, LARGEST + 1, 2**31 - 1])
def test_size_that_cannot_be_is_refused_at_once(size):
    framer = Framer()
    with pytest.raises(ProtocolError, match=f'size {size}, type 3'):
        list(framer.feed(struct.pack('<2i', size, 3)))


def test_other_protocols_are_refused_by_their_first_bytes():
    for greeting in (b'HTTP/1.1 400 Bad Request\r\n', b'SSH-2.0-OpenSSH_9.6\r\n', b'ACK-300 T2SA'):
        with pytest.raises(ProtocolError):
            list(Framer().feed(greeting))


def mutated(rng):
    """Packets with bytes changed, cut out, doubled or put in between."""
    stream = bytearray(b''.join(rng.choice(GOOD) for _ in range(rng.randint(1, 4))))
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(len(stream) or 1)
        what = rng.randrange(4)
        if what == 0 and stream:
            stream[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
        elif what == 1:
            del stream[at : at + rng.randint(1, 40)]
        elif what == 2:
            stream[at:at] = rng.randbytes(rng.randint(1, 40))
        else:
            stream[at:at] = stream[at : at + rng.randint(1, 40)]
    return bytes(stream)


def fuzz(count, seed):
    """Feed mutated streams; return how many packets were read, and how many refused."""
    rng, read, refused = random.Random(seed), 0, 0
    for _ in range(count):
        framer = Framer()
        try:
            for packet in framer.feed(mutated(rng)):
                got = emscon_link.decode(packet)
                read += 1
                if isinstance(got, emscon_link.Measurements):
                    assert len(got.status) == len(got.value) == len(got.device_ns)
                    assert 36 * len(got.status) < len(packet)
                if isinstance(got, emscon_link.Answer) and got.command in SIZES:
                    answered(Command(got.command), got.body)
        except ProtocolError as error:
            assert '\n' not in str(error)
            refused += 1
        assert len(framer._held) < 4000
    return read, refused


def test_damaged_streams_are_read_or_refused_and_nothing_else():
    read, refused = fuzz(MUTATIONS, 5)
    assert read > 500 and refused > 500


def test_a_refused_command_keeps_its_message_between_processes():
    refused = CommandRefused(5, 3)
    again = pickle.loads(pickle.dumps(refused))
    assert (str(again), again.status) == (str(refused), 3)
