# SPDX-License-Identifier: Apache-2.0
"""Work of ``calibrate_speed.py`` that runs in processes of its own; prints seconds as JSON.

- ``repeat SAMPLES BAG``: two laps over and over until there are so many samples. Noise is drawn
  anew every time, with the same machine and the same place of the tracker; written as it comes.
- ``rosbags BAG``: read with rosbags' AnyReader into arrays.
- ``calibrate BAG OUT``: read, calibrate and write, in this process.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

MACHINE = Path(__file__).resolve().parents[1] / 'src/otf_bringup/config/machine.yaml'
SEED = 20_260_011
FRAME = b'tracker\0'
POINT = np.dtype(
    [('encapsulation', '>u4'), ('sec', '<i4'), ('nanosec', '<u4'), ('length', '<u4'),
     ('frame', f'S{len(FRAME)}'), ('padding', 'V4'), ('xyz', '<f8', 3)]
)  # fmt: skip
"""geometry_msgs/msg/PointStamped in CDR, little endian, x aligned to 8 bytes after the first 4."""


def two_laps(machine, tables, seed):
    """Simulate one run; its tracker stands at the same place in the machine for all seeds."""
    import otf_core

    return otf_core.simulate(machine, seed=seed, tables=tables, tracker_place=[0.3, -1.1, 0.2])


def repeat(samples: str, bag: str) -> dict[str, float]:
    """Write two laps over and over; memory does not grow with the number of samples."""
    import otf_core

    machine, wanted = otf_core.load_machine(MACHINE), int(samples)
    first = two_laps(machine, None, SEED)
    lap = len(first.recording.samples)
    rounds = -(-wanted // lap)
    corners = first.recording.path.points
    corners = np.concatenate([corners, *[corners[1:]] * (rounds - 1)])
    file = Path(bag)
    with file.open('wb') as stream:
        writer, channel = started(stream, corners, int(first.recording.samples.stamp_ns[0]))
        later = 0
        for k in range(rounds):
            run = two_laps(machine, first.truth, SEED + k) if k else first
            stamp = run.recording.samples.stamp_ns + later
            # every seed turns the tracker about its place: all points in the frame of the first
            turn = first.T_machine_tracker.rotation.T @ run.T_machine_tracker.rotation
            rows = encoded(stamp, run.recording.samples.xyz @ turn.T)
            for at, row in zip(stamp[: wanted - k * lap].tolist(), rows, strict=False):
                writer.add_message(channel, at, row.tobytes(), at)
            later += int(stamp[-1] - stamp[0]) + int(stamp[1] - stamp[0])
        writer.finish()
    return {'samples': wanted}


def started(stream, corners, begin):
    """Writer with the path written and the channel of the points."""
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types, channels = store.types, []
    writer = Writer(stream, compression=CompressionType.ZSTD)
    writer.start(profile='ros2')
    for topic, kind in (('/planner/path', 'nav_msgs/msg/Path'),
                        ('/tracker/point', 'geometry_msgs/msg/PointStamped')):  # fmt: skip
        text, _ = store.generate_msgdef(kind, ros_version=2)
        schema = writer.register_schema(kind, 'ros2msg', text.encode())
        channels.append(writer.register_channel(topic, 'cdr', schema))
    time_type, point = types['builtin_interfaces/msg/Time'], types['geometry_msgs/msg/Point']
    header = types['std_msgs/msg/Header'](time_type(*divmod(begin, 10**9)), 'machine')
    still = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    stamped, pose = types['geometry_msgs/msg/PoseStamped'], types['geometry_msgs/msg/Pose']
    poses = [stamped(header, pose(point(*map(float, p)), still)) for p in corners]
    path = store.serialize_cdr(types['nav_msgs/msg/Path'](header, poses), 'nav_msgs/msg/Path')
    writer.add_message(channels[0], begin, bytes(path), begin)
    return writer, channels[1]


def encoded(stamp, xyz):
    """Messages of points, one row each."""
    rows = np.zeros(len(stamp), POINT)
    rows['encapsulation'], rows['length'], rows['frame'] = 0x00010000, len(FRAME), FRAME
    rows['sec'], rows['nanosec'] = np.divmod(stamp, 10**9)
    rows['xyz'] = xyz
    return rows


def rosbags(bag: str) -> dict[str, float]:
    """Time of the read alone."""
    from with_rosbags import read_with_rosbags

    start = time.perf_counter()
    stamp, _, _ = read_with_rosbags(Path(bag))
    return {'samples': len(stamp), 'read': time.perf_counter() - start}


def calibrate(bag: str, out: str) -> dict[str, float]:
    """Times of reading, calibrating and writing, imports included where they happen."""
    import otf_core

    begin = time.perf_counter()
    recording = otf_core.read_bag(bag, MACHINE)
    read = time.perf_counter()
    result = otf_core.calibrate(recording)
    solved = time.perf_counter()
    otf_core.write_calibration(result, out, overwrite=True, report=False)
    end = time.perf_counter()
    return {'read': read - begin, 'solve': solved - read, 'write': end - solved,
            'all': end - begin, 'pieces': result.fit.pieces,
            'unknowns': result.fit.unknowns}  # fmt: skip


JOBS = {job.__name__: job for job in (repeat, rosbags, calibrate)}

if __name__ == '__main__':
    print(json.dumps(JOBS[sys.argv[1]](*sys.argv[2:])))
