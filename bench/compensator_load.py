# SPDX-License-Identifier: Apache-2.0
"""What the compensator costs and how late it answers at 1000 positions per second.

The node as a process over DDS, asked at random positions of the machine of the tables. Measured
over ``OVER`` seconds: answers, time from a position to its answer, processor time of the node.

Usage: eval "$(./otf env)"; python bench/compensator_load.py error_tables.json
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from geometry_msgs.msg import Point, PointStamped
from view_load import processor_time

from otf_bringup.domain import free_domain
from otf_core.model.tables import load_tables
from otf_msgs.msg import Compensation
from otf_ros import qos

ROOT = Path(__file__).resolve().parents[1]
SEED = 20_260_071
RATE = 1000.0
"""Hz"""
OVER = 20.0
"""s that are measured."""


def ask(publisher: object, wanted: np.ndarray, sent: np.ndarray) -> None:
    """Publish positions at ``RATE``, with their number as stamp."""
    start = time.monotonic()
    for k, (x, y, z) in enumerate(wanted.tolist()):
        message = PointStamped(point=Point(x=x, y=y, z=z))
        message.header.frame_id = 'machine'
        message.header.stamp.sec = k
        time.sleep(max(0.0, start + k / RATE - time.monotonic()))
        sent[k] = time.monotonic()
        publisher.publish(message)  # type: ignore[attr-defined]


def main() -> None:
    """Print a table of one run."""
    sys.path.insert(0, str(ROOT / 'tests'))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    from graph import Graph  # that of the tests

    file = Path(sys.argv[1]).absolute()
    machine, count = load_tables(file).tables.machine, int(OVER * RATE)
    wanted = np.random.default_rng(SEED).uniform(machine.lower, machine.upper, (count, 3))
    sent, heard = np.zeros(count), np.zeros(count)
    with tempfile.TemporaryDirectory() as scratch, free_domain() as domain:
        graph = Graph(domain, Path(scratch))
        node = graph.start('compensator', tables_file=file)
        ear, answers = graph.ear(), []

        def note(answer: Compensation) -> None:
            heard[answer.header.stamp.sec] = time.monotonic()
            answers.append(answer)

        publisher = ear.create_publisher(PointStamped, 'compensator/wanted', qos.COMMAND)
        ear.create_subscription(Compensation, 'compensator/compensation', note, qos.COMMAND)
        graph.wait(lambda: publisher.get_subscription_count() == 1, 'the compensator')
        graph.wait(lambda: ear.count_publishers('compensator/compensation') == 1, 'its answers')
        before = processor_time(node.process.pid)
        asking = threading.Thread(target=ask, args=(publisher, wanted, sent))
        asking.start()
        graph.wait(lambda: not asking.is_alive() and len(answers) == count, 'answers', 10 * OVER)
        used = processor_time(node.process.pid) - before
        late = 1e3 * np.sort(heard - sent)
        print('| asked | answered | median ms | 99 % ms | worst ms | share of a core % |')
        print('|---:|---:|---:|---:|---:|---:|')
        times = f'{np.median(late):.1f} | {late[int(0.99 * count)]:.1f} | {late[-1]:.1f}'
        share = 100 * used / (sent[-1] - sent[0])
        print(f'| {count} | {len(answers)} | {times} | {share:.0f} |')
        graph.close()


if __name__ == '__main__':
    main()
