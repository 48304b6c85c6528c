# SPDX-License-Identifier: Apache-2.0
"""Content of bags: what is put in order, and one clear error for what is unusable."""

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
    write_rosbag,
)

from otf_core.bags.bag import BagContent, read_bag, read_points
from otf_core.errors import InputError
from otf_core.model.observation import Samples

# ---------------------------------------------------------------- order


def reordered(order, log_time=None):
    points = [MESSAGES[1:][i] for i in order]
    if log_time is not None:
        points = [(p[0], p[1], int(t), p[3]) for p, t in zip(points, log_time, strict=True)]
    return [PATH_MESSAGE, *points]


def test_repeated_samples_are_dropped_with_a_warning(tmp_path, caplog):
    order = np.sort(np.concatenate([np.arange(200), [3, 3, 77]]))
    assert_same(read_bag(write_mcap(tmp_path / 'a.mcap', reordered(order))))
    assert 'dropped 3 repeated samples and 0' in caplog.text


def conflicting(n, every):
    samples = some_samples(n)
    extra = Samples(samples.stamp_ns[::every], samples.xyz[::every] + 1e-6)
    points = sorted(point_messages(samples) + point_messages(extra), key=lambda m: m[2])
    return samples, [PATH_MESSAGE, *points]


def test_rare_second_points_of_a_stamp_are_dropped_with_a_warning(tmp_path, caplog):
    samples, messages = conflicting(3000, 1500)
    assert_same(
        read_bag(write_mcap(tmp_path / 'a.mcap', messages)), BagContent(samples, CONTENT.path)
    )
    assert 'dropped 0 repeated samples and 2' in caplog.text


def test_frequent_second_points_of_a_stamp_are_refused(tmp_path):
    file = write_mcap(tmp_path / 'a.mcap', conflicting(200, 10)[1])
    with pytest.raises(InputError, match=r'20 of 220 .* sample 1 with stamp .* two trackers'):
        read_bag(file)


def test_stamps_that_are_not_set_are_refused(tmp_path):
    unset = Samples(np.zeros(200, np.int64), CONTENT.samples.xyz)
    file = write_mcap(tmp_path / 'a.mcap', [PATH_MESSAGE, *point_messages(unset)])
    with pytest.raises(InputError, match=r'header\.stamp is not set \(all 200 are zero\)'):
        read_bag(file)


# ---------------------------------------------------------------- wrong content


def test_missing_topics_are_named_with_those_there(tmp_path):
    tf = ('/tf', TF_TYPE, START, b'')
    file = write_mcap(tmp_path / 'a.mcap', [tf, *MESSAGES[1:]])
    with pytest.raises(InputError, match=r'/planner/path is missing; .* /tf \(tf2_msgs'):
        read_bag(file)
    assert len(read_points(file)) == 200
    folder = write_rosbag(tmp_path / 'bag', [PATH_MESSAGE])
    for read in (read_bag, read_points):
        with pytest.raises(InputError, match=r'/tracker/point is missing; .* /planner/path'):
            read(folder)
    with pytest.raises(InputError, match='topics in the bag: none'):
        read_bag(write_mcap(tmp_path / 'b.mcap', []))


@pytest.mark.parametrize('as_rosbag', [True, False])
def test_wrong_type_is_named(tmp_path, as_rosbag):
    messages = [PATH_MESSAGE, ('/tracker/point', 'geometry_msgs/msg/Point', START, bytes(28))]
    write = write_rosbag if as_rosbag else write_mcap
    with pytest.raises(InputError, match="type 'geometry_msgs/msg/Point', expected 'geometry_ms"):
        read_bag(write(tmp_path / 'bag.mcap', messages))


@pytest.mark.parametrize(
    ('frame', 'shown'),
    [('', 'empty'), ('lab', "'lab'"), ('trackes', "'trackes'"), ('/tracker', "'/tracker'")],
)
@pytest.mark.parametrize('little', [True, False])
def test_points_in_a_wrong_frame_are_left_out_if_few_and_refused_if_most(
    tmp_path, frame, shown, little
):
    messages = list(MESSAGES)
    messages[42] = (*MESSAGES[42][:3], point_cdr(START, (1, 2, 3), frame, little))
    found = read_bag(write_mcap(tmp_path / 'a.mcap', messages))
    np.testing.assert_array_equal(found.samples.xyz, np.delete(CONTENT.samples.xyz, 41, axis=0))
    (remark,) = found.remarks
    assert '1 of 200 points in another frame' in remark
    assert f"frame_id is {shown}, expected 'tracker'" in remark
    alien = [(*m[:3], point_cdr(m[2], (1, 2, 3), frame, little)) for m in MESSAGES[1:102]]
    file = write_mcap(tmp_path / 'b.mcap', [PATH_MESSAGE, *alien, *MESSAGES[102:]])
    with pytest.raises(InputError, match=f"101 of 200 .* frame_id is {shown}, expected 'tracker'"):
        read_bag(file)


