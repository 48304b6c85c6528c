# SPDX-License-Identifier: Apache-2.0
"""What pip installs: all that is imported, all that requirements/core.txt names, the command."""

import ast
import re
import subprocess
import sys
from configparser import ConfigParser
from pathlib import Path

import otf_core

PACKAGE = Path(otf_core.__file__).parent
ROOT = Path(__file__).resolve().parents[4]
NAMES = {'yaml': 'pyyaml'}
"""Distributions that are called otherwise than what is imported from them."""

FOLDER = ROOT / 'src/otf_core'
PROJECT = ConfigParser()
PROJECT.read(FOLDER / 'setup.cfg', encoding='utf-8')


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


def test_pages_of_the_public_names_are_made_without_a_warning(tmp_path):
    page_of_names = (ROOT / 'docs/api.md').read_text(encoding='utf-8')
    words = re.search(r'python -m (pdoc .*) -o \S+ otf_core\n', page_of_names)[1].split()
    command = [sys.executable, '-W', 'error', '-m', *words, '-o', str(tmp_path), 'otf_core']
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stderr, done.stderr
    page = (tmp_path / 'otf_core.html').read_text(encoding='utf-8')
    assert all(f'<section id="{name}">' in page for name in otf_core.__all__)
