# SPDX-License-Identifier: Apache-2.0
"""CDR encoding of what a bag carries: stamped points in bulk, everything else by rosbags.

A message begins with 00 01 (little endian) or 00 00 (big endian) and two option bytes; alignment
counts from byte 4. PointStamped is int32 sec, uint32 nanosec, string frame_id, three float64: with
L characters and a NUL the header ends 13 + L bytes after byte 4, so (-(13 + L)) mod 8 bytes of
padding come before x.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Index
from otf_core.bags.rosbag2_metadata import AXES, PATH
from otf_core.errors import InputError
from otf_core.files.message_text import shortened

SECOND_NS = 1_000_000_000
MAX_TRAILING = 3
"""Bytes a serializer may add after the last field."""
RESERVED = 16
"""Bytes that Fast DDS reserves for a trajectory point beyond its fields: its empty sequences count
as if they were aligned. They follow the message, whatever was in the memory."""

Bytes = NDArray[np.uint8]


def gather(buffer: Bytes, at: Index, width: int) -> NDArray[np.void]:
    """``width`` bytes from every position in ``at``; shape (n,), items of raw bytes.

    A view where all positions are one step apart, else a copy. The caller has made sure that
    ``at + width`` stays inside the buffer.
    """
    if not at.size:
        return np.empty(0, f'V{width}')
    step = int(at[1] - at[0]) if at.size > 1 else 1
    if step > 0 and np.all(at[1:] - at[:-1] == step):
        return np.ndarray(at.shape, f'V{width}', buffer, int(at[0]), (step,))
    count = buffer.size - width + 1
    windows = np.ndarray((count,), f'V{width}', buffer, strides=(1,))
    return np.asarray(windows[at])


@cache
def message_types() -> Any:
    """Types of the messages of ROS 2 Jazzy, by rosbags, which takes 0.1 s to import."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def decode_message(data: bytes, kind: str) -> Any:
    """Decode one message of a type.

    Raises
    ------
    ValueError
        If it is none; says why.
    """
    if data[:2] not in (b'\x00\x00', b'\x00\x01'):
        raise ValueError(f'it begins with {data[:4].hex(" ") or "nothing"}')
    from rosbags.serde import SerdeError

    types = message_types()
    definition = types.get_msgdef(kind)
    decode = definition.deserialize_cdr_le if data[1] else definition.deserialize_cdr_be
    try:
        message, end = decode(memoryview(data)[4:], 0, definition.cls, types)
    except struct.error:
        raise ValueError(f'it ends early, after {len(data)} bytes') from None
    except (SerdeError, OverflowError, MemoryError) as error:
        raise ValueError(str(error)) from None
    rest = len(data) - 4 - end
    reserved = RESERVED * len(message.points) if kind == AXES.type else 0
    if not 0 <= rest <= MAX_TRAILING + reserved:
        raise ValueError(f'{rest} bytes follow its last field')
    return message


def encode_message(message: Any) -> bytes:
    """Encode one message, little endian."""
    return bytes(message_types().serialize_cdr(message, message.__msgtype__))


def encode_header(stamp_ns: int, frame: str) -> Any:
    """Header of a message."""
    types = message_types().types
    time = types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, SECOND_NS))
    return types['std_msgs/msg/Header'](time, frame)


@dataclass(frozen=True)
class PointForm:
    """How messages hold a stamped point.

    Attributes
    ----------
    kind : str
        Type of the messages.
    point : str
        Field of the point.
    after : int
        Numbers, float64, that follow the point: rotation, covariance, speed.
    child : str, optional
        The child_frame_id that stands between header and point; None: nothing does.
    """

    kind: str = 'geometry_msgs/msg/PointStamped'
    point: str = 'point'
    after: int = 0
    child: str | None = None


POINT_FORM = PointForm()
_ROTATION, _COVARIANCE, _TWIST = 4, 36, 6
FORMS = {
    form.kind: form
    for form in (
        POINT_FORM,
        PointForm('geometry_msgs/msg/PoseStamped', 'pose.position', _ROTATION),
        PointForm(
            'geometry_msgs/msg/PoseWithCovarianceStamped',
            'pose.pose.position',
            _ROTATION + _COVARIANCE,
        ),
        PointForm('geometry_msgs/msg/TransformStamped', 'transform.translation', _ROTATION, ''),
        PointForm(
            'nav_msgs/msg/Odometry',
            'pose.pose.position',
            _ROTATION + _COVARIANCE + _TWIST + _COVARIANCE,
            '',
        ),
    )
}
"""Types that samples may have (common_interfaces, Jazzy); a child frame is that of the data."""


