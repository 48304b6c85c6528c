# SPDX-License-Identifier: Apache-2.0
"""Files of the commands: what is refused, replaced, written beside; bags that are not meant."""

import hashlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from cli_cells import message, run, words_of
from core_cells import some_machine

import otf_core
from otf_core.bags.bag import read_bag
from otf_core.effects.effects_yaml import effects_from_data
from otf_core.model.chain import exact_position
from otf_core.prediction.calibration_document import load_tables

QUICK = ({'levels': 2, 'passes': 1, 'rate': 50, 'corner_dwell': 0.1, 'end_dwell': 1},)


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


# ---------------------------------------------------------------- --out before any work


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


FINALIZER = """
class Deaf:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
        time.sleep(0.01)

Deaf()
"""
CLEARED = """
try:
    os.kill(os.getpid(), signal.{name})
    time.sleep(0.01)
except BaseException:
    pass
"""
DEAF = """
import os, signal, time
from otf_core import cli
from otf_core.cli import __main__ as command

def main():
    exec({signalled!r})
    time.sleep(20)
    return 0

cli.main = main
command.run()
"""
"""A command that is ended by a signal while Python passes exceptions over."""


@pytest.mark.parametrize(
    ('name', 'signalled', 'code'),
    [
        ('SIGTERM', FINALIZER, -signal.SIGTERM),
        ('SIGTERM', CLEARED, -signal.SIGTERM),
        ('SIGINT', FINALIZER, 130),
    ],
)
def test_signal_that_is_passed_over_ends_a_command_too(name, signalled, code):
    source = Path(next(iter(otf_core.__path__))).parent
    ended = subprocess.run(
        [sys.executable, '-c', DEAF.format(signalled=signalled.format(name=name))],
        env={**os.environ, 'PYTHONPATH': str(source)}, capture_output=True, timeout=15,
    )  # fmt: skip
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, b'', b'')


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
    files = data['provenance']['files']
    digest = hashlib.sha256((bags.folder / 'effects.yaml').read_bytes()).hexdigest()
    assert files['effects']['sha256'] == digest


@pytest.mark.parametrize('name', ['run/truth_tables.json', 'run.truth_tables.json'])
def test_truth_explains_the_samples_to_within_effect_and_noise(bags, name):
    file = load_tables(bags.folder / name)
    content = read_bag(bags.folder / 'run')
    rotation, place = file.alignment.rotation, file.alignment.translation
    ends = content.path.points[[0, -1]]
    true = exact_position(file.tables, ends)
    for samples, point in zip((slice(20), slice(-20, None)), true, strict=True):
        seen = content.samples.xyz[samples] @ rotation.T + place
        assert np.linalg.norm(seen.mean(axis=0) - point) < 4e-6  # backlash of 2 um, noise
    assert np.linalg.norm(true - ends, axis=1).max() > 8e-6


# ---------------------------------------------------------------- mistakes


def test_full_output_is_said_and_the_results_are_there(place):
    source = Path(next(iter(otf_core.__path__))).parent
    with open('/dev/full', 'w') as full:
        done = subprocess.run(
            [sys.executable, '-m', 'otf_core.cli', 'simulate', '--machine', 'machine.yaml',
             '--out', 'out', *words_of(*QUICK)],
            env={**os.environ, 'PYTHONPATH': str(source)},
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1
    assert 'standard output cannot be written' in done.stderr
    assert Path('out', 'metadata.yaml').exists()
