# SPDX-License-Identifier: Apache-2.0
"""What a packet from the tracker says, and the same packets for the emulator to send."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_tracker_driver.emscon.codes import CONTINUOUS_TIME, PacketType
from otf_tracker_driver.emscon.framing import HEADER, ProtocolError

COMMAND = struct.Struct('<iii')
ANSWER = struct.Struct('<iiii')
EVENT = struct.Struct('<iii')
MULTI_HEAD = struct.Struct('<iiiiiiddd')
SAMPLE = np.dtype([('status', '<i4'), ('s', '<i4'), ('us', '<i4'), ('value', '<f8', 3)])
SAMPLE_2 = np.dtype([*SAMPLE.descr, ('apriori', '<f8', 7)])
SAMPLES = {PacketType.MULTI: SAMPLE, PacketType.MULTI_2: SAMPLE_2}


@dataclass(frozen=True)
class Answer:
    """Answer to a command: result code and what follows it."""

    command: int
    status: int
    body: bytes


@dataclass(frozen=True)
class ErrorReport:
    """Error that the tracker reports by itself, such as a lost beam."""

    command: int
    status: int


@dataclass(frozen=True)
class StatusChange:
    """Event that the tracker reports by itself."""

    event: int


@dataclass(frozen=True)
class Measurements:
    """One packet of a continuous measurement.

    Attributes
    ----------
    result : int
        Result code of the packet.
    environment : tuple of float
        Temperature, pressure, humidity in the current units.
    status : ndarray of int32, shape (n,)
        Of every sample, see SampleStatus.
    device_ns : ndarray of int64, shape (n,), ns
        Time of every sample since the start of the measurement, on the tracker's clock.
    value : ndarray, shape (n, 3)
        In the current units and coordinate system.
    """

    result: int
    environment: tuple[float, float, float]
    status: NDArray[np.int32]
    device_ns: NDArray[np.int64]
    value: NDArray[np.float64]


@dataclass(frozen=True)
class UnusedPacket:
    """A packet of a type that this driver has no use for; counted."""

    kind: int


Packet = Answer | ErrorReport | StatusChange | Measurements | UnusedPacket


def decode(packet: bytes) -> Packet:
    """Read one whole packet from the tracker.

    Raises
    ------
    ProtocolError
        If the packet is shorter than its type needs, or its parts do not fill it.
    """
    _, kind = HEADER.unpack_from(packet)
    if kind == PacketType.COMMAND:
        _, _, command, status = _unpacked(ANSWER, packet, 'answer')
        return Answer(command, status, packet[ANSWER.size :])
    if kind == PacketType.ERROR:
        _, _, command, status = _unpacked(ANSWER, packet, 'error')
        return ErrorReport(command, status)
    if kind == PacketType.EVENT:
        return StatusChange(_unpacked(EVENT, packet, 'event')[2])
    if kind in SAMPLES:
        return _measurements(packet, SAMPLES[PacketType(kind)])
    return UnusedPacket(kind)


def _unpacked(layout: struct.Struct, packet: bytes, what: str) -> tuple[int, ...]:
    if len(packet) < layout.size:
        raise ProtocolError(f'{what} of {len(packet)} bytes, {layout.size} needed')
    return layout.unpack_from(packet)


def _measurements(packet: bytes, layout: np.dtype) -> Measurements:
    head = _unpacked(MULTI_HEAD, packet, 'measurement')
    result, count = head[2:4]
    # a count that does not fill the packet is never used as a length
    if count < 0 or len(packet) != MULTI_HEAD.size + count * layout.itemsize:
        raise ProtocolError(f'measurement of {len(packet)} bytes says {count} samples')
    rows = np.frombuffer(packet, layout, count, MULTI_HEAD.size)
    device_ns = rows['s'].astype(np.int64) * 10**9 + rows['us'].astype(np.int64) * 1000
    environment = head[6], head[7], head[8]
    return Measurements(
        result, environment, rows['status'].copy(), device_ns, rows['value'].astype(float)
    )


def encode_answer(command: int, status: int, body: bytes = b'') -> bytes:
    """Return the packet of an answer."""
    return ANSWER.pack(ANSWER.size + len(body), PacketType.COMMAND, command, status) + body


def encode_error(command: int, status: int) -> bytes:
    """Return the packet of an error that nobody asked for."""
    return ANSWER.pack(ANSWER.size, PacketType.ERROR, command, status)


def encode_event(event: int) -> bytes:
    """Return the packet of a system status change."""
    return EVENT.pack(EVENT.size, PacketType.EVENT, event)


def encode_measurements(packet: Measurements, kind: PacketType = PacketType.MULTI) -> bytes:
    """Return the packet of a continuous measurement; a-priori deviations are zero."""
    rows = np.zeros(len(packet.status), SAMPLES[kind])
    rows['status'], rows['value'] = packet.status, packet.value
    rows['s'], ns = np.divmod(packet.device_ns, 10**9)
    rows['us'] = ns // 1000
    size = MULTI_HEAD.size + rows.nbytes
    head = (size, kind, packet.result, len(rows), CONTINUOUS_TIME, 0, *packet.environment)
    return MULTI_HEAD.pack(*head) + rows.tobytes()
