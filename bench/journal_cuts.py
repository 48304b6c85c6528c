# SPDX-License-Identifier: Apache-2.0
"""Journal of a minute at 1000 samples/s: its size, and what is back after 200 random cuts.

python3 bench/journal_cuts.py [SEED]
"""

from __future__ import annotations

import logging
import sys
import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from otf_core.bags.bag import read_bag
from otf_core.bags.cdr import encode_path, encode_points
from otf_core.bags.journal import CHUNK_PERIOD, Definitions, JournalFile, Rows
from otf_core.bags.rosbag2_metadata import PATH, POINT

RATE, DURATION, CUTS = 1000, 60, 200
BAG = Path(__file__).resolve().parents[1] / 'bags' / 'y-carries-the-table' / 'bag'


def samples(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A recorded run, sampled at the rate of the bench with fresh noise of 1 um."""
    recorded = read_bag(BAG).samples
    time = np.arange(RATE * DURATION) / RATE
    stamp_ns = recorded.stamp_ns[0] + np.arange(time.size) * (10**9 // RATE)
    xyz = np.stack([np.interp(time, recorded.time, axis) for axis in recorded.xyz.T], axis=1)
    return stamp_ns, xyz + rng.normal(scale=1e-6, size=xyz.shape)


def main() -> int:
    """Write, cut, read; tell."""
    logging.disable()
    rng = np.random.default_rng(int(sys.argv[1]) if len(sys.argv) > 1 else 20261122)
    stamp_ns, xyz = samples(rng)
    path = encode_path(read_bag(BAG).path.points, int(stamp_ns[0]), PATH.frame)
    with tempfile.TemporaryDirectory() as folder:
        name = Path(folder) / 'a.mcap'
        file = JournalFile(name, Definitions({}).both[0])
        step = round(RATE * CHUNK_PERIOD)
        for at in range(0, stamp_ns.size, step):
            rows = slice(at, at + step)
            data = encode_points(stamp_ns[rows], xyz[rows], POINT.frame)
            first = [] if at else [Rows(PATH, path, len(path), 0)]
            points = Rows(POINT, data.tobytes(), data.dtype.itemsize, int(1e9 * at / RATE))
            file.add([*first, points])
            file.write()
        file.close()
        with name.open('rb') as stream:
            chunks = make_reader(stream).get_summary().chunk_indexes
        ends = [c.chunk_start_offset + c.chunk_length for c in chunks]
        whole = name.read_bytes()
        right = 0
        for cut in rng.integers(ends[0], len(whole), CUTS).tolist():
            name.write_bytes(whole[:cut])
            found = read_bag(name).samples
            expected = step * sum(end <= cut for end in ends)
            right += found.xyz.tobytes() == xyz[:expected].tobytes()
    print(f'{len(whole) / 1e6 * 60 / DURATION:.1f} MB a minute at {RATE} samples/s')
    print(f'{right} of {CUTS} cuts: every complete chunk is back, nothing else')
    return 0 if right == CUTS else 1


if __name__ == '__main__':
    raise SystemExit(main())
