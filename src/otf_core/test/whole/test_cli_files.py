# SPDX-License-Identifier: Apache-2.0
"""Files of the commands: what is refused, replaced, written beside; mistakes in input files."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from core_cells import some_machine

import otf_core
from otf_core import cli
from otf_core.bags.bag import read_bag
from otf_core.effects.effects_yaml import effects_from_data
from otf_core.files.strict_yaml import shown
from otf_core.model.kinematics import exact_position
from otf_core.model.tables import load_tables

QUICK = ('--levels', '2', '--passes', '1', '--rate', '50', '--corner-dwell', '0.1',
         '--end-dwell', '1')  # fmt: skip


def run(*arguments):
    """Exit code of one command, in this process."""
    try:
        return cli.main([str(a) for a in arguments])
    except SystemExit as leaving:
        return leaving.code


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty working folder with a machine.yaml."""
    monkeypatch.chdir(tmp_path)
    Path('machine.yaml').write_text(yaml.safe_dump(some_machine(pitch=0.1).to_dict()))
    return tmp_path


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """A simulated bag as folder and as file."""
    folder = tmp_path_factory.mktemp('bags')
    machine = folder / 'machine.yaml'
    machine.write_text(yaml.safe_dump(some_machine(pitch=0.1).to_dict()))
    effects = folder / 'effects.yaml'
    effects.write_text('- effect: backlash\n  parameters: {B_X: 2.0e-06}\n')
    for name in ('run', 'run.mcap'):
        assert run('simulate', '--machine', machine, '--out', folder / name, '--seed', '4',
                   '--effects', effects, *QUICK) == 0  # fmt: skip
    return SimpleNamespace(folder=folder, machine=machine)


def message(capsys):
    """The only line of a command that failed."""
    shown = capsys.readouterr()
    assert shown.out == ''
    assert shown.err.count('\n') == 1
    return shown.err.strip()


# ---------------------------------------------------------------- --out before any work

VERBS = {
    'calibrate': ('calibrate', 'no-bag', '--machine', 'no.yaml'),
    'diagnose': ('diagnose', 'no-bag', '--machine', 'no.yaml'),
    'noise': ('noise', 'no-bag'),
    'compare': ('compare', 'no.json', 'no.json'),
    'validate': ('validate', '--quick'),
    'blind': ('blind', '--trials', '1', '--seed', '1'),
    'plan': ('plan', '--machine', 'no.yaml'),
    'simulate': ('simulate', '--machine', 'no.yaml'),
}


@pytest.mark.parametrize('verb', VERBS)
def test_every_verb_looks_at_its_folder_first(place, capsys, verb):
    Path('file').write_text('')
    Path('folder').mkdir()
    Path('folder', 'mine.txt').write_text('mine')
    for out, words in (
        ('file', 'file: is a file'),
        ('file/below', 'is a file'),
        ('folder', 'mine.txt'),
    ):
        for extra in ((), ('--overwrite',)):
            assert run(*VERBS[verb], '--out', out, *extra) == 2
            assert words in message(capsys)
    assert sorted(os.listdir()) == ['file', 'folder', 'machine.yaml']
    assert os.listdir('folder') == ['mine.txt']


def test_prediction_looks_at_its_file_first(place, capsys):
    arguments = ('predict', '--tables', 'no.json', '--points', 'no.csv', '--out')
    Path('mine.csv').write_text('x,y,z\n1,2,3\n')
    for out, extra, words in (
        ('.', (), 'is a folder'),
        ('mine.csv', (), 'exists already'),
        ('mine.csv', ('--overwrite',), 'no result of this command'),
        ('machine.yaml/e.csv', (), 'is a file'),
    ):
        assert run(*arguments, out, *extra) == 2
        assert words in message(capsys)
    assert Path('mine.csv').read_text() == 'x,y,z\n1,2,3\n'


def test_results_are_refused_then_replaced(bags, place, capsys):
    arguments = ('calibrate', bags.folder / 'run', '--machine', 'machine.yaml', '--out', 'out')
    assert run(*arguments) in (0, 4)
    names = sorted(os.listdir('out'))
    assert {'error_tables.json', 'manifest.json'} < set(names)
    capsys.readouterr()
    assert run(*arguments) == 2
    assert 'out: holds files already' in message(capsys)
    Path('out', 'summary.txt').touch()  # another date, the same content
    assert run(*arguments, '--overwrite') in (0, 4)
    assert sorted(os.listdir('out')) == names


def test_a_bag_is_not_replaced_by_its_own_results(bags, place, capsys):
    bag = bags.folder / 'run'
    arguments = ('--machine', bags.machine, '--out', bag, '--overwrite')
    assert run('calibrate', bag, *arguments) == 2
    assert f'holds the input {bag}' in message(capsys)
    assert (bag / 'bag_0.mcap').exists()