@pytest.mark.parametrize(
    ('path', 'text'),
    [
        (path_cdr(frame=''), "frame_id is empty, expected 'machine'"),
        (path_cdr(frame='map'), "frame_id is 'map', expected 'machine'"),
        (path_cdr(pose_frame='map'), "pose 0: frame_id is 'map', expected 'machine'"),
        (path_cdr(points=[]), r'no path with points was published .*--path FILE'),
        (path_cdr(points=CORNERS[:1]), '1 points without any motion'),
        (path_cdr(points=CORNERS * np.nan), 'point 0 is not finite'),
        (path_cdr(points=CORNERS * 1e4), r'point 1, .* is beyond 1000 m; the unit is m'),
        (path_cdr()[:-1], 'not a nav_msgs/msg/Path in CDR .*it ends early'),
        (path_cdr() + bytes(4), 'not a nav_msgs/msg/Path in CDR .*follow its last field'),
        (path_cdr()[:24] + b'\xff' * 4 + path_cdr()[28:], 'Invalid sequence length'),
        (b'', 'not a nav_msgs/msg/Path in CDR .*begins with nothing'),
    ],
)
def test_unusable_path_is_explained(tmp_path, path, text):
    file = write_mcap(tmp_path / 'a.mcap', [(*PATH_MESSAGE[:3], path), *MESSAGES[1:]])
    with pytest.raises(InputError, match=f'/planner/path: .*{text}'):
        read_bag(file)
    assert len(read_points(file)) == 200


def test_different_paths_are_refused_and_counted(tmp_path):
    others = [(*PATH_MESSAGE[:3], path_cdr(CORNERS[::-1] * k)) for k in (1, 2)]
    with pytest.raises(InputError, match='3 different paths'):
        read_bag(write_mcap(tmp_path / 'a.mcap', [*MESSAGES, *others]))


@pytest.mark.parametrize(
    ('value', 'few', 'many', 'text'),
    [
        (np.nan, 100, 101, 'not finite'),
        (np.frombuffer(struct.pack('<Q', 0x7FF0000000000001))[0], 100, 101, 'not finite'),
        (np.inf, 100, 101, 'not finite'),
        (4321.0, 2, 3, 'the unit is m'),
    ],
)
def test_unusable_points_are_left_out_if_few_and_refused_if_many(tmp_path, value, few, many, text):
    def bag_with(count):
        samples = some_samples()
        samples.xyz[17 : 17 + count] = value
        return samples, write_mcap(
            tmp_path / f'{count}.mcap', [PATH_MESSAGE, *point_messages(samples)]
        )

    samples, file = bag_with(few)
    found = read_bag(file)
    kept = np.delete(np.arange(200), np.s_[17 : 17 + few])
    assert found.samples.xyz.tobytes() == samples.xyz[kept].tobytes()
    first = f'sample 17, {samples.time[17]:.6f} s'
    assert f'dropped {few} of 200 points' in found.remarks[0] and first in found.remarks[0]
    _, file = bag_with(many)
    with pytest.raises(InputError, match=f'{many} of 200 .* {first} .*{text}'):
        read_bag(file)


def test_points_without_beam_are_dropped_and_counted(tmp_path, caplog):
    samples = some_samples()
    samples.xyz[[17, 99]] = [[0.0, 0.0, 0.0], [-0.0, 0.0, 0.0]]
    file = write_mcap(tmp_path / 'a.mcap', [PATH_MESSAGE, *point_messages(samples)])
    with caplog.at_level('WARNING'):
        found = read_bag(file).samples
    np.testing.assert_array_equal(found.stamp_ns, np.delete(samples.stamp_ns, [17, 99]))
    np.testing.assert_array_equal(found.xyz, np.delete(samples.xyz, [17, 99], axis=0))
    assert (
        f'dropped 2 of 200 points in the origin of the tracker (no beam); the first is sample 17, '
        f'{samples.time[17]:.6f} s' in caplog.text
    )


@pytest.mark.parametrize(
    ('data', 'text'),
    [
        (b'', 'begins with nothing'),
        (b'\x00\x03' + point_cdr(1, (1, 2, 3))[2:], 'begins with 00 03'),
        (point_cdr(1, (1, 2, 3))[:30], 'ends early'),
        (point_cdr(1, (1, 2, 3))[:12] + b'\xff' * 40, 'Invalid string length'),
        (point_cdr(1, (1, 2, 3))[:8] + b'\xff' * 4 + point_cdr(1, (1, 2, 3))[12:], 'nanosec'),
    ],
)
def test_broken_point_message_is_named(tmp_path, data, text):
    messages = list(MESSAGES)
    messages[13] = (*messages[13][:3], data)
    with pytest.raises(InputError, match=f'message 12.*{text}'):
        read_bag(write_mcap(tmp_path / 'a.mcap', messages))
