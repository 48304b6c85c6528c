# SPDX-License-Identifier: Apache-2.0
"""Bags: exact round trips, agreement with rosbags, one clear error for every unusable input."""

import itertools
import logging
import shutil
import struct

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagWriter
from rosbags.typesys import Stores, get_typestore

from otf_core.bags import mcap_messages
from otf_core.bags.bag import BagContent, read_bag, read_points, write_bag
from otf_core.bags.cdr import decode_points, encode_path, encode_points, point_dtype
from otf_core.bags.mcap_messages import McapMessages
from otf_core.errors import ConfigError, InputError
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath

STORE = get_typestore(Stores.ROS2_JAZZY)
POINT_TYPE, PATH_TYPE = 'geometry_msgs/msg/PointStamped', 'nav_msgs/msg/Path'
TF_TYPE = 'tf2_msgs/msg/TFMessage'
START = 1_760_000_000_123_456_789
CORNERS = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.6, 0.5, -0.4], [0.0, 0.0, 0.0]])


def some_samples(n=200, seed=1):
    rng = np.random.default_rng(seed)
    stamp = START + np.cumsum(rng.integers(1, 2_000_000, n))
    return Samples(stamp, rng.normal(size=(n, 3)))


CONTENT = BagContent(some_samples(), NominalPath(CORNERS))


def assert_same(content, other=CONTENT):
    for got, want in (
        (content.samples.stamp_ns, other.samples.stamp_ns),
        (content.samples.xyz, other.samples.xyz),
        (content.path.points, other.path.points),
    ):
        assert got.dtype == want.dtype
        assert got.tobytes() == want.tobytes()


def header(stamp, frame):
    kinds = STORE.types
    sec, nanosec = divmod(int(stamp), 10**9)
    time = kinds['builtin_interfaces/msg/Time'](sec, nanosec)
    return kinds['std_msgs/msg/Header'](time, frame)


def point_cdr(stamp, xyz, frame='tracker', little=True):
    kinds = STORE.types
    point = kinds['geometry_msgs/msg/Point'](*map(float, xyz))
    message = kinds[POINT_TYPE](header(stamp, frame), point)
    return bytes(STORE.serialize_cdr(message, POINT_TYPE, little_endian=little))


def path_cdr(points=CORNERS, frame='machine', pose_frame=None, little=True):
    kinds = STORE.types
    turn = kinds['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    poses = [
        kinds['geometry_msgs/msg/PoseStamped'](
            header(START, frame if pose_frame is None else pose_frame),
            kinds['geometry_msgs/msg/Pose'](
                kinds['geometry_msgs/msg/Point'](*map(float, p)), turn
            ),
        )
        for p in points
    ]
    message = kinds[PATH_TYPE](header(START, frame), poses)
    return bytes(STORE.serialize_cdr(message, PATH_TYPE, little_endian=little))


def point_messages(samples=CONTENT.samples, topic='/tracker/point', **kwargs):
    return [
        (topic, POINT_TYPE, int(t), point_cdr(t, p, **kwargs))
        for t, p in zip(samples.stamp_ns, samples.xyz, strict=True)
    ]


PATH_MESSAGE = ('/planner/path', PATH_TYPE, START, path_cdr())
MESSAGES = [PATH_MESSAGE, *point_messages()]


def write_mcap(file, messages=MESSAGES, **options):
    """Write (topic, type, log time, bytes) with the reference writer; one channel per topic."""
    options.setdefault('chunk_size', 4000)
    with file.open('wb') as stream:
        writer = Writer(stream, **options)
        writer.start(profile='ros2')
        schemas, channels = {}, {}
        for topic, kind, time, data in messages:
            if kind not in schemas:
                text = b''
                if kind in STORE.fielddefs:
                    text = STORE.generate_msgdef(kind, ros_version=2)[0].encode()
                schemas[kind] = writer.register_schema(kind, 'ros2msg', text)
            if topic not in channels:
                name = topic.removesuffix('#2')  # a second publisher on the same topic
                channels[topic] = writer.register_channel(name, 'cdr', schemas[kind])
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    return file