def test_recorded_bag_is_never_replaced_by_a_simulated_one(bags, place, capsys):
    for name in ('bag_0.mcap', 'metadata.yaml'):  # as ros2 bag record leaves them
        target = Path('recorded', name)
        target.parent.mkdir(exist_ok=True)
        target.write_bytes((bags.folder / 'run' / name).read_bytes())
    Path('recorded.mcap').write_bytes((bags.folder / 'run.mcap').read_bytes())
    for out in ('recorded', 'recorded.mcap'):
        arguments = ('simulate', '--machine', 'machine.yaml', '--out', out, '--overwrite')
        assert run(*arguments, *QUICK) == 2
        assert 'never' in message(capsys)
    assert sorted(os.listdir('recorded')) == ['bag_0.mcap', 'metadata.yaml']


def test_simulated_bags_are_replaced_if_asked(bags, place):
    for out in ('run', 'run.mcap'):
        arguments = ('simulate', '--machine', 'machine.yaml', '--out', out, *QUICK)
        assert run(*arguments, '--seed', '1') == 0
        before = sorted(p.name for p in Path().rglob('*'))
        assert run(*arguments, '--seed', '2') == 2
        assert run(*arguments, '--seed', '2', '--overwrite') == 0
        assert sorted(p.name for p in Path().rglob('*')) == before
    seeds = [json.loads(Path(name).read_text())['seed'] for name in TRUTH]
    assert seeds == [2, 2]


def test_blind_trial_goes_on_in_its_folder_and_is_replaced_only_if_asked(
    place, capsys, monkeypatch
):
    from otf_core.blind import trial

    def once(trials, seed, folder, jobs, progress):
        Path(folder, 'cells', '000').mkdir(parents=True, exist_ok=True)
        Path(folder, 'cells', '000', 'machine.yaml').write_text(str(seed))
        for name in ('key.json', 'key.sha256', 'score.txt'):
            Path(folder, name).write_text(str(seed))
        return 'done'

    monkeypatch.setattr(trial, 'run_trial', once)
    assert run('blind', '--trials', '1', '--seed', '1', '--out', 'blind') == 0
    Path('blind', 'answers').mkdir()
    Path('blind', 'answers', 'seconds.txt').write_text('1.0')
    assert run('blind', '--trials', '1', '--seed', '1', '--out', 'blind') == 0
    assert run('blind', '--trials', '1', '--seed', '2', '--out', 'blind', '--overwrite') == 0
    assert not Path('blind', 'answers').exists()
    assert Path('blind', 'key.json').read_text() == '2'
    Path('blind', 'notes.txt').write_text('mine')
    capsys.readouterr()
    assert run('blind', '--trials', '1', '--seed', '3', '--out', 'blind', '--overwrite') == 2
    assert 'notes.txt' in message(capsys)


