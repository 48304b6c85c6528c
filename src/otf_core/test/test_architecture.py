# SPDX-License-Identifier: Apache-2.0
"""The shape of the package: what may import what, how long, and that all is described."""

import ast
import re
import subprocess
from pathlib import Path

import pytest
from source_trees import ROOT, package

ROS = {'rclpy', 'ament_index_python', 'tf2_ros', 'launch', 'launch_ros'}
SIMULATING = ('sim',)
"""The simulated cell."""
COMMAND_LINE = 'cli'
PUBLIC = 'api'
"""Hands the twin to the diagnosis, as the command line does."""


EXPECTED_IN_ROOT = {
    '.ci', '.github', '.gitignore', 'CHANGELOG.md', 'CITATION.cff', 'CONTRIBUTING.md', 'LICENSE',
    'README.md', 'bags', 'bench', 'docs', 'examples', 'mkdocs.yml', 'otf', 'pyproject.toml',
    'requirements', 'src', 'tests', 'tools',
}  # fmt: skip


def offenders(wrong):
    """What is wrong, by the names of the files: ``wrong`` says it of a file and its tree."""
    found = {str(f.relative_to(ROOT)): wrong(f, tree) for f, tree in package().items()}
    return {name: what for name, what in found.items() if what}


def imports(tree):
    """All names of imported modules, those inside functions included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, 'relative import'
            yield node.module
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


def definitions(tree):
    return [
        n for n in ast.walk(tree)
        if isinstance(n, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))
    ]  # fmt: skip


def test_the_package_was_found():
    some = {'cli/__init__.py', 'model/chain.py', 'sim/cell.py', 'bags/bag.py'}
    assert some <= {str(f.relative_to(ROOT)) for f in package()}


def test_no_ros_is_imported():
    def foreign(_, tree):
        roots = {name.split('.')[0] for name in imports(tree)}
        ours = {r for r in roots if r.startswith('otf_') and r != 'otf_core'}
        return roots & ROS | ours | {r for r in roots if re.fullmatch(r'\w+_(msgs|interfaces)', r)}

    assert not offenders(foreign)


def test_what_calibrates_and_diagnoses_knows_nothing_of_simulations():
    def known(file, tree):
        if {file.parent.name, file.stem.split('_')[0]} & {*SIMULATING, COMMAND_LINE, PUBLIC}:
            return None
        packages = {name.split('.')[1] for name in imports(tree) if name.count('.') > 1}
        return packages & set(SIMULATING)

    assert not offenders(known)


def test_axes_are_asked_of_the_machine_above_the_package_that_describes_it():
    assert not offenders(
        lambda file, tree: (
            file.parent.name != 'model' and 'otf_core.model.machine.AXES' in set(imports(tree))
        )
    )


def test_random_numbers_are_drawn_in_simulations_only():
    def drawn(file, tree):
        names = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
        return file.parent.name not in SIMULATING and names & {'default_rng', 'random'}

    assert not offenders(drawn)


def test_printing_and_leaving_is_for_the_command_line():
    def left(file, tree):
        if file.parent.name == COMMAND_LINE:
            return None
        called = {n.func for n in ast.walk(tree) if isinstance(n, ast.Call)}
        printing = {f.id for f in called if isinstance(f, ast.Name)} & {'print'}
        return printing | {f.attr for f in called if isinstance(f, ast.Attribute)} & {'exit'}

    assert not offenders(left)


def public(tree):
    """Definitions that others see: in no function and in no private class, themselves included."""
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            if not node.name.startswith('_'):
                yield node
                yield from public(node) if isinstance(node, ast.ClassDef) else ()
        elif isinstance(node, (ast.If, ast.Try, ast.With)):
            yield from public(node)


def test_all_that_is_public_is_described():
    assert not offenders(lambda _, tree: [] if ast.get_docstring(tree) else ['module'])
    assert not offenders(
        lambda _, tree: [f'{n.name}, line {n.lineno}' for n in public(tree)
                         if not ast.get_docstring(n)]
    )  # fmt: skip


def test_no_module_is_longer_than_800_lines():
    assert not offenders(lambda file, _: len(file.read_text().splitlines()) > 800)


def test_tests_are_no_longer_than_that_either_and_bear_names_of_their_own():
    here = Path(__file__).parent
    files = [f for folder in (here, here.parents[2] / 'tests') for f in folder.rglob('*.py')]
    assert not [f.name for f in files if len(f.read_text().splitlines()) > 800]
    names = [f.name for f in files if f.name.startswith('test_')]
    assert len(names) == len(set(names)) > 100, 'one call of pytest collects them all'


def test_no_function_is_longer_than_60_lines_without_its_docstring():
    def length(node):
        body = node.body[1:] if ast.get_docstring(node) else node.body
        return body[-1].end_lineno - body[0].lineno + 1 if body else 0

    assert not offenders(
        lambda _, tree: [f'{n.name}: {length(n)} lines' for n in definitions(tree)
                         if not isinstance(n, ast.ClassDef) and length(n) > 60]
    )  # fmt: skip


def test_the_root_of_the_repository_holds_what_is_expected_there():
    root = Path(__file__).parents[3]
    if not (root / '.git').exists():
        pytest.skip('no clone: what git tracks cannot be listed')
    listed = subprocess.run(['git', 'ls-files', '-z'], cwd=root, capture_output=True, check=True)
    names = {name.partition('/')[0] for name in listed.stdout.decode().split('\0') if name}
    assert names <= EXPECTED_IN_ROOT, f'not expected in the root: {names - EXPECTED_IN_ROOT}'


def test_no_error_is_swallowed():
    def swallowed(file, tree):
        for node in (n for n in ast.walk(tree) if isinstance(n, ast.ExceptHandler)):
            if node.type is None:
                yield f'bare except, line {node.lineno}'
            broad = getattr(node.type, 'id', None) in ('Exception', 'BaseException')
            raises = any(isinstance(n, ast.Raise) for n in ast.walk(node))
            if broad and not raises and file.parent.name != COMMAND_LINE:
                yield f'line {node.lineno}'

    assert not offenders(lambda file, tree: list(swallowed(file, tree)))


def test_file_names_its_licence_in_the_first_line():
    first = '# SPDX-License-Identifier: Apache-2.0\n'
    assert not offenders(lambda file, _: not file.read_text().startswith(first))