def _decode_stamped(data: bytes, number: int, form: PointForm) -> Any:
    """Decode one message with a stamped point; InputError names it if it is none."""
    name = form.kind.rpartition('/')[2]
    try:
        message = decode_message(data, form.kind)
    except ValueError as error:
        raise InputError(f'message {number} is not a {name} in CDR ({error})') from None
    nanosec = message.header.stamp.nanosec
    if nanosec >= SECOND_NS:
        text = f'message {number}: header.stamp has nanosec {nanosec}, above 999999999'
        raise InputError(text)
    return message


def form_of(kind: str, data: bytes) -> tuple[PointForm, str]:
    """Form of the messages of a type, and the frame of the first of them.

    Raises
    ------
    InputError
        If it is not a message of this type.
    """
    form = FORMS[kind]
    message = _decode_stamped(data, 0, form)
    if form.child is not None:
        form = replace(form, child=message.child_frame_id)
    return form, message.header.frame_id


@cache
def point_dtype(frame: str, form: PointForm = POINT_FORM) -> np.dtype[np.void]:
    """Layout of a message with this frame_id, little endian."""
    length = len(frame.encode())
    end = 13 + length
    child_at = end + -end % 4
    if form.child is not None:
        end = child_at + 4 + len(form.child.encode()) + 1
    xyz_at = 4 + end + -end % 8
    fields = {
        'encapsulation': ('>u2', 0),
        'sec': ('<i4', 4),
        'nanosec': ('<u4', 8),
        'length': ('<u4', 12),
        'frame': (f'S{length + 1}', 16),
        'xyz': ('(3,)<f8', xyz_at),
    }
    if form.child is not None:
        fields |= {
            'child_length': ('<u4', 4 + child_at),
            'child': (f'S{len(form.child.encode()) + 1}', 8 + child_at),
        }
    return np.dtype(
        {
            'names': list(fields),
            'formats': [kind for kind, _ in fields.values()],
            'offsets': [offset for _, offset in fields.values()],
            'itemsize': xyz_at + 8 * (3 + form.after),
        }
    )


@dataclass(frozen=True)
class DecodedPoints:
    """Points of many messages.

    Attributes
    ----------
    stamp_ns : ndarray of int64, shape (n,), ns
    xyz : ndarray of float64, shape (n, 3), m
    kept : ndarray of bool, optional
        Messages that they are of, where some were in another frame.
    foreign : Counter of str
        Messages in other frames, by frame_id.
    """

    stamp_ns: NDArray[np.int64]
    xyz: NDArray[np.float64]
    kept: NDArray[np.bool_] | None
    foreign: Counter[str]


def decode_points(
    buffer: Bytes,
    start: Index,
    size: Index,
    frame: str,
    first: int = 0,
    form: PointForm = POINT_FORM,
) -> DecodedPoints:
    """Decode many messages with a stamped point at once.

    Parameters
    ----------
    buffer : ndarray of uint8
        Holds all messages.
    start, size : ndarray of int64, shape (n,)
        Where each message begins and how many bytes it has; inside the buffer.
    frame : str
        The frame_id of the points; those of others are left out.
    first : int
        Number of the first message, for error texts.
    form : PointForm
        Of the messages.

    Raises
    ------
    InputError
        Names the first message that is none of this type or has a broken stamp.
    """
    layout = point_dtype(frame, form)
    fits = (size >= layout.itemsize) & (size <= layout.itemsize + MAX_TRAILING)
    some = slice(None) if fits.all() else fits
    rows = gather(buffer, start[some], layout.itemsize).view(layout)
    stamp_ns, xyz = np.empty(start.size, np.int64), np.empty((start.size, 3))
    stamp_ns[some] = rows['sec'].astype(np.int64) * SECOND_NS + rows['nanosec']
    xyz[some] = rows['xyz']
    alike = (rows['encapsulation'] == 1) & (rows['nanosec'] < SECOND_NS)
    names = {'length': 'frame', 'child_length': 'child'}
    for (count, name), text in zip(names.items(), (frame, form.child), strict=True):
        if text is not None:
            alike &= (rows[count] == layout[name].itemsize) & (rows[name] == text.encode())
    kept = np.zeros(start.size, np.bool_)
    kept[some] = alike
    foreign: Counter[str] = Counter()
    for i in np.flatnonzero(~kept).tolist():  # in another frame, big endian, or broken
        data = bytes(buffer[start[i] : start[i] + size[i]])
        message = _decode_stamped(data, first + i, form)
        own, child = message.header.frame_id, getattr(message, 'child_frame_id', None)
        if (own, child) != (frame, form.child):
            foreign[own if child == form.child else f'{own}, child {child}'] += 1
            continue
        stamp, point = message.header.stamp, attrgetter(form.point)(message)
        kept[i] = True
        stamp_ns[i], xyz[i] = stamp.sec * SECOND_NS + stamp.nanosec, (point.x, point.y, point.z)
    if kept.all():
        return DecodedPoints(stamp_ns, xyz, None, foreign)
    return DecodedPoints(stamp_ns[kept], xyz[kept], kept, foreign)


