# SPDX-License-Identifier: Apache-2.0
"""The shape of the package: what may import what, how long, and that all is described."""

import ast
import re
from pathlib import Path

import pytest

import otf_core

ROOT = Path(next(iter(otf_core.__path__)))
FILES = sorted(ROOT.rglob('*.py'))
NAMES = [str(f.relative_to(ROOT)) for f in FILES]
TREES = {f: ast.parse(f.read_text()) for f in FILES}
every_file = pytest.mark.parametrize('file', FILES, ids=NAMES)
ROS = {'rclpy', 'ament_index_python', 'tf2_ros', 'launch', 'launch_ros'}


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
    assert {'cli/__init__.py', 'model/kinematics.py', 'sim/cell.py', 'bags/bag.py'} <= set(NAMES)


@every_file
def test_no_ros_is_imported(file):
    roots = {name.split('.')[0] for name in imports(TREES[file])}
    assert not roots & ROS
    assert not {r for r in roots if r.startswith('otf_') and r != 'otf_core'}
    assert not {r for r in roots if re.fullmatch(r'\w+_(msgs|interfaces)', r)}


SIMULATING = (
    'sim',
    'blind',
    'validation',
    'loop',
)  # trials, validations, the machine on a control
COMMAND_LINE = 'cli'
PUBLIC = 'api'  # hands the twin to the diagnosis, as the command line does


@every_file
def test_what_calibrates_and_diagnoses_knows_nothing_of_simulations(file):
    if not {file.parent.name, file.stem.split('_')[0]} & {*SIMULATING, COMMAND_LINE, PUBLIC}:
        packages = {name.split('.')[1] for name in imports(TREES[file]) if name.count('.') > 1}
        assert not packages & set(SIMULATING)


@every_file
def test_axes_are_asked_of_the_machine_above_the_room_that_describes_it(file):
    if file.parent.name != 'model':
        assert 'otf_core.model.machine.AXES' not in set(imports(TREES[file]))


@every_file
def test_random_numbers_are_drawn_in_simulations_only(file):
    if file.parent.name not in SIMULATING:
        names = {n.attr for n in ast.walk(TREES[file]) if isinstance(n, ast.Attribute)}
        assert not names & {'default_rng', 'random'}


@every_file
def test_printing_and_leaving_is_for_the_command_line(file):
    if file.parent.name == COMMAND_LINE:
        return
    called = {n.func for n in ast.walk(TREES[file]) if isinstance(n, ast.Call)}
    assert 'print' not in {f.id for f in called if isinstance(f, ast.Name)}
    assert 'exit' not in {f.attr for f in called if isinstance(f, ast.Attribute)}


@every_file
def test_all_that_is_public_is_described(file):
    tree = TREES[file]
    assert ast.get_docstring(tree), 'module'
    for node in definitions(tree):
        if not node.name.startswith('_') and not inside_private(tree, node):
            assert ast.get_docstring(node), f'{node.name}, line {node.lineno}'


def inside_private(tree, node):
    """Tell whether a definition lies in a function or in a private class."""
    return any(
        node in ast.walk(other) and other is not node
        for other in definitions(tree)
        if not isinstance(other, ast.ClassDef) or other.name.startswith('_')
    )


@every_file
def test_no_module_is_longer_than_400_lines(file):
    assert len(file.read_text().splitlines()) <= 400


def test_tests_are_no_longer_than_that_either_and_bear_names_of_their_own():
    here = Path(__file__).parent
    files = [f for folder in (here, here.parents[2] / 'tests') for f in folder.rglob('*.py')]
    assert not [f.name for f in files if len(f.read_text().splitlines()) > 400]
    names = [f.name for f in files if f.name.startswith('test_')]
    assert len(names) == len(set(names)) > 100, 'one call of pytest collects them all'


@every_file
def test_no_function_is_longer_than_60_lines_without_its_docstring(file):
    for node in definitions(TREES[file]):
        if isinstance(node, ast.ClassDef):
            continue
        body = node.body[1:] if ast.get_docstring(node) else node.body
        if body:
            length = body[-1].end_lineno - body[0].lineno + 1
            assert length <= 60, f'{node.name}: {length} lines'


@every_file
def test_no_error_is_swallowed(file):
    for node in ast.walk(TREES[file]):
        if isinstance(node, ast.ExceptHandler):
            caught = getattr(node.type, 'id', None)
            assert node.type is not None, f'bare except, line {node.lineno}'
            broad = caught in ('Exception', 'BaseException')
            raises = any(isinstance(n, ast.Raise) for n in ast.walk(node))
            assert not broad or raises or file.parent.name == COMMAND_LINE, f'line {node.lineno}'


@every_file
def test_file_names_its_licence_in_the_first_line(file):
    assert file.read_text().startswith('# SPDX-License-Identifier: Apache-2.0\n')
