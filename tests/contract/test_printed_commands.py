# SPDX-License-Identifier: Apache-2.0
"""The commands that README and tutorials print, in an empty folder, as printed and in order."""

import json
import re
import shlex
import subprocess
import sys

import pytest
from command import COMMAND, ROOT, made_once, otf, read, shared, with_variables

README = (ROOT / 'README.md').read_text(encoding='utf-8')
PAGES = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').rglob('*.md'))]
TUTORIALS = ('tutorial', 'tutorial-five-axes')
OF_THE_REPOSITORY = {'demo', 'test', 'env', 'blind', 'emulate-tracker'}


def blocks(text):
    """Blocks of a page that are commands."""
    return [
        block
        for block in re.findall(r'^```(?:bash|sh)?\n(.*?)^```', text, re.DOTALL | re.MULTILINE)
        if './otf ' in block or '<<' in block or 'printf' in block
    ]


def section():
    """The section of the README on offline commands."""
    return README.split('## Offline commands')[1].split('\n## ')[0]


def run_in(folder, text):
    """Run a block in a shell that ends at the first command that fails."""
    launcher = folder / 'otf'
    launcher.write_text('#!/bin/sh\nexec ' + shlex.join(COMMAND) + ' "$@"\n')
    launcher.chmod(0o755)
    done = subprocess.run(
        ['bash', '-e', '-c', text], cwd=folder, env=with_variables({}), capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f'{done.stdout[-2000:]}\n{done.stderr[-2000:]}'


@pytest.fixture(scope='session')
def readme(tmp_path_factory):
    """The folder after the first block of the README."""
    place = shared(tmp_path_factory) / 'readme'
    return made_once(place, lambda folder: run_in(folder, blocks(section())[0]))


def test_block_of_the_readme_runs_as_printed(readme):
    written = {path.name for path in readme.iterdir()}
    assert {'plan', 'run1', 'run2', 'run3', 'noise', 'results', 'both', 'errors.csv'} <= written
    gap = read(readme / 'diagnosis/gap.json')
    assert [cause['effect'] for cause in gap['causes']] == ['thermal_axis_expansion']
    left = read(readme / 'comparison/comparison.json')['volume_with_squareness']
    assert left['mae_difference'] < 0.05 * left['mae_b']
    assert len((readme / 'errors.csv').read_text().splitlines()) == 3


def test_block_of_the_library_runs_after_it(readme):
    code = re.search(r'```python\n(.*?)```', README.split('## As a library')[1], re.DOTALL)[1]
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=readme, env=with_variables({}), capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert 'is explained by backlash of X' in done.stdout
    assert (readme / 'program/plan.json').exists()


@pytest.mark.parametrize('name', TUTORIALS)
def test_tutorial_runs_as_printed(tmp_path, name):
    text = (ROOT / f'docs/{name}.md').read_text(encoding='utf-8')
    for block in blocks(text):
        run_in(tmp_path, block)
    tables = read(tmp_path / 'tables/error_tables.json')
    assert tables['verdicts']['measurement']['good']
    left = json.loads((tmp_path / 'proof/comparison.json').read_text())
    sizes = left.get('volume_with_squareness') or left['volume']
    assert sizes['mae_difference'] < 0.1 * sizes['mae_b']


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.stem)
def test_verbs_that_a_page_names_exist(page):
    known = set(re.findall(r'^ +([a-z]+)\b', otf('--help').out, re.MULTILINE))
    named = set(re.findall(r'\./otf ([a-z-]+)', page.read_text(encoding='utf-8')))
    assert named <= known | OF_THE_REPOSITORY


def test_options_that_commands_print_exist():
    """Every command of the section and of the pages on commands, by the help of its verb."""
    text = ''.join(blocks(section()))
    for name in (*TUTORIALS, 'commands'):
        text += ''.join(blocks((ROOT / f'docs/{name}.md').read_text(encoding='utf-8')))
    helps, lines = {}, re.findall(r'^\./otf (.*)$', text, re.MULTILINE)
    assert len(lines) >= 20
    for line in lines:
        verb, *words = shlex.split(line, comments=True)
        if verb in OF_THE_REPOSITORY:
            continue
        helps.setdefault(verb, otf(verb, '--help').out)
        for word in words:
            if word.startswith('--'):
                assert re.search(rf'{word.partition("=")[0]}\b', helps[verb]), line