def test_command_ended_by_a_signal_leaves_nothing(bags, place):
    source = Path(next(iter(otf_core.__path__))).parent
    words = ['plan', '--machine', 'machine.yaml', '--out', 'out', '--time-budget', '300']
    child = subprocess.Popen(
        [sys.executable, '-m', 'otf_core.cli', *words],
        env={**os.environ, 'PYTHONPATH': str(source)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    with child:
        time.sleep(1.0)
        child.send_signal(signal.SIGTERM)
        said = child.communicate(timeout=30)
    assert (child.returncode, said) == (-signal.SIGTERM, (b'', b''))
    assert os.listdir() == ['machine.yaml']


# ---------------------------------------------------------------- the truth beside a bag

TRUTH = ('run/simulation.json', 'run.simulation.json')


def test_bag_with_its_truth_is_read_by_us_and_by_rosbags(bags):
    from rosbags.rosbag2 import Reader

    content = read_bag(bags.folder / 'run')
    alone = read_bag(bags.folder / 'run.mcap')
    np.testing.assert_array_equal(content.samples.xyz, alone.samples.xyz)
    with Reader(bags.folder / 'run') as reader:
        assert reader.message_count == len(content.samples) + 1
    assert sorted(p.name for p in (bags.folder / 'run').iterdir()) == [
        'bag_0.mcap', 'manifest.json', 'metadata.yaml', 'simulation.json', 'truth_tables.json',
    ]  # fmt: skip


@pytest.mark.parametrize('name', TRUTH)
def test_truth_says_all_that_was_simulated(bags, name):
    data = json.loads((bags.folder / name).read_text())
    machine = some_machine(pitch=0.1)
    assert (data['schema'], data['seed']) == ('otf-simulation/1', 4)
    (effect,) = effects_from_data(data['effects'], name, machine)
    assert (effect.effect.name, effect.parameters) == ('backlash', {'B_X': 2e-6})
    assert data['noise']['u_angle'] == machine.tracker.u_angle
    assert data['noise']['correlation_time'] == 0.3
    files = data['provenance']['files']
    digest = hashlib.sha256((bags.folder / 'effects.yaml').read_bytes()).hexdigest()
    assert files['effects']['sha256'] == digest


@pytest.mark.parametrize('name', ['run/truth_tables.json', 'run.truth_tables.json'])
def test_truth_explains_the_samples_to_within_effect_and_noise(bags, name):
    file = load_tables(bags.folder / name)
    content = read_bag(bags.folder / 'run')
    rotation = np.array(file.extra['alignment']['rotation'])
    place = np.array(file.extra['alignment']['translation'])
    ends = content.path.points[[0, -1]]
    true = exact_position(file.tables, ends)
    for samples, point in zip((slice(20), slice(-20, None)), true, strict=True):
        seen = content.samples.xyz[samples] @ rotation.T + place
        assert np.linalg.norm(seen.mean(axis=0) - point) < 4e-6  # backlash of 2 um, noise
    assert np.linalg.norm(true - ends, axis=1).max() > 8e-6


# ---------------------------------------------------------------- mistakes


@pytest.mark.parametrize(
    ('key', 'value', 'words'),
    [
        (('axes', 'X', 'max'), 300.0, 'is it in mm? Write 0.3 m'),
        (('axes', 'X', 'table_pitch'), 50.0, 'is it in mm?'),
        (('target_offset',), [0, 0, -150.0], 'not mm'),
        (('tracker', 'u_range'), 0.5, 'is it in um? Write 5e-07 m'),
        (('tracker', 'u_angle'), 2.0, 'is it in urad? Write 2e-06 rad'),
        (('axes', 'X', 'max'), 10**400, 'the number is too large'),
        (('name',), [[[1] * 9] * 9] * 9, 'expected a text'),
        (('target_offset',), [['x' * 10**5] * 9] * 9, 'expected a list of 3 numbers'),
        (('axes', 'X', 'min'), {'a': 'x' * 10**5}, 'expected a plain number'),
    ],
)
def test_wrong_units_and_monsters_in_a_machine_description(place, capsys, key, value, words):
    data = yaml.safe_load(Path('machine.yaml').read_text())
    inner = data
    for part in key[:-1]:
        inner = inner[part]
    inner[key[-1]] = value
    Path('wrong.yaml').write_text(yaml.safe_dump(data))
    assert run('plan', '--machine', 'wrong.yaml', '--out', 'out') == 2
    said = message(capsys)
    assert words in said
    assert said.startswith(f'otf plan: wrong.yaml: {": ".join(key)}: ')
    assert len(said) < 400


def test_aliases_that_grow_without_end_are_shown_in_a_line(place, capsys):
    levels = [f'- &{b} [{", ".join([f"*{a}"] * 9)}]' for a, b in pairwise('abcdefghi')]
    bomb = '\n'.join(['- &a [1, 1, 1, 1, 1, 1, 1, 1, 1]', *levels])
    Path('bomb.yaml').write_text(bomb)
    start = time.process_time()
    value = yaml.safe_load(bomb)
    assert len(shown(value)) < 400
    text = Path('machine.yaml').read_text().replace('name: small', f'name:\n{bomb}')
    Path('wrong.yaml').write_text(text)
    assert run('plan', '--machine', 'wrong.yaml', '--out', 'out') == 2
    assert len(message(capsys)) < 400
    assert time.process_time() - start < 2.0


def test_message_of_any_length_is_cut(place, capsys):
    Path('wrong.yaml').write_text(Path('machine.yaml').read_text() + f'? {"x" * 10**5}\n: 1\n')
    assert run('plan', '--machine', 'wrong.yaml', '--out', 'out') == 2
    said = message(capsys)
    assert 'unknown key' in said
    assert len(said) < 1100


HUGE = '1' + '0' * 400
ENDLESS = '1' + '0' * 5000
EFFECT = '- effect: backlash\n  parameters: {B_X: NUMBER}\n'
PLAN = '{"schema": "otf-plan/1", "path": [[0, 0, NUMBER], [1, 1, 1]]}'


@pytest.mark.parametrize(
    ('option', 'content', 'words'),
    [
        ('--effects', EFFECT.replace('NUMBER', HUGE), 'B_X: the number is too large'),
        ('--effects', EFFECT.replace('NUMBER', ENDLESS), 'thousands of digits'),
        (
            '--effects',
            EFFECT.replace('NUMBER', '.inf'),
            'a plain number in SI units, got inf',
        ),
        ('--effects', '[' * 5000, 'nested too deeply'),
        ('--path', PLAN.replace('NUMBER', HUGE), 'path: expected n x 3 numbers'),
        ('--path', PLAN.replace('NUMBER', ENDLESS), 'thousands of digits'),
        ('--path', '{"a":' * 100_000, 'nested too deeply'),
        ('--tables', '[' * 100_000, 'nested too deeply'),
        ('--tables', '{"schema": NUMBER}'.replace('NUMBER', ENDLESS), 'thousands of digits'),
        ('--tables', '\x00\xff', 'not'),
    ],
)
def test_monsters_in_other_files(place, capsys, option, content, words):
    Path('wrong').write_text(content, encoding='latin-1')
    assert run('simulate', '--machine', 'machine.yaml', option, 'wrong', '--out', 'out') == 2
    said = message(capsys)
    assert words in said
    assert said.startswith('otf simulate: wrong: ')
    assert os.listdir() != ['out']
    assert not Path('out').exists()


@pytest.mark.parametrize('content', ['{"u_range": NUMBER}'.replace('NUMBER', HUGE), '[' * 100_000])
def test_monsters_in_a_noise_file(place, capsys, content):
    Path('noise.json').write_text(content)
    arguments = ('plan', '--machine', 'machine.yaml', '--noise', 'noise.json', '--out', 'out')
    assert run(*arguments) == 2
    assert message(capsys).startswith('otf plan: noise.json: not ')


@pytest.mark.parametrize(
    ('bag', 'machine', 'words'),
    [
        ('machine.yaml', 'run', 'it is a folder; are bag and --machine swapped?'),
        ('machine.yaml', 'run.mcap', 'it is a recording; are bag and --machine swapped?'),
        ('machine.yaml', 'machine.yaml', 'are bag and --machine swapped?'),
        ('run', 'machne.yaml', 'machine.yaml?'),
        ('run', 'nothing-like-it', 'No such file or directory)'),
    ],
)
def test_swapped_or_misspelt_inputs(bags, capsys, bag, machine, words, tmp_path):
    names = [bags.folder / name for name in (bag, machine)]
    arguments = ('calibrate', names[0], '--machine', names[1], '--out', tmp_path / 'out')
    assert run(*arguments) == 2
    assert message(capsys).endswith(words)


def test_path_in_millimetres_is_named(bags, place, capsys):
    from otf_core.bags.bag import BagContent, write_bag
    from otf_core.model.path import NominalPath

    content = read_bag(bags.folder / 'run')
    wrong = BagContent(content.samples, NominalPath(1e3 * content.path.points))
    write_bag('mm', wrong)
    arguments = ('--machine', 'machine.yaml', '--out', 'out')
    assert run('calibrate', 'mm', *arguments) == 3
    assert 'the path seems to be in mm, expected m' in message(capsys)


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (('calibrat', 'bag'), "otf: 'calibrat' is no VERB; did you mean calibrate? Possible: "),
        (('xyz',), "otf: 'xyz' is no VERB Possible: calibrate, "),
        (
            ('calibrate', 'bag', '--machine', 'm', '--out', 'o', '--piece-lenght', '1'),
            'otf calibrate: unknown option --piece-lenght; did you mean --piece-length? '
            '(see otf calibrate --help)',
        ),
        (
            ('noise', 'bag', 'more', '--out', 'o'),
            'otf noise: unknown argument more (see otf noise --help)',
        ),
        (
            ('plan', '--machine', 'm', '--out', 'o', '--feed', '0.25'),
            'otf plan: --feed: 0.25 is out of range, 6 to 300000 mm/min are possible',
        ),
    ],
)
def test_typing_mistakes_point_to_what_was_meant(capsys, arguments, words):
    assert run(*arguments) == 2
    assert message(capsys).startswith(words)


def test_help_lists_choices_and_overwriting(capsys):
    assert run('calibrate', '--help') == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert '--reversal {auto,none,constant,tables}' in said
    assert '--overwrite' in said


def test_full_output_is_said_and_the_results_are_there(place):
    source = Path(next(iter(otf_core.__path__))).parent
    with open('/dev/full', 'w') as full:
        done = subprocess.run(
            [sys.executable, '-m', 'otf_core.cli', 'simulate', '--machine', 'machine.yaml',
             '--out', 'out', *QUICK],
            env={**os.environ, 'PYTHONPATH': str(source)},
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1
    assert 'standard output cannot be written' in done.stderr
    assert Path('out', 'metadata.yaml').exists()
