# SPDX-License-Identifier: Apache-2.0
"""What a killed driver leaves, and what an orderly end does not."""

import os
import signal
import subprocess
import sys

from otf_tracker_driver.handover import LONGEST, DriverRemains, Handover, place

LAST = 1_750_000_000 * 10**9
WORK = """
import sys, time
from pathlib import Path
from otf_tracker_driver.handover import Handover
handover = Handover(Path(sys.argv[1]))
for k in range(100):
    handover.note('0123456789ab', k + 1, 1_750_000_000 * 10**9 + k)
print(flush=True)
time.sleep(60)
"""


def killed(file):
    """Have a process note a hundred samples and kill it."""
    command = [sys.executable, '-c', WORK, str(file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        os.kill(process.pid, signal.SIGKILL)


def test_killed_process_leaves_what_it_has_noted_last_and_once(tmp_path):
    file = tmp_path / 'of' / 'a.stream'
    killed(file)
    handover = Handover(file)
    assert handover.take(LAST + 10**9) == DriverRemains('0123456789ab', 100, LAST + 99)
    assert handover.take(LAST + 10**9) is None


def test_nothing_is_left_for_stamps_before_or_much_later_or_after_an_orderly_end(tmp_path):
    file = tmp_path / 'a.stream'
    killed(file)
    assert Handover(file).take(LAST + 99) is None
    assert Handover(file).take(LAST + 99 + LONGEST) is None
    Handover(file).clear()
    assert Handover(file).take(LAST + 10**9) is None


def test_folder_that_cannot_be_written_to_and_foreign_bytes_change_nothing(tmp_path):
    (tmp_path / 'file').write_bytes(b'\xff' * 100)
    assert Handover(tmp_path / 'file' / 'a.stream').take(LAST) is None
    assert Handover(tmp_path / 'file').take(LAST) is None


def test_every_node_of_every_domain_has_a_file_of_its_own(monkeypatch):
    monkeypatch.setenv('ROS_HOME', '/ros')
    monkeypatch.setenv('ROS_DOMAIN_ID', '7')
    assert (
        str(place('/cell/tracker_driver'))
        == '/ros/otf_tracker_driver/7-cell-tracker_driver.stream'
    )