def frame_shown(frame: str) -> str:
    """Return a frame_id as messages name it; of a long one the beginning."""
    return repr(shortened(frame)) if frame else 'empty'


def frame_text(what: str, frame: str, expected: str) -> str:
    """Return the message for a frame_id that is not the one the interface fixes."""
    return (
        f"{what}: frame_id is {frame_shown(frame)}, expected '{expected}'; "
        f'publish in that frame, or name the topic in --config (topic, path_topic) to take any'
    )


def decode_path(data: bytes, frame: str) -> NDArray[np.float64]:
    """Decode one nav_msgs/msg/Path to its positions, shape (n, 3), m.

    Raises
    ------
    InputError
        If it is not a Path, or the Path or a pose has another frame_id (a pose may leave it
        empty).
    """
    try:
        message = decode_message(data, PATH.type)
    except ValueError as error:
        raise InputError(f'message is not a {PATH.type} in CDR ({error})') from None
    frame = frame or message.header.frame_id
    if message.header.frame_id != frame:
        raise InputError(frame_text('message', message.header.frame_id, frame))
    for i, pose in enumerate(message.poses):
        if pose.header.frame_id not in ('', frame):
            raise InputError(frame_text(f'pose {i}', pose.header.frame_id, frame))
    positions = [p.pose.position for p in message.poses]
    return np.array([(p.x, p.y, p.z) for p in positions], dtype=np.float64).reshape(-1, 3)


def decode_axes(data: bytes) -> tuple[str, tuple[str, ...], NDArray[np.float64]]:
    """Decode one trajectory_msgs/msg/JointTrajectory.

    Returns
    -------
    frame : str
        Its frame_id.
    names : tuple of str
        Of the joints.
    positions : ndarray, shape (n, k)
        Of the joints at every point; times, velocities and efforts are left out.

    Raises
    ------
    InputError
        If it is none, or a point has other positions than there are joints.
    """
    try:
        message = decode_message(data, AXES.type)
    except ValueError as error:
        raise InputError(f'message is not a {AXES.type} in CDR ({error})') from None
    names = tuple(message.joint_names)
    for i, point in enumerate(message.points):
        if len(point.positions) != len(names):
            count = len(point.positions)
            raise InputError(f'point {i} has {count} positions of {len(names)} joints')
    positions = np.array([point.positions for point in message.points], dtype=np.float64)
    return message.header.frame_id, names, positions.reshape(len(message.points), len(names))


def encode_axes(
    names: Sequence[str], positions: NDArray[np.float64], stamp_ns: int, frame: str
) -> bytes:
    """Encode a JointTrajectory, little endian, without times, velocities and efforts."""
    types = message_types().types
    point, none = types['trajectory_msgs/msg/JointTrajectoryPoint'], np.empty(0)
    at_once = types['builtin_interfaces/msg/Duration'](0, 0)
    points = [point(row, none, none, none, at_once) for row in positions]
    return encode_message(types[AXES.type](encode_header(stamp_ns, frame), list(names), points))


def encode_path(points: NDArray[np.float64], stamp_ns: int, frame: str) -> bytes:
    """Encode a Path, little endian; every pose carries the stamp and frame of the path."""
    types, header = message_types().types, encode_header(stamp_ns, frame)
    pose, stamped, point, turn = (
        types[f'geometry_msgs/msg/{name}']
        for name in ('Pose', 'PoseStamped', 'Point', 'Quaternion')
    )
    unturned = turn(0.0, 0.0, 0.0, 1.0)
    poses = [stamped(header, pose(point(*row), unturned)) for row in points.tolist()]
    return encode_message(types[PATH.type](header, poses))


def encode_points(
    stamp_ns: NDArray[np.int64], xyz: NDArray[np.float64], frame: str
) -> NDArray[np.void]:
    """Encode PointStamped messages, little endian; shape (n,), one item per message."""
    rows = np.zeros(stamp_ns.size, point_dtype(frame))
    rows['encapsulation'] = 1
    rows['sec'], rows['nanosec'] = np.divmod(stamp_ns, SECOND_NS)
    rows['length'] = rows.dtype['frame'].itemsize
    rows['frame'] = frame.encode()
    rows['xyz'] = xyz
    return rows