def write_rosbag(folder, messages=MESSAGES, mode=None, storage=StoragePlugin.SQLITE3, version=9):
    writer = RosbagWriter(folder, version=version, storage_plugin=storage)
    if mode:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        channels = {}
        for topic, kind, time, data in messages:
            if topic not in channels:
                channels[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(channels[topic], time, data)
    return folder


def read_with_anyreader(path):
    stamp, xyz, corners = [], [], None
    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic in ('/tracker/point', '/planner/path')]
        for connection, _, raw in reader.messages(wanted):
            message = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype == PATH_TYPE:
                p = [x.pose.position for x in message.poses]
                corners = np.array([[q.x, q.y, q.z] for q in p])
                continue
            time = message.header.stamp
            stamp.append(time.sec * 10**9 + time.nanosec)
            xyz.append((message.point.x, message.point.y, message.point.z))
    return BagContent(Samples(np.array(stamp), np.array(xyz)), NominalPath(corners))


@pytest.fixture
def bag(tmp_path):
    write_bag(tmp_path / 'bag', CONTENT)
    return tmp_path / 'bag'


# ---------------------------------------------------------------- writing


def test_written_bag_reads_back_exactly(bag):
    assert_same(read_bag(bag))
    assert_same(read_bag(str(bag / 'bag_0.mcap')))
    assert read_points(bag).stamp_ns.tolist() == CONTENT.samples.stamp_ns.tolist()


def test_written_bag_is_what_rosbags_and_mcap_read(bag):
    assert_same(read_with_anyreader(bag))
    with AnyReader([bag]) as reader:  # also compares the type hashes
        first = next(reader.messages())
        assert (first[0].topic, first[1]) == ('/planner/path', CONTENT.samples.stamp_ns[0])
        assert reader.message_count == len(CONTENT.samples) + 1
        path = next(c for c in reader.connections if c.topic == '/planner/path')
        assert path.ext.offered_qos_profiles[0].durability.name == 'TRANSIENT_LOCAL'
    with (bag / 'bag_0.mcap').open('rb') as stream:
        times = [m.log_time for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()]
    assert times[1:] == CONTENT.samples.stamp_ns.tolist()


def test_written_messages_are_byte_for_byte_those_of_rosbags():
    t, xyz = CONTENT.samples.stamp_ns, CONTENT.samples.xyz
    rows = encode_points(t, xyz, 'tracker')
    assert [r.tobytes() for r in rows] == [point_cdr(*pair) for pair in zip(t, xyz, strict=True)]
    for frame in ('m', 'ma', 'mac', 'mach', 'machine', 'machines'):
        assert encode_path(CORNERS, START, frame) == path_cdr(frame=frame)


