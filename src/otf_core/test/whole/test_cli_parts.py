# SPDX-License-Identifier: Apache-2.0
"""Bags in parts, without an end or damaged, as the commands take them."""

import json
from pathlib import Path

import numpy as np
import pytest
from bag_cells import write_mcap
from cli_cells import run

from otf_core.bags.bag import BagContent, read_bag, write_bag
from otf_core.model.observation import Samples
from otf_core.model.provenance import origin_of

CELL = Path(__file__).parents[4] / 'bags' / 'y-carries-the-table'
MACHINE = CELL / 'machine.yaml'


@pytest.fixture(scope='module')
def thin():
    """Every eighth sample of a recorded run."""
    whole = read_bag(CELL / 'bag')
    samples = Samples(whole.samples.stamp_ns[::8], whole.samples.xyz[::8])
    return BagContent(samples, whole.path)


def test_parts_of_a_run_give_the_tables_of_the_whole(thin, tmp_path, capsys):
    names = [tmp_path / 'b', tmp_path / 'a']
    for name, (start, stop) in zip(names, ((2000, len(thin.samples)), (0, 2000)), strict=True):
        write_bag(name, BagContent(thin.samples.part(start, stop), thin.path))
    arguments = ('--machine', MACHINE, '--out', tmp_path / 'out', '--join')
    assert run('calibrate', *names, *arguments) == 0, capsys.readouterr().err
    tables = json.loads((tmp_path / 'out' / 'error_tables.json').read_text())
    (found,) = tables['provenance']['runs']
    assert found['sha256'] == origin_of('whole', thin.samples, thin.path).sha256
    assert tables['warnings'] == [w for w in tables['warnings'] if 'recording' not in w]


def test_bag_without_end_is_read_and_damage_inside_needs_recover(tmp_path, capsys, caplog):
    rng = np.random.default_rng(2)
    xyz = np.concatenate([rng.normal(2.0, 1e-6, (4000, 3)), rng.normal(2.1, 1e-6, (4000, 3))])
    content = BagContent(
        Samples(np.arange(8000) * 2_000_000 + 10**18, xyz), read_bag(CELL / 'bag').path
    )
    write_bag(tmp_path / 'bag', content)
    messages = read_messages(tmp_path / 'bag')
    file = write_mcap(tmp_path / 'a.mcap', messages, chunk_size=100_000)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data[:-100])
    assert run('noise', file, '--out', tmp_path / 'out') == 3
    assert 'recover: true in --config' in capsys.readouterr().err
    assert run('noise', file, '--out', tmp_path / 'out', {'recover': True}) == 0
    assert 'the damaged chunk at byte' in caplog.text
    assert 'a.mcap has no end (cut off, or still being recorded)' in caplog.text


def read_messages(folder):
    """Messages of a bag as ``write_mcap`` takes them."""
    from mcap.reader import make_reader

    with (folder / 'bag_0.mcap').open('rb') as stream:
        return [(c.topic, s.name, m.log_time, m.data)
                for s, c, m in make_reader(stream).iter_messages()]  # fmt: skip
