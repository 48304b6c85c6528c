# SPDX-License-Identifier: Apache-2.0
"""The recorded bags, replayed through the real nodes: the true errors, bit for bit as offline."""

from pathlib import Path

import pytest
from cells import share_left
from graph import offline, without_date

from otf_core.bags.bag import read_bag

BAGS = sorted(file.parent for file in Path(__file__).parents[1].glob('bags/*/machine.yaml'))
PLAYED = [folder for folder in BAGS if folder.name not in ('trunnion', 'y-carries-the-table')]
"""Those that no other test plays: see the contract, and ``test_crash``."""


@pytest.mark.parametrize('folder', PLAYED, ids=lambda folder: folder.name)
def test_replayed_bag_gives_the_true_errors_and_the_same_bits_as_offline(graph, tmp_path, folder):
    bag, machine_file = folder / 'bag', folder / 'machine.yaml'
    out = tmp_path / 'out'
    graph.start(
        'calibrator',
        machine_file=machine_file,
        output_directory=out,
        finish_at_standstill=False,  # take the bag to its end, as the offline command does
    )
    replay = {'backend': 'replay', 'replay.bag': bag}
    graph.start('tracker_driver', **replay, time_scale=50.0)
    result, _ = graph.wait_for_result()
    assert result.status == result.OK
    assert (result.samples_lost, result.samples) == (0, len(read_bag(bag).samples))
    live = Path(result.output_directory) / 'error_tables.json'
    assert share_left(live, folder / 'truth.json') < 0.02
    again = offline(bag, machine_file, tmp_path / 'offline')
    assert without_date(live.read_bytes()) == again.replace(b'"name": "bag"', b'"name": "samples"')


def test_the_bags_of_all_chains_are_small():
    assert len(BAGS) == 4
    files = [f for folder in BAGS for f in folder.rglob('*') if f.is_file()]
    assert sum(file.stat().st_size for file in files) < 10e6
