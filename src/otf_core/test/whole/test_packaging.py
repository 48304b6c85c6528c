# SPDX-License-Identifier: Apache-2.0
"""What pip installs: all that is imported, all that requirements/core.txt names, the command."""

import ast
import os
import re
import runpy
import subprocess
import sys
from configparser import ConfigParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import otf_core

PACKAGE = Path(otf_core.__file__).parent
ROOT = Path(__file__).resolve().parents[4]
NAMES = {'yaml': 'pyyaml'}
"""Distributions that are called otherwise than what is imported from them."""

FOLDER = ROOT / 'src/otf_core'
PROJECT = ConfigParser()
PROJECT.read(FOLDER / 'setup.cfg', encoding='utf-8')
README = FOLDER / 'README.md'


def required():
    return {
        re.match(r'[\w.-]+', line)[0].lower()
        for line in PROJECT['options']['install_requires'].split()
    }


def imported():
    for file in PACKAGE.rglob('*.py'):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                yield from (alias.name.partition('.')[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                yield node.module.partition('.')[0]


def test_all_that_is_imported_is_required_and_nothing_else():
    foreign = set(imported()) - set(sys.stdlib_module_names) - {'otf_core', '__future__'}
    optional = set(PROJECT['options.extras_require'].values())
    named = {NAMES.get(name, name) for name in foreign}
    assert named - optional == required()


def test_what_the_offline_commands_are_set_up_with_is_what_pip_brings():
    lines = (ROOT / 'requirements/core.txt').read_text().splitlines()
    listed = {line.split()[0].lower() for line in lines if not line.startswith('#')}
    assert required() - listed == {'zstandard', 'lz4'}  # come with mcap
    assert listed <= required()


def test_the_command_is_that_of_the_offline_verbs():
    script = PROJECT['options.entry_points']['console_scripts'].strip()
    name, module, function = re.fullmatch(r'(\w+) = ([\w.]+):(\w+)', script).groups()
    assert name == 'otf'
    code = (
        f'import sys; sys.argv = ["otf", "--version"]; from {module} import {function} as f; f()'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout == f'otf {otf_core.__version__}\n'


def test_every_package_is_a_package_that_is_found():
    folders = {file.parent for file in PACKAGE.rglob('*.py')}
    assert all((folder / '__init__.py').exists() for folder in folders)


def test_wheels_bring_licence_and_readme_and_nobody_has_a_false_address():
    assert (FOLDER / 'LICENSE').read_bytes() == (ROOT / 'LICENSE').read_bytes()
    known = PROJECT['metadata']
    assert known['keywords'] and known['author'] and known['license'] == 'Apache-2.0'
    described = ElementTree.parse(FOLDER / 'package.xml').getroot()
    assert described.findtext('description') == known['description']
    assert described.find('license').get('file') == 'LICENSE'
    files = [
        p for name in ('package.xml', 'setup.py', 'setup.cfg') for p in ROOT.glob(f'src/*/{name}')
    ]
    for file in files:
        addresses = re.findall(r'[\w.-]+@[\w.-]+', file.read_text(encoding='utf-8'))
        assert all(address.endswith('.invalid') for address in addresses), file


@pytest.mark.parametrize(('command', 'found'), [('bdist_wheel', False), ('install', True)])
def test_ros_finds_what_colcon_installs_and_pip_brings_nothing_of_it(command, found, monkeypatch):
    given = {}
    monkeypatch.setattr(sys, 'argv', ['setup.py', command])
    monkeypatch.setattr('setuptools.setup', lambda **arguments: given.update(arguments))
    runpy.run_path(str(FOLDER / 'setup.py'))
    assert bool(given['data_files']) == found
    assert given['long_description'] == README.read_text(encoding='utf-8')


def test_the_example_of_the_package_runs(tmp_path):
    (code,) = re.findall(r'```python\n(.*?)```', README.read_text(encoding='utf-8'), re.DOTALL)
    command = [sys.executable, '-W', 'error', '-c', code]
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, 'PYTHONPATH': str(PACKAGE.parent)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert 'EXX' in done.stdout and (tmp_path / 'results/report.html').exists()


def test_who_cites_cites_this_version_and_the_paper():
    cited = yaml.safe_load((ROOT / 'CITATION.cff').read_text(encoding='utf-8'))
    assert cited['cff-version'] == '1.2.0' and cited['version'] == otf_core.__version__
    (paper,) = cited['references']
    assert (
        paper['doi'] == '10.3390/jmmp7020060' and paper['authors'][0]['family-names'] == 'Sanders'
    )
    assert otf_core.__version__ in (ROOT / 'CHANGELOG.md').read_text(encoding='utf-8')


def test_pages_of_the_public_names_are_made_without_a_warning(tmp_path):
    page_of_names = (ROOT / 'docs/api.md').read_text(encoding='utf-8')
    words = re.search(r'python -m (pdoc .*) -o \S+ otf_core\n', page_of_names)[1].split()
    command = [sys.executable, '-W', 'error', '-m', *words, '-o', str(tmp_path), 'otf_core']
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stderr, done.stderr
    page = (tmp_path / 'otf_core.html').read_text(encoding='utf-8')
    assert all(f'<section id="{name}">' in page for name in otf_core.__all__)
