# SPDX-License-Identifier: Apache-2.0
"""The commands of the tutorial for five axes, as printed, in an empty folder."""

import json
import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest
from test_rotary_exports import IsgReader, units

from otf_core import cli
from otf_core.bags.bag import read_bag
from otf_core.model.evaluation import without_rigid_motion
from otf_core.model.kinematics import exact_position, nominal_position
from otf_core.model.machine import load_machine
from otf_core.model.tables import (
    ErrorTables,
    LocationError,
    MotionTable,
    Squareness,
    load_tables,
    tables_to_dict,
)
from otf_core.sim.axis_cell import BROKEN_BEAM

PAGE = Path(__file__).resolve().parents[4] / 'docs' / 'tutorial-five-axes.md'


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """The folder after all commands of the page."""
    place = tmp_path_factory.mktemp('empty')
    text = PAGE.read_text(encoding='utf-8')
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        for block in re.findall(r'```\n(.*?)```', text, re.DOTALL):
            for statement in [block] if '<<' in block else block.splitlines():
                if statement.startswith('./otf '):
                    assert cli.main(shlex.split(statement)[1:]) == 0, statement
                else:
                    assert subprocess.run(['bash', '-c', statement], check=False).returncode == 0
    return place


def test_every_command_of_the_tutorial_runs_and_hides_what_the_page_says(folder):
    plan = json.loads((folder / 'plan/plan.json').read_text())
    assert set(plan['forecast']['hidden']) == {'ECX', 'ECZ'}
    driven = read_bag(folder / 'before').samples.time[
        -1
    ]  # at the feed and with the dwells planned
    assert driven == pytest.approx(plan['forecast']['duration'] + 4 * BROKEN_BEAM, abs=1.0)
    tables = load_tables(folder / 'tables/error_tables.json').tables
    assert {str(n) for n, m in tables.motions.items() if not m.identifiable} == {'ECX', 'ECZ'}
    assert {f.name for f in (folder / 'plan').glob('*.MPF')} == {
        f'OTF_PATH_{k}.MPF' for k in range(1, 7)
    }
    rows = (folder / 'predicted.csv').read_text().splitlines()
    assert len(rows) == 3


def test_the_wrong_side_is_refused_as_the_page_says(folder, capsys):
    machine = str(folder / 'machine.yaml')
    (place,) = re.findall(r'`(--tracker-place=\S+)`', PAGE.read_text(encoding='utf-8'))
    arguments = ['plan', '--machine', machine, '--out', str(folder / 'other'), place]
    assert cli.main(arguments) == 2
    assert 'the table hides' in capsys.readouterr().err


def left_by_file(path, truth, count=150):
    """Mean position errors before and after, m: linear axes corrected by a reader of its own.

    A rigid displacement of the workpiece is taken out of both.
    """
    machine = truth.machine
    q = np.random.default_rng(4).uniform(machine.lower, machine.upper, (count, 5))
    reader, scale = IsgReader(path.read_text()), units(machine)
    command = np.array([reader.corrected(machine.axis_names, row * scale) for row in q]) / scale
    wanted = nominal_position(machine, q)
    return [
        np.linalg.norm(without_rigid_motion(exact_position(truth, at) - wanted, wanted), axis=1)
        .mean()
        for at in (q, command)
    ]  # fmt: skip


def test_the_exported_file_leaves_little_of_the_errors(folder):
    truth = load_tables(folder / 'before/truth_tables.json').tables
    before, after = left_by_file(folder / 'errors.csv', truth)
    assert before > 15e-6
    assert after < 0.05 * before


def smooth_tables(machine, rng):
    """Errors of two slow waves over each axis, 41 nodes, of any gauge."""

    def motion(name):
        axis = machine.axes[name.axis]
        at = np.linspace(axis.min, axis.max, 41)
        share = (at - axis.min) / (axis.max - axis.min)
        waves = (1.0, 2.0) if axis.endless else (0.7, 1.4)
        size = 6e-6 if name.is_translation else 2.5e-5
        value = sum(
            size / w * rng.normal() * np.sin(2 * np.pi * (w * share + rng.uniform()))
            for w in waves
        )
        return MotionTable(at, value, np.zeros(len(at)))

    return ErrorTables(
        machine,
        {m: motion(m) for m in machine.motions},
        {n: Squareness(rng.normal() * 3e-5) for n in machine.squareness},
        {n: LocationError(rng.normal() * (1e-5 if n[0] in 'XYZ' else 3e-5))
         for n in machine.location},
    )  # fmt: skip


def test_of_smooth_errors_less_than_a_twentieth_is_left(folder, monkeypatch):
    monkeypatch.chdir(folder)
    truth = smooth_tables(load_machine('machine.yaml'), np.random.default_rng(21))
    Path('smooth.json').write_text(json.dumps(tables_to_dict(truth)))
    Path('dwell.yaml').write_text('corner_dwell: 0.1')
    drive = '--path plan/path.csv --feed 6000 --config dwell.yaml --rate 40 --seed 12'
    for line in (
        f'simulate --machine machine.yaml --tables smooth.json {drive} --out run',
        'calibrate run --machine machine.yaml --out found',
        'export found --format isg --sign error --out found.csv',
    ):
        assert cli.main(line.split()) == 0
    before, after = left_by_file(Path('found.csv'), truth)
    assert before > 1e-5
    assert after < 0.05 * before
