# SPDX-License-Identifier: Apache-2.0
"""Runs of other chains than three linear axes with one reflector, from the path to the tables."""

import itertools

import pytest
import yaml

import otf_core
from otf_core import cli
from otf_core.model.chain import displacement, nominal_position
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion

AXIS = {'min': 0.0, 'max': 0.3, 'table_pitch': 0.1}
COMMON = {
    'name': 'm',
    'target_offset': [0, 0, -0.1],
    'tracker': {'u_range': 5e-7, 'u_angle': 2e-6},
}
GANTRY = {**COMMON, 'chain': 'w-b-X-Y-t', 'axes': {'X': AXIS, 'Y': AXIS}}
TWO = {
    **COMMON,
    'chain': 'w-Y-b-X-Z-t',
    'axes': {'X': AXIS, 'Y': AXIS, 'Z': AXIS},
    'targets': {'long': {'link': 't', 'place': [0.06, 0.03, -0.2], 'u': 1e-4}},
}
ENDS, GRID = (0.0, 0.3), (0.0, 0.1, 0.2, 0.3)


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def driven(machine, rows, head, *options, out='bag'):
        (tmp_path / 'm.yaml').write_text(yaml.safe_dump(machine))
        lines = [head, *(','.join(map(str, row)) for row in rows)]
        (tmp_path / 'p.csv').write_text('\n'.join(lines) + '\n')
        words = ['--machine', 'm.yaml', '--path', 'p.csv', '--out', out, '--rate', '100']
        return cli.main(['simulate', *words, *(options or ('--seed', '2'))])

    return driven


def share_left(*bags):
    """Mean error that the tables of recordings leave, by that of the machine."""
    bags = bags or ('bag',)
    words = ['--machine', 'm.yaml', '--out', 'cal', '--overwrite']
    assert cli.main(['calibrate', *bags, *words]) in (0, 4)
    true = otf_core.load_tables('bag/truth_tables.json').tables
    found = otf_core.load_tables('cal/error_tables.json').tables
    q = lattice(true.machine)
    at, error = nominal_position(true.machine, q), displacement(true, q)
    rest = without_rigid_motion(error - displacement(found, q), at)
    return mean_length(rest) / mean_length(without_rigid_motion(error, at))


def test_a_gantry_in_x_and_y_is_calibrated(run):
    rows = [(x, y, 0) for y in GRID for x in ENDS] + [(x, y, 0) for x in GRID for y in ENDS]
    rows += [(0, 0, 0), (0.3, 0.3, 0), (0, 0.3, 0), (0.3, 0, 0)]
    assert run(GANTRY, rows * 2, 'x,y,z') == 0
    assert share_left() < 0.1


def test_two_reflectors_in_one_run_of_three_linear_axes(run):
    rows = []
    for target in ('tool', 'long'):
        for k, ends in itertools.product(range(3), ENDS):
            for a, b in itertools.product(GRID, GRID):
                corner = [a, b]
                rows.append((target, *corner[:k], ends, *corner[k:]))
    assert run(TWO, rows, 'target,x,y,z') == 0
    assert share_left() < 0.05
    of_tool = [row[1:] for row in rows if row[0] == 'tool']
    same_machine = ('--tables', 'bag/truth_tables.json', '--seed', '3')
    assert run(TWO, of_tool, 'x,y,z', *same_machine, out='one') == 0  # of the tool alone
    assert share_left('bag', 'one') < 0.05
