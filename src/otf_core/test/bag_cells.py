# SPDX-License-Identifier: Apache-2.0
"""Bags for the tests, written and read by the reference libraries."""

import numpy as np
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagWriter
from rosbags.typesys import Stores, get_typestore

from otf_core.bags.bag import BagContent
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