def test_metadata_is_laid_out_as_rosbags_does(bag, tmp_path):
    write_rosbag(tmp_path / 'other', storage=StoragePlugin.MCAP)
    ours, theirs = (
        yaml.safe_load((f / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
        for f in (bag, tmp_path / 'other')
    )
    assert ours.keys() == theirs.keys()
    assert ours['version'] == theirs['version'] == 9
    for a, b in zip(
        ours['topics_with_message_count'], theirs['topics_with_message_count'], strict=True
    ):
        a['topic_metadata'].pop('offered_qos_profiles')
        b['topic_metadata'].pop('offered_qos_profiles')
        assert a == b


def test_same_content_gives_same_bytes(bag, tmp_path):
    write_bag(tmp_path / 'deep' / 'er' / 'again', CONTENT)
    for name in ('bag_0.mcap', 'metadata.yaml'):
        assert (bag / name).read_bytes() == (tmp_path / 'deep/er/again' / name).read_bytes()


def test_existing_bag_is_replaced_only_when_asked(bag):
    with pytest.raises(ConfigError, match='exists already'):
        write_bag(bag, CONTENT)
    other = BagContent(some_samples(7, seed=2), CONTENT.path)
    write_bag(bag, other, overwrite=True)
    assert_same(read_bag(bag), other)
    assert [p.name for p in bag.parent.iterdir()] == ['bag']


def test_foreign_folder_is_never_overwritten(tmp_path):
    (tmp_path / 'thesis').mkdir()
    (tmp_path / 'thesis' / 'thesis.tex').touch()
    (tmp_path / 'file').touch()
    for name in ('thesis', 'file'):
        with pytest.raises(ConfigError, match='not overwritten'):
            write_bag(tmp_path / name, CONTENT, overwrite=True)
    with pytest.raises(ConfigError, match='cannot be written'):
        write_bag(tmp_path / 'file' / 'bag', CONTENT)


def test_interrupted_writing_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(Writer, 'finish', interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_bag(tmp_path / 'bag', CONTENT)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ('stamp', 'xyz', 'text'),
    [
        ([], [], 'no points'),
        ([2, 1], np.ones((2, 3)), 'increase strictly'),
        ([1, 1], np.ones((2, 3)), 'increase strictly'),
        ([1, 2], np.full((2, 3), np.nan), 'not finite'),
        ([1, 2**62], np.ones((2, 3)), 'does not fit'),
    ],
)
def test_samples_that_would_not_read_back_are_not_written(tmp_path, stamp, xyz, text):
    samples = Samples(np.array(stamp, np.int64), np.reshape(np.array(xyz, float), (-1, 3)))
    with pytest.raises(InputError, match=text):
        write_bag(tmp_path / 'bag', BagContent(samples, CONTENT.path))
    assert list(tmp_path.iterdir()) == []


def test_stamps_of_any_epoch_read_back_exactly(tmp_path):
    samples = Samples(np.array([-1_500_000_001, -1, 0, 1]), np.ones((4, 3)))
    write_bag(tmp_path / 'bag', BagContent(samples, CONTENT.path))
    assert_same(read_bag(tmp_path / 'bag'), BagContent(samples, CONTENT.path))


# ---------------------------------------------------------------- storages


@pytest.mark.parametrize('compression', list(CompressionType))
@pytest.mark.parametrize('chunked', [True, False])
def test_mcap_of_any_compression_agrees_with_rosbags(tmp_path, compression, chunked):
    file = write_mcap(tmp_path / 'a.mcap', compression=compression, use_chunking=chunked)
    assert_same(read_bag(file))
    assert_same(read_with_anyreader(file))
    assert_same(read_bag(tmp_path))  # a folder without metadata.yaml


@pytest.mark.parametrize('version', [8, 9])
@pytest.mark.parametrize('storage', list(StoragePlugin))
@pytest.mark.parametrize('mode', list(CompressionMode))
def test_every_bag_that_rosbags_writes_reads_exactly(tmp_path, storage, mode, version):
    if storage is StoragePlugin.SQLITE3 and mode is CompressionMode.STORAGE:
        pytest.skip('sqlite3 has no storage compression')
    folder = write_rosbag(tmp_path / 'bag', mode=mode, storage=storage, version=version)
    assert_same(read_bag(folder))
    assert_same(read_with_anyreader(folder))


def test_sqlite3_file_reads_without_its_folder(tmp_path):
    folder = write_rosbag(tmp_path / 'bag')
    assert_same(read_bag(folder / 'bag.db3'))


def test_file_without_indexes_and_checksums_reads(tmp_path):
    file = write_mcap(
        tmp_path / 'a.mcap',
        index_types=IndexType.NONE,
        repeat_channels=False,
        repeat_schemas=False,
        use_statistics=False,
        use_summary_offsets=False,
        enable_crcs=False,
    )
    assert_same(read_bag(file))


def split(tmp_path, cuts):
    folder = tmp_path / 'bag'
    folder.mkdir()
    names = []
    for i, (a, b) in enumerate(itertools.pairwise([1, *cuts, len(MESSAGES)])):
        names.append(f'part_{i}.mcap')
        write_mcap(folder / names[-1], [PATH_MESSAGE, *MESSAGES[a:b]])
    info = {'storage_identifier': 'mcap', 'relative_file_paths': names}
    (folder / 'metadata.yaml').write_text(yaml.safe_dump({'rosbag2_bagfile_information': info}))
    return folder


def test_parts_are_joined_and_the_latched_path_may_repeat(tmp_path):
    assert_same(read_bag(split(tmp_path, [50, 120])))


def test_missing_part_is_named(tmp_path):
    folder = split(tmp_path, [50, 120])
    (folder / 'part_1.mcap').unlink()
    with pytest.raises(InputError, match=r'1 of 3 files .*part_1\.mcap'):
        read_bag(folder)


# ---------------------------------------------------------------- layouts of messages


@pytest.mark.parametrize('compression', [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize('chunked', [True, False])
def test_foreign_topics_between_all_points_do_not_matter(tmp_path, compression, chunked):
    rng = np.random.default_rng(3)
    messages = [PATH_MESSAGE]
    for message in point_messages():
        messages.append(message)
        if rng.random() < 0.9:
            size = int(rng.integers(0, 300))
            messages.append(('/tf', TF_TYPE, message[2], b'\x05' * size))
        if rng.random() < 0.2:
            messages.append(('/log', 'a_msgs/msg/Log', message[2], point_cdr(1, (9, 9, 9))))
    file = write_mcap(tmp_path / 'a.mcap', messages, compression=compression, use_chunking=chunked)
    assert_same(read_bag(file))


@pytest.mark.parametrize('length', range(1, 17))
@pytest.mark.parametrize('little', [True, False])
def test_points_of_any_frame_length_decode(length, little):
    frame = 'abcdefghijklmnop'[:length]
    samples = some_samples(20)
    data = [
        point_cdr(t, p, frame, little) for t, p in zip(samples.stamp_ns, samples.xyz, strict=True)
    ]
    assert point_dtype(frame, '<').itemsize == len(data[0])
    assert len(data[0]) == 4 + 13 + length + (-(13 + length)) % 8 + 24
    gap = [b'\xff' * (i % 5) + d for i, d in enumerate(data)]
    size = np.array([len(d) for d in data])
    start = np.cumsum([len(g) for g in gap]) - size
    stamp, xyz = decode_points(np.frombuffer(b''.join(gap), np.uint8), start, size, frame)
    assert stamp.tobytes() == samples.stamp_ns.tobytes()
    assert xyz.tobytes() == samples.xyz.tobytes()


def test_big_endian_and_several_publishers_on_one_topic(tmp_path):
    little, big = point_messages(), point_messages(topic='/tracker/point#2', little=False)
    mixed = [pair[i % 3 == 0] for i, pair in enumerate(zip(little, big, strict=True))]
    path = ('/planner/path', PATH_TYPE, START, path_cdr(little=False))
    assert_same(read_bag(write_mcap(tmp_path / 'a.mcap', [path, *mixed])))


def test_trailing_padding_is_ignored_as_rosbags_does(tmp_path):
    padded = [(a, b, c, d + bytes(i % 4)) for i, (a, b, c, d) in enumerate(MESSAGES)]
    assert_same(read_bag(write_mcap(tmp_path / 'a.mcap', padded)))
    padded[9] = (*padded[9][:3], padded[9][3] + bytes(4))
    with pytest.raises(InputError, match=r'message 8 is no PointStamped .* follow its last field'):
        read_bag(write_mcap(tmp_path / 'a.mcap', padded))


def test_poses_may_leave_their_frame_empty(tmp_path):
    path = (*PATH_MESSAGE[:3], path_cdr(pose_frame=''))
    assert_same(read_bag(write_mcap(tmp_path / 'a.mcap', [path, *MESSAGES[1:]])))


# ---------------------------------------------------------------- order


def reordered(order, log_time=None):
    points = [MESSAGES[1:][i] for i in order]
    if log_time is not None:
        points = [(p[0], p[1], int(t), p[3]) for p, t in zip(points, log_time, strict=True)]
    return [PATH_MESSAGE, *points]


def test_points_swapped_by_transport_are_sorted_with_a_warning(tmp_path, caplog):
    order = np.arange(200)
    order[50:60] = order[50:60][::-1]
    file = write_mcap(tmp_path / 'a.mcap', reordered(order, START + np.arange(200)))
    with caplog.at_level(logging.WARNING):
        assert_same(read_bag(file))
    assert 'stamps went back 9 times' in caplog.text


def test_file_order_is_not_the_order_of_reception(tmp_path, caplog):
    order = np.random.default_rng(4).permutation(200)
    assert_same(read_bag(write_mcap(tmp_path / 'a.mcap', reordered(order))))
    assert not caplog.records


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


def test_clock_set_back_is_refused(tmp_path):
    later = some_samples()
    points = point_messages(Samples(later.stamp_ns + 10**10, later.xyz)) + point_messages()
    messages = [(a, b, START + i, d) for i, (a, b, _, d) in enumerate([PATH_MESSAGE, *points])]
    with pytest.raises(InputError, match=r'goes back by \d+\.\d+ s at sample 200'):
        read_bag(write_mcap(tmp_path / 'a.mcap', messages))


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
def test_wrong_frame_of_a_point_is_named(tmp_path, frame, shown, little):
    messages = list(MESSAGES)
    messages[42] = (*MESSAGES[42][:3], point_cdr(START, (1, 2, 3), frame, little))
    with pytest.raises(InputError, match=f"message 41: frame_id is {shown}, expected 'tracker'"):
        read_bag(write_mcap(tmp_path / 'a.mcap', messages))


@pytest.mark.parametrize(
    ('path', 'text'),
    [
        (path_cdr(frame=''), "frame_id is empty, expected 'machine'"),
        (path_cdr(frame='map'), "frame_id is 'map', expected 'machine'"),
        (path_cdr(pose_frame='map'), "pose 0: frame_id is 'map', expected 'machine'"),
        (path_cdr(points=[]), '0 points without any motion'),
        (path_cdr(points=CORNERS[:1]), '1 points without any motion'),
        (path_cdr(points=CORNERS * np.nan), 'point 0 is not finite'),
        (path_cdr(points=CORNERS * 1e4), r'point 1, .* is beyond 1000 m; the unit is m'),
        (path_cdr()[:-1], 'no nav_msgs/msg/Path in CDR .*it ends early'),
        (path_cdr() + bytes(4), 'no nav_msgs/msg/Path in CDR .*follow its last field'),
        (path_cdr()[:24] + b'\xff' * 4 + path_cdr()[28:], '4294967295 poses do not fit'),
        (b'', 'no nav_msgs/msg/Path in CDR .*begins with nothing'),
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


def no_messages(file, kinds):
    with file.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        for topic, kind in kinds:
            writer.register_channel(topic, 'cdr', writer.register_schema(kind, 'ros2msg', b''))
        writer.finish()
    return file


def test_topics_without_messages_are_explained(tmp_path):
    kinds = [('/tracker/point', POINT_TYPE), ('/planner/path', PATH_TYPE)]
    file = no_messages(tmp_path / 'a.mcap', kinds)
    with pytest.raises(InputError, match='/tracker/point: no points'):
        read_bag(file)


@pytest.mark.parametrize(
    ('value', 'text'),
    [
        (np.nan, 'not finite'),
        (np.frombuffer(struct.pack('<Q', 0x7FF0000000000001))[0], 'not finite'),  # signalling
        (np.inf, 'not finite'),
        (4321.0, 'the unit is m'),
    ],
)
def test_unusable_points_are_counted_and_the_first_located(tmp_path, value, text):
    samples = some_samples()
    samples.xyz[[17, 99]] = value
    file = write_mcap(tmp_path / 'a.mcap', [PATH_MESSAGE, *point_messages(samples)])
    seconds = f'{samples.time[17]:.6f}'
    with pytest.raises(InputError, match=f'2 of 200 .* sample 17, {seconds} s .*{text}'):
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
        f'dropped 2 of 200 points in the origin of the tracker (no beam), the first '
        f'{samples.time[17]:.6f} s' in caplog.text
    )


def test_a_beam_broken_most_of_the_time_is_an_error(tmp_path):
    samples = some_samples()
    samples.xyz[:101] = 0.0
    file = write_mcap(tmp_path / 'a.mcap', [PATH_MESSAGE, *point_messages(samples)])
    with pytest.raises(InputError, match='101 of 200 points lie in the origin of the tracker'):
        read_bag(file)


@pytest.mark.parametrize(
    ('data', 'text'),
    [
        (b'', 'begins with nothing'),
        (b'\x00\x03' + point_cdr(1, (1, 2, 3))[2:], 'begins with 00 03'),
        (point_cdr(1, (1, 2, 3))[:30], 'ends early'),
        (point_cdr(1, (1, 2, 3))[:12] + b'\xff' * 40, 'is not terminated'),
        (point_cdr(1, (1, 2, 3))[:8] + b'\xff' * 4 + point_cdr(1, (1, 2, 3))[12:], 'nanosec'),
    ],
)
def test_broken_point_message_is_named(tmp_path, data, text):
    messages = list(MESSAGES)
    messages[13] = (*messages[13][:3], data)
    with pytest.raises(InputError, match=f'message 12.*{text}'):
        read_bag(write_mcap(tmp_path / 'a.mcap', messages))


# ---------------------------------------------------------------- wrong places


@pytest.mark.parametrize(
    'name', ['none', 'none.mcap', 'a.txt', 'a.bag', 'bag/metadata.yaml', 'x\0y', 'n' * 300]
)
def test_what_cannot_be_a_bag_is_wrong_usage(bag, name):
    for existing in ('a.txt', 'a.bag'):
        (bag.parent / existing).write_text('hello')
    with pytest.raises(ConfigError) as caught:
        read_bag(bag.parent / name)
    assert caught.value.exit_code == 2


def test_foreign_folders_are_unusable_input(tmp_path):
    with pytest.raises(InputError, match='holds neither'):
        read_bag(tmp_path)
    (tmp_path / 'photo.jpg').touch()
    with pytest.raises(InputError, match='holds neither'):
        read_bag(tmp_path)
    for name in 'ab':
        write_bag(tmp_path / name, CONTENT)
    with pytest.raises(InputError, match=r'holds some \(a, b\); name one'):
        read_bag(tmp_path)


def test_several_recordings_in_a_folder_are_listed(bag):
    (bag / 'metadata.yaml').unlink()
    assert_same(read_bag(bag))
    shutil.copy(bag / 'bag_0.mcap', bag / 'other.mcap')
    with pytest.raises(InputError, match=r'holds 2 recordings \(bag_0\.mcap, other\.mcap\)'):
        read_bag(bag)


@pytest.mark.parametrize(
    'text',
    [
        '',
        '[' * 5000,
        'a: {',
        'a: 2020-99-99',
        '\0',
        '- 1',
        'rosbag2_bagfile_information: 3',
        'rosbag2_bagfile_information: {relative_file_paths: []}',
        'rosbag2_bagfile_information: {relative_file_paths: [gone.mcap]}',
        'rosbag2_bagfile_information: {relative_file_paths: [[]], compression_mode: FILE}',
        'rosbag2_bagfile_information: {relative_file_paths: [bag_0.mcap], compression_mode: FILE}',
    ],
)
def test_useless_metadata_is_unusable_input(bag, text):
    (bag / 'metadata.yaml').write_text(text)
    with pytest.raises(InputError):
        read_bag(bag)


# ---------------------------------------------------------------- damage


def cuts(size):
    return [int(size * k / 20) for k in range(20)]


@pytest.mark.parametrize(
    'options',
    [
        {'compression': CompressionType.NONE},
        {'compression': CompressionType.LZ4},
        {'compression': CompressionType.ZSTD},
        {'use_chunking': False},
    ],
)
def test_mcap_cut_off_anywhere_is_unusable_input(tmp_path, options):
    file = write_mcap(tmp_path / 'a.mcap', **options)
    whole = file.read_bytes()
    for cut in [*cuts(len(whole)), *range(1, 10), len(whole) - 1]:
        file.write_bytes(whole[:cut])
        with pytest.raises(InputError, match='is empty' if not cut else 'is cut off|is no MCAP'):
            read_bag(file)
    file.write_bytes(whole[: len(whole) // 2] + mcap_messages.MAGIC)
    with pytest.raises(InputError, match='mcap recover'):
        read_bag(file)


@pytest.mark.parametrize(
    ('storage', 'mode'),
    [
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
    ],
)
def test_other_storage_cut_off_anywhere_is_unusable_input(tmp_path, storage, mode):
    folder = write_rosbag(tmp_path / 'bag', mode=mode, storage=storage)
    (file,) = (p for p in folder.iterdir() if p.name != 'metadata.yaml')
    whole = file.read_bytes()
    for cut in cuts(len(whole)):
        file.write_bytes(whole[:cut])
        with pytest.raises(InputError, match='bag'):
            read_bag(folder)


def result_or_none(path):
    """Content if the bag is usable, None for InputError; anything else fails the test."""
    try:
        return read_bag(path)
    except InputError as error:
        assert error.exit_code == 3
        assert str(error)
        return None


@pytest.mark.parametrize(
    'options',
    [
        {'compression': CompressionType.NONE},
        {'compression': CompressionType.LZ4},
        {'compression': CompressionType.ZSTD},
        {'use_chunking': False},
    ],
)
@pytest.mark.parametrize('seed', range(2))
def test_changed_bytes_give_the_right_content_or_an_error(tmp_path, options, seed):
    file = write_mcap(tmp_path / 'a.mcap', enable_data_crcs=True, **options)
    whole = np.fromfile(file, np.uint8)
    rng = np.random.default_rng(seed)
    for _ in range(80):
        broken = whole.copy()
        at = int(rng.integers(0, whole.size))
        broken[at : at + int(rng.choice([1, 1, 8, 200]))] ^= np.uint8(rng.integers(1, 256))
        broken.tofile(file)
        content = result_or_none(file)
        if content is not None:
            assert_same(content)


@pytest.mark.parametrize('storage', list(StoragePlugin))
@pytest.mark.parametrize('mode', [CompressionMode.NONE, CompressionMode.MESSAGE])
def test_changed_bytes_without_checksums_never_crash(tmp_path, caplog, storage, mode):
    folder = write_rosbag(tmp_path / 'bag', mode=mode, storage=storage)
    rng = np.random.default_rng(7)
    for file in sorted(folder.iterdir()):
        whole = np.fromfile(file, np.uint8)
        for _ in range(40):
            broken = whole.copy()
            broken[rng.integers(0, whole.size, 3)] = rng.integers(0, 256, 3)
            broken.tofile(file)
            result_or_none(folder)
        whole.tofile(file)


@pytest.mark.parametrize('fill', ['noise', 'zero', 'ones'])
def test_garbage_is_unusable_input(tmp_path, fill):
    rng = np.random.default_rng(5)
    for size in (1, 7, 8, 16, 17, 1000, 100_000):
        body = {
            'noise': rng.bytes(size),
            'zero': bytes(size),
            'ones': b'\xff' * size,
        }[fill]
        for data in (body, mcap_messages.MAGIC + body + mcap_messages.MAGIC):
            for name in ('a.mcap', 'a.db3'):
                (tmp_path / name).write_bytes(data)
                assert result_or_none(tmp_path / name) is None


def record(opcode, content):
    return struct.pack('<BQ', opcode, len(content)) + content


def chunk(size, compression, data):
    head = struct.pack('<QQQII', 0, 0, size, 0, len(compression)) + compression.encode()
    return record(6, head + struct.pack('<Q', len(data)) + data)


def text(value):
    return struct.pack('<I', len(value)) + value.encode()


CHANNEL = record(4, struct.pack('<HH', 1, 0) + text('/a') + text('cdr') + struct.pack('<I', 0))


@pytest.mark.parametrize(
    ('body', 'reason'),
    [
        (chunk(2**62, '', b''), 'states 4611686018427387904 bytes'),
        (chunk(2**29, 'lz4', b'\x04"M\x18'), 'decompressed'),
        (chunk(2**29, 'zstd', b'\x28\xb5\x2f\xfd\x20\x00'), 'states 536870912 bytes'),
        (chunk(5, '', b'abcd'), '4 bytes instead of 5'),
        (chunk(5, 'bz2', b'abcde'), "'bz2' is not supported"),
        (chunk(9, '', record(0x20, b'')), None),
        (chunk(0, '', b''), None),
        (record(5, bytes(21)), 'too short'),
        (record(5, bytes(22)), 'channel 0 is not described'),
        (CHANNEL + record(5, b'\x01' + bytes(21)), None),
        (record(4, b'\x01'), 'Channel record cannot be decoded'),
        (CHANNEL + CHANNEL.replace(b'/a', b'/b'), 'defined twice'),
        (record(0x90, b'private'), None),
        (struct.pack('<BQ', 0x90, 2**63), 'cut off'),
        (record(11, struct.pack('<QHIIIIQQI', 3, *[0] * 8)), 'states 3 messages but holds 0'),
        (record(15, struct.pack('<I', 7)), 'checksum of the data section'),
    ],
)
def test_structure_of_a_file_is_checked(tmp_path, body, reason):
    file = tmp_path / 'a.mcap'
    magic, end = mcap_messages.MAGIC, record(15, bytes(4)) + record(2, bytes(20))
    file.write_bytes(magic + record(1, bytes(8)) + body + end + magic)
    if reason is None:
        assert list(McapMessages(file, {}, {})) == []
    else:
        with pytest.raises(InputError, match=reason):
            list(McapMessages(file, {}, {}))


def test_chunk_with_wrong_checksum_is_named(tmp_path):
    file = write_mcap(tmp_path / 'a.mcap', compression=CompressionType.NONE)
    data = bytearray(file.read_bytes())
    data[data.index(CONTENT.samples.xyz[30].tobytes())] ^= 1
    file.write_bytes(data)
    with pytest.raises(InputError, match=r'checksum of a chunk is wrong; .*mcap recover'):
        read_bag(file)
