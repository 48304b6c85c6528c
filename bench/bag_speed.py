# SPDX-License-Identifier: Apache-2.0
"""Time of read_bag against rosbags deserialising the same bag, both warm, in one run.

Usage: PYTHONPATH=src/otf_core python bench/bag_speed.py [POINTS]
"""

from __future__ import annotations

import struct
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore
from with_rosbags import read_with_rosbags

from otf_core.bags.bag import BagContent, read_bag, write_bag
from otf_core.bags.cdr import encode_path, encode_points
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath

TOPICS = {
    '/planner/path': 'nav_msgs/msg/Path',
    '/tracker/point': 'geometry_msgs/msg/PointStamped',
    '/tf': 'geometry_msgs/msg/TransformStamped',
}
REPEATS = 3


def timed(work: Callable[[], Any], repeats: int = 1) -> tuple[float, Any]:
    """Return the shortest time of some repeats in s, and the last result."""
    best, result = float('inf'), None
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - start)
    return best, result


def some_content(n: int) -> BagContent:
    """Return a run of n samples at about 1 kHz."""
    rng = np.random.default_rng(0)
    stamp = 1_760_000_000_000_000_000 + np.cumsum(rng.integers(500_000, 1_500_000, n))
    path = NominalPath(np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.6, 0.5, -0.4]]))
    return BagContent(Samples(stamp, rng.normal(size=(n, 3))), path)


def write_mixed(file: Path, content: BagContent, compression: CompressionType, **options) -> None:
    """Write an .mcap file with a /tf message of varying length after every point."""
    store, samples = get_typestore(Stores.ROS2_JAZZY), content.samples
    rows = encode_points(samples.stamp_ns, samples.xyz, 'tracker')
    with file.open('wb') as stream:
        writer = Writer(stream, compression=compression, **options)
        writer.start(profile='ros2')
        channel = {}
        for topic, kind in TOPICS.items():
            text = store.generate_msgdef(kind, ros_version=2)[0].encode()
            schema = writer.register_schema(kind, 'ros2msg', text)
            channel[topic] = writer.register_channel(topic, 'cdr', schema)
        times = samples.stamp_ns.tolist()
        path = encode_path(content.path.points, times[0], 'machine')
        writer.add_message(channel['/planner/path'], times[0], path, times[0])
        for i, (stamp, row) in enumerate(zip(times, rows, strict=True)):
            writer.add_message(channel['/tracker/point'], stamp, row.tobytes(), stamp)
            tf = b'\x00\x01\x00\x00' + struct.pack('<qq', i, i) * (4 + i % 3)
            writer.add_message(channel['/tf'], stamp, tf, stamp)
        writer.finish()


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 500_000
    content = some_content(n)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        seconds, _ = timed(lambda: write_bag(folder / 'own', content))
        print(f'{n} points; write_bag {seconds:.2f} s')
        bags = {'write_bag (zstd)': folder / 'own'}
        for name, compression, options in (
            ('none, /tf between', CompressionType.NONE, {}),
            ('lz4, /tf between', CompressionType.LZ4, {}),
            ('zstd, /tf between', CompressionType.ZSTD, {}),
            ('unchunked, /tf between', CompressionType.NONE, {'use_chunking': False}),
        ):
            bags[name] = folder / f'{len(bags)}.mcap'
            write_mixed(bags[name], content, compression, **options)
        print(f'{"bag":24}{"read_bag s":>12}{"points/s":>12}{"AnyReader s":>13}{"ratio":>8}')
        for name, bag in bags.items():
            own, result = timed(lambda bag=bag: read_bag(bag), REPEATS)
            assert result.samples.xyz.tobytes() == content.samples.xyz.tobytes()
            other, (stamp, _, _) = timed(lambda bag=bag: read_with_rosbags(bag), REPEATS)
            assert len(stamp) == n
            print(f'{name:24}{own:12.3f}{n / own:12.3g}{other:13.2f}{other / own:8.1f}')


if __name__ == '__main__':
    main()
