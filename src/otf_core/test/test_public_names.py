# SPDX-License-Identifier: Apache-2.0
"""The front door: names, where they come from, what they say of themselves, how fast it opens."""

import ast
import inspect
import json
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from source_trees import package

import otf_core

SOURCE = Path(otf_core.__file__).read_text()
FIXED = {'read_bag', 'load_machine', 'calibrate', 'diagnose', 'predict', 'plan', 'simulate'}
every_name = pytest.mark.parametrize('name', otf_core.__all__)


def test_the_names_of_the_contract_are_there():
    assert set(otf_core.__all__) >= FIXED
    assert all(callable(getattr(otf_core, name)) for name in FIXED)


def test_names_stand_once_and_alike_in_the_three_places():
    tree = ast.parse(SOURCE)
    guarded = next(node for node in tree.body if isinstance(node, ast.If))
    typed = {
        (node.module.removeprefix('otf_core.'), alias.name)
        for node in guarded.body
        for alias in node.names
    }
    lazy = [(module, name) for module, names in otf_core._HOMES.items() for name in names]
    assert typed == set(lazy)
    assert sorted(name for _, name in lazy) == sorted(otf_core.__all__)


@every_name
def test_name_exists_is_listed_and_says_what_it_is(name):
    thing = getattr(otf_core, name)
    assert name in dir(otf_core)
    assert len(inspect.getdoc(thing).splitlines()[0]) > 10
    assert thing.__module__.startswith('otf_core.')


@every_name
def test_no_name_hides_a_package(name):
    assert not (Path(otf_core.__file__).parent / name).exists()


def test_a_name_that_is_none_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'otf_core' has no attribute 'calibrat'"):
        _ = otf_core.calibrat


def loaded_by(code):
    """Modules that a fresh interpreter has loaded after a line of code."""
    script = f'{code}\nimport sys; print(*sorted(sys.modules))'
    done = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_the_door_opens_without_numpy_and_a_name_brings_what_it_needs_only():
    names = loaded_by('import otf_core')
    assert not names & {'numpy', 'scipy', 'otf_core.api', 'otf_core.errors'}
    names = loaded_by('from otf_core import load_machine')
    assert 'otf_core.model.machine' in names
    assert not {n for n in names if n.startswith(('scipy', 'otf_core.sim', 'otf_core.planning'))}


def test_all_names_come_with_a_star():
    space = {}
    exec('from otf_core import *', space)
    assert set(otf_core.__all__) <= set(space)


def test_no_package_uses_the_public_names():
    for file, tree in package().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module == 'otf_core':
                assert {alias.name for alias in node.names} == {'__version__'}, file


def test_parameters_are_described_where_help_looks():
    for name in ('CalibrationConfig', 'PlannerConfig', 'ForecastConfig', 'SimulationConfig'):
        config = getattr(otf_core, name)
        text = inspect.getdoc(config)
        assert all(f'{info.name} : ' in text for info in config.infos())
        assert all(info.meaning in text for info in config.infos())
        assert text.index('Attributes\n-----') < text.index('Examples\n-----')


def test_wrong_arguments_are_errors_of_the_package():
    machine = otf_core.load_machine(ROOT / 'bags/y-carries-the-table/machine.yaml')
    truth = ROOT / 'bags/y-carries-the-table/truth.json'
    wrong = [
        (lambda: otf_core.calibrate([]), 'none given'),
        (lambda: otf_core.calibrate([machine]), 'expected Recording, got Machine'),
        (lambda: otf_core.diagnose(None), 'expected Recording, got NoneType'),
        (lambda: otf_core.read_bag(ROOT / 'README.md', machine), 'README.md'),
        (lambda: otf_core.read_bag(truth.parent / 'bag', truth), 'truth.json'),
        (lambda: otf_core.predict(truth, [0.1, 0.2, 0.1]), r'shape \(n, 3\), got \(3,\)'),
        (lambda: otf_core.predict(truth, [[0.1, np.nan, 0.1]]), 'point 1 is not finite'),
        (lambda: otf_core.predict(truth, [[100.0, 200.0, 100.0]]), 'divide them by 1000'),
        (lambda: otf_core.plan(machine, tracker_place=[1.0, 2.0]), 'tracker_place: expected'),
        (lambda: otf_core.plan(machine, [[0, 0, 0], [9, 0, 0]]), 'leaves the range of axis X'),
        (lambda: otf_core.plan(machine, time_budget=-1.0), 'time_budget: -1 is not above 0'),
        (lambda: otf_core.simulate(machine, effects={'rust': {}}), "'rust' is unknown"),
        (lambda: otf_core.simulate(machine, effects={'backlash': {'B_Q': 1}}), 'B_Q'),
        (lambda: otf_core.simulate(machine, seed=-1), 'seed: -1 is out of range'),
        (lambda: otf_core.summary(machine), 'got Machine'),
    ]
    for call, words in wrong:
        with pytest.raises(otf_core.OtfError, match=words):
            call()


ROOT = Path(__file__).resolve().parents[3]


def test_results_travel_between_processes():
    machine = otf_core.load_machine(ROOT / 'bags/y-carries-the-table/machine.yaml')
    plan = otf_core.Plan.along([[0, 0, 0], [0.1, 0, 0]], [0.1], [1.0, 1.0])
    run = otf_core.simulate(machine, plan, seed=2)
    again = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(again.recording.samples.xyz, run.recording.samples.xyz)
    assert again.recording.machine.name == machine.name


def test_notebook_is_stored_with_its_pictures_and_uses_public_names_only():
    (notebook,) = (ROOT / 'examples').glob('*.ipynb')
    data = json.loads(notebook.read_text(encoding='utf-8'))
    code = [''.join(c['source']) for c in data['cells'] if c['cell_type'] == 'code']
    outputs = [o for c in data['cells'] for o in c.get('outputs', ())]
    assert not any(o['output_type'] == 'error' or o.get('name') == 'stderr' for o in outputs)
    assert sum('image/png' in o.get('data', ()) for o in outputs) == 2
    assert all(c['execution_count'] and c['outputs'] for c in data['cells']
               if c['cell_type'] == 'code')  # fmt: skip
    whole = notebook.read_text(encoding='utf-8')
    assert len(whole) < 250_000 and not re.search(r'(?<![\w:])/(work|tmp|root|home)/', whole)
    used = {
        node.attr
        for text in code
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute) and getattr(node.value, 'id', '') == 'otf_core'
    }
    assert {'read_bag', 'calibrate', 'diagnose'} <= used <= set(otf_core.__all__)
