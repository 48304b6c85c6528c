# SPDX-License-Identifier: Apache-2.0
"""What a soak tells of a graph under faults."""

from otf_bringup.soak import FAULTS, table
from otf_bringup.soak_ear import FaultRecord
from otf_tracker_driver.emulator.faults import read_faults


def test_every_fault_of_the_soak_can_happen():
    quiet = read_faults('')
    assert all(read_faults(faults) != quiet for name, faults in FAULTS.items() if name != 'none')


def test_table_counts_losses_of_each_fault_alone():
    rows = [
        ('one', FaultRecord(samples=10, longest=1.26, gaps=1, said={'beam lost': None}), 3),
        ('two', FaultRecord(samples=20, backwards=1), 3),
    ]
    lines = table(rows).splitlines()[2:]
    assert lines == [
        '| one | beam lost | 1 | 1.3 | 10 | 0 | 3 |',
        '| two | - | 0 | 0.0 | 20 | 1 | 0 |',
    ]
