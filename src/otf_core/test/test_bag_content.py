# SPDX-License-Identifier: Apache-2.0
"""Content of bags: what is left out and counted, and what is refused; one table of each."""

import struct

import numpy as np
import pytest
from bag_cells import (
    CONTENT,
    CORNERS,
    MESSAGES,
    PATH_MESSAGE,
    START,
    TF_TYPE,
    assert_same,
    path_cdr,
    point_cdr,
    point_messages,
    some_samples,
    write_mcap,
)

from otf_core.bags.bag import BagContent, read_bag, read_points
from otf_core.errors import InputError
from otf_core.model.observation import Samples

POINT = point_cdr(1, (1, 2, 3))
SIGNALLING = np.frombuffer(struct.pack('<Q', 0x7FF0000000000001))[0]


def with_points(rows, value):
    """The bag with these samples at one place."""
    samples = some_samples()
    samples.xyz[rows] = value
    return [PATH_MESSAGE, *point_messages(samples)]


def in_frame(rows, frame, little=True):
    """The bag with these samples in another frame."""
    messages = list(MESSAGES)
    for k in rows:
        _, _, stamp, _ = messages[1 + k]
        messages[1 + k] = (*messages[1 + k][:3], point_cdr(stamp, (1, 2, 3), frame, little))
    return messages


def with_path(data, *others):
    """The bag with this message of a path, and others after it."""
    messages = [(*PATH_MESSAGE[:3], own) for own in (data, *others)]
    return [messages[0], *MESSAGES[1:], *messages[1:]]


def with_message(data):
    """The bag with other bytes for its sample 12."""
    return [*MESSAGES[:13], (*MESSAGES[13][:3], data), *MESSAGES[14:]]


LEFT_OUT = {
    'not finite': (with_points(np.s_[17:117], np.nan), range(17, 117)),
    'signalling': (with_points(np.s_[17:117], SIGNALLING), range(17, 117)),
    'infinite': (with_points(np.s_[17:117], np.inf), range(17, 117)),
    'far': (with_points([17, 18], 4321.0), [17, 18]),
    'no beam': (with_points([17, 99], 0.0), [17, 99]),
    'another frame': (in_frame([41], 'lab'), [41]),
    'no frame, big-endian': (in_frame([41], '', little=False), [41]),
}


@pytest.mark.parametrize('name', LEFT_OUT)
def test_points_that_cannot_be_used_are_left_out_if_few_and_counted(tmp_path, name):
    messages, rows = LEFT_OUT[name]
    found = read_bag(write_mcap(tmp_path / 'a.mcap', messages))
    kept = np.delete(CONTENT.samples.xyz, rows, axis=0)
    np.testing.assert_array_equal(found.samples.xyz, kept)
    (remark,) = found.remarks
    assert f'{len(rows)} of 200' in remark


def test_repeated_samples_and_rare_second_points_are_dropped(tmp_path):
    order = np.sort(np.concatenate([np.arange(200), [3, 3, 77]]))
    messages = [PATH_MESSAGE, *(MESSAGES[1 + k] for k in order)]
    assert_same(read_bag(write_mcap(tmp_path / 'a.mcap', messages)))
    samples = some_samples(3000)
    second = Samples(samples.stamp_ns[::1500], samples.xyz[::1500] + 1e-6)
    points = sorted(point_messages(samples) + point_messages(second), key=lambda m: m[2])
    found = read_bag(write_mcap(tmp_path / 'b.mcap', [PATH_MESSAGE, *points]))
    assert_same(found, BagContent(samples, CONTENT.path))


TWICE = sorted(
    point_messages() + point_messages(Samples(CONTENT.samples.stamp_ns[::10], np.ones((20, 3)))),
    key=lambda message: message[2],
)
UNSET = point_messages(Samples(np.zeros(200, np.int64), CONTENT.samples.xyz))
REFUSED = {
    'most not finite': (with_points(np.s_[17:118], np.nan), '101 of 200 .* sample 17'),
    'far': (with_points([17, 18, 19], 4321.0), '3 of 200 .* unit'),
    'mostly no beam': (with_points(np.s_[:101], 0.0), '101 of 200'),
    'most in another frame': (in_frame(range(101), 'trackes'), "101 of 200 .*'trackes'"),
    'two points a stamp': ([PATH_MESSAGE, *TWICE], '20 of 220'),
    'stamps not set': ([PATH_MESSAGE, *UNSET], 'header.stamp'),
    'no path': ([('/tf', TF_TYPE, START, b''), *MESSAGES[1:]], '/planner/path .* /tf'),
    'no points': ([PATH_MESSAGE], '/tracker/point .* /planner/path'),
    'nothing': ([], 'none'),
    'another type': (
        [PATH_MESSAGE, ('/tracker/point', 'geometry_msgs/msg/Point', START, bytes(28))],
        "'geometry_msgs/msg/Point'",
    ),
    'another path': (
        with_path(path_cdr(), *(path_cdr(CORNERS[::-1] * k) for k in (1, 2))),
        '3 different paths',
    ),
    'empty frame of the path': (with_path(path_cdr(frame='')), 'frame_id .*machine'),
    'frame of a pose': (with_path(path_cdr(pose_frame='map')), "pose 0: .*'map'"),
    'path without points': (with_path(path_cdr(points=[])), '--path'),
    'path of a point': (with_path(path_cdr(points=CORNERS[:1])), '1 points'),
    'path not finite': (with_path(path_cdr(points=CORNERS * np.nan)), 'point 0'),
    'path in mm': (with_path(path_cdr(points=CORNERS * 1e4)), 'point 1, .* unit'),
    'path cut off': (with_path(path_cdr()[:-1]), 'Path in CDR .*early'),
    'path too long': (with_path(path_cdr() + bytes(4)), 'Path in CDR .*follow'),
    'wild length': (
        with_path(path_cdr()[:24] + b'\xff' * 4 + path_cdr()[28:]), '/planner/path: .*length'
    ),
    'empty path message': (with_path(b''), '/planner/path: .*CDR'),
    'empty message': (with_message(b''), 'message 12'),
    'another encoding': (with_message(b'\x00\x03' + POINT[2:]), 'message 12.*00 03'),
    'message cut off': (with_message(POINT[:30]), 'message 12.*early'),
    'wild text': (with_message(POINT[:12] + b'\xff' * 40), 'message 12.*length'),
    'wild time': (with_message(POINT[:8] + b'\xff' * 4 + POINT[12:]), 'message 12.*nanosec'),
}  # fmt: skip


@pytest.mark.parametrize('name', REFUSED)
def test_what_cannot_be_used_is_refused_with_its_place(tmp_path, name):
    messages, words = REFUSED[name]
    file = write_mcap(tmp_path / 'a.mcap', messages)
    with pytest.raises(InputError, match=words):
        read_bag(file)
    if 'path' in name and 'tracker' not in words:  # samples alone can be read
        assert len(read_points(file)) == 200
