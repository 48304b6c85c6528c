# SPDX-License-Identifier: Apache-2.0
"""Several bags of one machine as one, and plans that are simulated as written."""

import json

import numpy as np
import pytest
import yaml
from cli_cells import run
from core_cells import some_machine

from otf_core.prediction.calibration_document import load_tables, tables_to_dict
from otf_core.sim.cell import random_tables

OFFSETS = ([0.0, 0.0, -0.15], [0.08, 0.0, -0.15], [0.0, 0.08, -0.15])
FEEDS = ('15000', '9000', '12000')


@pytest.fixture(scope='module')
def runs(tmp_path_factory):
    """Three bags of one machine: other target offsets, stations and feeds, stops at corners."""
    folder = tmp_path_factory.mktemp('runs')
    machine = some_machine(pitch=0.1)
    truth = tables_to_dict(random_tables(machine, 5e-5, np.random.default_rng(6)))
    (folder / 'truth.json').write_text(json.dumps(truth))
    for k, offset in enumerate(OFFSETS):
        data = machine.to_dict() | {'target_offset': offset}
        (folder / f'machine{k}.yaml').write_text(yaml.safe_dump(data))
        code = run('simulate', '--machine', folder / f'machine{k}.yaml', '--out',
                   folder / f'bag{k}', '--tables', folder / 'truth.json', '--seed', 20 + k,
                   '--feed', FEEDS[k], '--rate', '100',
                   {'levels': 3, 'passes': 1, 'corner_dwell': 0.3, 'end_dwell': 1})  # fmt: skip
        assert code == 0
    return folder


def solve_runs(folder, out, numbers, *options):
    """Calibrate some of the bags as one; content of the tables file."""
    bags = [folder / f'bag{k}' for k in numbers]
    machines = [word for k in numbers for word in ('--machine', folder / f'machine{k}.yaml')]
    options = ({'piece_length': 0.016}, *options)
    assert run('calibrate', *bags, *machines, '--out', out, *options) == 0
    return json.loads((out / 'error_tables.json').read_text())


@pytest.fixture(scope='module')
def three(runs):
    """Folder of the calibration of all three bags as one."""
    solve_runs(runs, runs / 'three', (0, 1, 2))
    return runs / 'three'


@pytest.mark.parametrize(
    ('numbers', 'unseen'),
    [((0,), ['ECY', 'EAZ', 'EBZ', 'ECZ']), ((0, 1), ['EAZ'])],
)
def test_fewer_than_three_target_offsets_leave_motions_unseen(runs, tmp_path, numbers, unseen):
    data = solve_runs(runs, tmp_path, numbers)
    assert data['not_identifiable'] == unseen
    assert data['fit']['path_mae_after'] < 0.05 * data['fit']['path_mae_before']


def test_three_target_offsets_show_all_motions_as_they_are(runs, three):
    assert json.loads((three / 'error_tables.json').read_text())['not_identifiable'] == []
    tables = load_tables(three / 'error_tables.json').tables
    truth = load_tables(runs / 'truth.json').tables
    for name in ('ECY', 'EAZ', 'EBZ', 'ECZ'):
        table, node = tables.motions[name], truth.motions[name]
        true = node.value - np.interp(0.0, node.position, node.value)
        assert np.all(np.abs(table.value - true) <= 4 * table.u + 1e-12), name


# ---------------------------------------------------------------- simulate a written plan


@pytest.fixture(scope='module')
def planned(tmp_path_factory):
    """Folder with machine.yaml and the plan of a time budget."""
    folder = tmp_path_factory.mktemp('planned')
    (folder / 'machine.yaml').write_text(yaml.safe_dump(some_machine(pitch=0.1).to_dict()))
    code = run('plan', '--machine', folder / 'machine.yaml', '--out', folder / 'plan',
               {'passes': 1, 'levels': 2, 'corner_dwell': 0.3, 'rate': 100})  # fmt: skip
    assert code == 0
    return folder


def test_dwells_of_a_plan_may_be_made_longer_for_the_standstill_method(planned, tmp_path):
    common = ('--machine', planned / 'machine.yaml', '--out')
    code = run('simulate', *common, tmp_path / 'bag', '--path', planned / 'plan' / 'plan.json',
               '--rate', '100', {'corner_dwell': 0.5})  # fmt: skip
    assert code == 0
    assert run('calibrate', tmp_path / 'bag', *common, tmp_path / 'out', '--method',
               'standstill') == 0  # fmt: skip
