# SPDX-License-Identifier: Apache-2.0
"""Files say when, from what, by what and in which convention they were made."""

import hashlib
import json
import re
from datetime import datetime, timezone
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from cli_cells import run
from core_cells import some_machine

import otf_core
from otf_core.bags.bag import BagContent, read_bag, write_bag
from otf_core.errors import ConfigError
from otf_core.files.writing import tidy
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.provenance import moment, origin_of, provenance

ROOT = Path(__file__).resolve().parents[4]
SIGN = 'error = actual minus nominal, of the target relative to the table, in machine coordinates'
QUICK = ({'levels': 2, 'passes': 1, 'rate': 100, 'corner_dwell': 0.2},)


@pytest.fixture(scope='module')
def cell(tmp_path_factory):
    """Folder with machine.yaml, a simulated bag with effects, and results of several verbs."""
    folder = tmp_path_factory.mktemp('cell')
    machine = folder / 'machine.yaml'
    text = yaml.safe_dump(some_machine(pitch=0.1).to_dict())
    machine.write_text('# a comment is part of the file\n' + text)
    (folder / 'effects.yaml').write_text('- effect: backlash\n  parameters: {B_X: 2.0e-06}\n')
    (folder / 'points.csv').write_text('x,y,z\n0.1,0.1,-0.1\n')
    tables = folder / 'results' / 'error_tables.json'
    before = datetime.now(timezone.utc)
    for command in (
        ('simulate', '--machine', machine, '--out', folder / 'bag', '--seed', '5', '--effects',
         folder / 'effects.yaml', *QUICK),
        ('calibrate', folder / 'bag', '--machine', machine, '--out', tables.parent),
        ('noise', folder / 'bag', '--out', folder / 'noise'),
        ('predict', '--tables', tables, '--points', folder / 'points.csv', '--out',
         folder / 'errors.csv'),
    ):  # fmt: skip
        assert run(*command) == 0, command
    return SimpleNamespace(folder=folder, machine=machine, tables=tables, before=before)


def block_of(file):
    return json.loads(file.read_text())['provenance']


FILES = {
    'bag/truth_tables.json': 'simulate',
    'bag/simulation.json': 'simulate',
    'results/error_tables.json': 'calibrate',
    'noise/noise.json': 'noise',
}


@pytest.mark.parametrize('name', FILES)
def test_every_json_says_when_by_what_and_in_which_convention(cell, name):
    block = block_of(cell.folder / name)
    written = datetime.fromisoformat(block['written'].replace('Z', '+00:00'))
    assert cell.before.replace(microsecond=0) <= written <= datetime.now(timezone.utc)
    assert block['software'] == {'name': 'otf_core', 'version': otf_core.__version__}
    assert block['verb'] == FILES[name]
    assert block['convention'].startswith(SIGN)
    assert ('k = 1' in block['coverage']) == (FILES[name] != 'simulate')


@pytest.mark.parametrize('name', ['bag/simulation.json', 'results/error_tables.json'])
def test_hash_of_the_machine_is_that_of_its_file(cell, name):
    (machine,) = block_of(cell.folder / name)['machines']
    assert machine == {
        'name': 'small', 'sha256': hashlib.sha256(cell.machine.read_bytes()).hexdigest(),
    }  # fmt: skip


@pytest.mark.parametrize('name', ['bag/simulation.json', 'results/error_tables.json'])
def test_date_of_measurement_and_hash_of_the_bag_are_those_of_its_content(cell, name):
    content = read_bag(cell.folder / 'bag')
    stamps, digest = content.samples.stamp_ns, hashlib.sha256()
    for part in (stamps, content.samples.xyz, content.path.points):
        digest.update(part.tobytes())
    block = block_of(cell.folder / name)
    (entry,) = block['runs']
    assert entry['sha256'] == digest.hexdigest()
    assert (entry['name'], entry['samples']) == ('bag', len(stamps))
    assert entry['first_stamp_ns'] == stamps[0]
    assert entry['last_stamp_ns'] == stamps[-1]
    assert block['measured'] == entry['measured']
    assert block['measured']['first'] == '2023-11-14T22:13:20.000000Z'


def test_hash_follows_content_and_not_storage(tmp_path):
    samples = Samples(np.arange(5) * 10**9 + 10**18, np.linspace(0, 1, 15).reshape(5, 3))
    path = NominalPath(np.array([[0.0, 0, 0], [1, 0, 0]]))
    write_bag(tmp_path / 'bag', BagContent(samples, path))
    again = read_bag(tmp_path / 'bag')
    same = origin_of('a', samples, path).sha256
    assert origin_of('b', again.samples, again.path).sha256 == same
    for changed in (
        origin_of('a', samples, NominalPath(path.points[::-1])),
        origin_of('a', samples.part(0, 4), path),
        origin_of('a', Samples(samples.stamp_ns, samples.xyz + 1e-9), path),
        origin_of('a', samples),
    ):
        assert changed.sha256 != same


@pytest.mark.parametrize(
    ('stamp', 'text'),
    [
        (1_700_000_000_123_456_789, '2023-11-14T22:13:20.123456Z'),
        (946_684_800_000_000_000, '2000-01-01T00:00:00.000000Z'),
        (0, None),
        (-1, None),
        (86_400_000_000_000, None),
        (2**63 - 1, '2262-04-11T23:47:16.854775Z'),
    ],
)
def test_stamps_of_another_epoch_tell_no_date(stamp, text):
    assert moment(stamp) == text


def test_date_of_writing_can_be_given_so_that_results_repeat_to_the_last_byte(
    cell, tmp_path, monkeypatch
):
    monkeypatch.setenv('SOURCE_DATE_EPOCH', '1700000000')
    for name in ('one', 'two'):
        out = tmp_path / name / 'bag'
        assert run('simulate', '--machine', cell.machine, '--out', out, *QUICK) == 0
    files = sorted((tmp_path / 'one' / 'bag').iterdir())
    assert len(files) == 5
    for file in files:
        assert file.read_bytes() == (tmp_path / 'two' / 'bag' / file.name).read_bytes(), file.name
    block = block_of(tmp_path / 'one' / 'bag' / 'simulation.json')
    assert block['written'] == '2023-11-14T22:13:20Z'
    monkeypatch.setenv('SOURCE_DATE_EPOCH', 'yesterday')
    with pytest.raises(ConfigError, match='yesterday'):
        provenance('noise')


def test_all_packages_and_the_command_have_one_version(capsys):
    version = otf_core.__version__
    files = sorted(ROOT.glob('src/*/package.xml'))
    assert len(files) > 5
    for file in files:
        assert ElementTree.parse(file).getroot().findtext('version') == version, file
    for file in sorted(ROOT.glob('src/*/setup.py')):
        stated = re.search(r"version='(.+)'", file.read_text())
        assert (stated is None) == (file.parent.name == 'otf_core'), file
        assert stated is None or stated[1] == version, file
    assert run('--version') == 0
    assert capsys.readouterr().out == f'otf {version}\n'


# ---------------------------------------------------------------- words and numbers beside


@pytest.mark.parametrize(
    ('value', 'text'),
    [(-0.1 + 1e-17, '-0.1'), (3 * 0.11, '0.33'), (-0.0, '0.0'), (-1e-14, '0.0'), (0.125, '0.125')],
)
def test_positions_are_written_tidy(value, text):
    assert repr(tidy(value)) == text
