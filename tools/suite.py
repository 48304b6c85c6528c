# SPDX-License-Identifier: Apache-2.0
"""./otf test: lint, types, the core suites without ROS, the workspace suite with it.

The contract, commands and files without ROS and then the live graph, knows nothing of modules. The
core suite proper is quick; whole simulated cells through whole pipelines are a suite of their own.
So are devices and their protocols: they wait more than they compute, and run side by side, the
check of types beside them.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import layout
import ros
import workspace

ROOT = Path(layout.ROOT)
CORE_SUITE = 'src/otf_core/test'
WHOLE_CELLS = f'{CORE_SUITE}/whole'
DEVICES = 'tests/devices'
CONTRACT = 'tests/contract'
LIVE_CONTRACT = f'{CONTRACT}/nodes'
PACKAGES = 'tests of the packages'
"""Short ones of every package with nodes or messages, which ``colcon test`` runs as well."""
NO_TESTS = 5  # pytest's exit code when nothing was collected

# Runs with the variables of the core suite: fails if any part of ROS can be imported there.
PROOF = """
import importlib.util, os, sys
names = 'rclpy rosidl_parser ament_index_python std_msgs geometry_msgs otf_msgs otf_ros'.split()
found = [name for name in names if importlib.util.find_spec(name)]
found += [name for name in os.environ if name.startswith(('ROS', 'RMW', 'AMENT', '_ROS'))]
sys.exit(f'not free of ROS: {found}' if found else 0)
"""


@dataclass(frozen=True)
class Check:
    """One command of the suite."""

    title: str
    command: list[str]
    env: dict[str, str]
    suite: str = ''
    targets: tuple[str, ...] = ()
    meanwhile: Check | None = None
    """One that computes while this one waits."""

    @property
    def whole(self) -> list[str]:
        """The command with all that it is for."""
        return [*self.command, *self.targets]


def core_environment() -> dict[str, str]:
    hidden = ('ROS', 'RMW', 'AMENT', 'COLCON', 'CMAKE_PREFIX', 'FASTRTPS', 'FASTDDS', 'LD_LIBRARY')
    env = {k: v for k, v in ros.clean(os.environ).items() if not k.startswith(hidden)}
    return {**env, 'PYTHONPATH': str(ROOT / 'src/otf_core')}


def shared_out(
    python: str,
    workers: int,
    env: dict[str, str],
    suite: str,
    targets: Sequence[str] = (),
    *words: str,
) -> Check:
    """Tests in so many processes, each taking more when it has none left."""
    command = [python, '-m', 'pytest', '-n', str(workers), '--dist', 'worksteal', *words]
    return Check(f'pytest {suite}', command, env, suite, tuple(targets) or (suite,))


def package_tests() -> list[str]:
    """Folders of the tests that need ROS and lie in their packages."""
    found = sorted(p for p in ROOT.glob('src/*/test') if p != ROOT / CORE_SUITE)
    return [str(p.relative_to(ROOT)) for p in found]


def all_checks(workspace_env: dict[str, str]) -> list[Check]:
    core, python = core_environment(), layout.PYTHON
    node_python = shutil.which('python', path=workspace_env['PATH'])
    return [
        Check('ruff check', [python, '-m', 'ruff', 'check'], core),
        Check('ruff format --check', [python, '-m', 'ruff', 'format', '--check'], core),
        Check('no ROS for the core suite', [python, '-c', PROOF], core),
        shared_out(python, 2, core, CONTRACT, (), f'--ignore={LIVE_CONTRACT}'),
        shared_out(node_python, 2, workspace_env, LIVE_CONTRACT),
        shared_out(python, 2, core, CORE_SUITE, (), f'--ignore={WHOLE_CELLS}'),
        shared_out(python, 2, core, WHOLE_CELLS),
        replace(
            shared_out(node_python, 4, workspace_env, DEVICES),
            meanwhile=Check('mypy', [python, '-m', 'mypy'], core),
        ),
        shared_out(node_python, 2, workspace_env, PACKAGES, package_tests()),
        shared_out(
            node_python,
            3,
            workspace_env,
            'tests',
            (),
            f'--ignore={DEVICES}',
            f'--ignore={CONTRACT}',
        ),
    ]


def chosen_checks(workspace_env: dict[str, str], arguments: list[str]) -> list[Check]:
    """Pytest only; a test file or folder among the arguments chooses the suite it belongs to."""
    paths = [word for word in arguments if Path(word.partition('::')[0]).exists()]
    other = [word for word in arguments if word not in paths]
    checks = []
    for check in (check for check in all_checks(workspace_env) if check.suite):
        mine = [absolute(word) for word in paths if suite_of(word) == check.suite]
        if mine or not paths:
            targets = tuple(mine) or check.targets
            command = [*check.command, *other]
            checks.append(replace(check, command=command, targets=targets, meanwhile=None))
    return checks


def suite_of(word: str) -> str:
    """Suite that a test file or folder belongs to; the whole of core is the core suite."""
    place = Path(absolute(word).partition('::')[0])
    for suite in (WHOLE_CELLS, 'src/otf_core', DEVICES, LIVE_CONTRACT, CONTRACT):
        if ROOT / suite == place or ROOT / suite in place.parents:
            return CORE_SUITE if suite == 'src/otf_core' else suite
    return PACKAGES if ROOT / 'src' in place.parents else 'tests'


def absolute(word: str) -> str:
    path, mark, rest = word.partition('::')
    return os.path.realpath(path) + mark + rest


def run(arguments: list[str]) -> int:
    env = workspace.set_up_workspace(dev=True)
    env.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    env.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(ROOT / 'tests/fastdds.xml'))
    checks = chosen_checks(env, arguments) if arguments else all_checks(env)
    results = []
    for check in checks:
        print(f'\n=== {check.title} ===', flush=True)
        start, other = time.monotonic(), check.meanwhile
        with tempfile.TemporaryFile('w+') as said:
            beside = other and subprocess.Popen(
                other.whole, env=other.env, cwd=ROOT, stdout=said, stderr=subprocess.STDOUT
            )
            code = subprocess.call(check.whole, env=check.env, cwd=ROOT)
            results.append((check.title, code, time.monotonic() - start))
            if other and beside:
                code = beside.wait()
                said.seek(0)
                print(f'\n=== {other.title} ===\n{said.read()}', end='', flush=True)
                results.append((other.title, code, time.monotonic() - start))
    print('\n=== summary ===')
    for title, code, seconds in results:
        print(f'{describe(code, bool(arguments)):8} {seconds:6.1f} s  {title}')
    failed = [code for _, code, _ in results if code and not (arguments and code == NO_TESTS)]
    nothing_ran = all(code == NO_TESTS for _, code, _ in results)
    sys.stdout.flush()
    return 1 if failed or nothing_ran else 0


def describe(code: int, selected: bool) -> str:
    if code == NO_TESTS and selected:
        return 'no tests'
    return 'FAILED' if code else 'ok'
