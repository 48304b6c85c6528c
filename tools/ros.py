# SPDX-License-Identifier: Apache-2.0
"""ROS 2 Jazzy below the workspace: a sourced installation, or wheels that look like one."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import layout
from layout import SetupError

ROOT = Path(layout.ROOT)
BUILD_ROOT = Path(layout.build_root())
VENV = BUILD_ROOT / '.venv'
WHEELS = VENV / 'ros'
CONSTRAINTS = ROOT / 'requirements' / 'constraints.txt'

# Set by a sourced workspace or underlay. A build on wheels starts without them.
ROS_VARIABLES = (
    'AMENT_PREFIX_PATH',
    'CMAKE_PREFIX_PATH',
    'COLCON_PREFIX_PATH',
    'OTF_WHEELS',
    'PYTHONHOME',
    'PYTHONPATH',
    'RMW_IMPLEMENTATION',
    'ROS_DISTRO',
    'ROS_PYTHON_VERSION',
    'ROS_VERSION',
    '_ROS_WHEELS_BOOTSTRAP_COMPLETE',
)


@dataclass(frozen=True)
class Underlay:
    """A sourced Jazzy installation and the interpreter that its rclpy is for."""

    name: str
    python: str


def find_underlay(base_python: str) -> Underlay | None:
    """The sourced Jazzy, unless what is sourced is a workspace on wheels like this one."""
    if os.environ.get('ROS_DISTRO') != 'jazzy' or 'OTF_WHEELS' in os.environ:
        return None
    probe = 'import rclpy, sys; print(rclpy.__file__, sys.version_info[:2])'
    for python in dict.fromkeys([base_python, '/usr/bin/python3']):
        if not os.access(python, os.X_OK):
            continue
        found = subprocess.run([python, '-c', probe], capture_output=True, text=True, check=False)
        if found.returncode == 0:
            return Underlay('underlay ' + found.stdout.strip(), python)
    raise SetupError(
        f'ROS 2 Jazzy is sourced, but {base_python} cannot import its rclpy: run ./otf with the '
        'Python of that installation, or in a terminal without it to use ROS from wheels'
    )


def clean(env: Mapping[str, str]) -> dict[str, str]:
    """The variables without ROS, whatever is sourced."""
    prefixes = [
        prefix
        for name in ('AMENT_PREFIX_PATH', 'COLCON_PREFIX_PATH', 'OTF_WHEELS')
        for prefix in env.get(name, '').split(os.pathsep)
        if prefix
    ]
    result = {name: value for name, value in env.items() if name not in ROS_VARIABLES}
    for name in ('PATH', 'LD_LIBRARY_PATH'):
        parts = env.get(name, '').split(os.pathsep)
        kept = [p for p in parts if p and not any(is_below(p, prefix) for prefix in prefixes)]
        result[name] = os.pathsep.join(kept)
    if not result['LD_LIBRARY_PATH']:
        del result['LD_LIBRARY_PATH']
    return result


def is_below(path: str, prefix: str) -> bool:
    return path == prefix or path.startswith(prefix.rstrip('/') + '/')


def requirement_words(names: list[str], underlay: Underlay | None) -> list[str | Path]:
    """Arguments for pip: the files; with an underlay only what neither ROS nor the system has."""
    files = [ROOT / 'requirements' / f'{name}.txt' for name in names]
    if underlay is None:
        return [word for file in files for word in ('-r', file)] + ['-c', CONSTRAINTS]
    present = distributions(underlay.python)
    wanted, pinned = [], []
    for file in files:
        for line in file.read_text().splitlines():
            word = line.partition('#')[0].strip()
            if word and not word.startswith('ros-') and canonical(word) not in present:
                wanted.append(word)
    for line in CONSTRAINTS.read_text().splitlines():
        if '==' in line and canonical(line.partition('==')[0]) not in present:
            pinned.append(line)
    constraints = VENV / 'constraints.txt'
    constraints.write_text('\n'.join(pinned) + '\n')
    return [*(wanted or ['pip']), '-c', constraints]


def canonical(name: str) -> str:
    return re.sub(r'[-_.]+', '-', name.strip()).lower()


def distributions(python: str) -> set[str]:
    """Names of what the interpreter has without its environment variables."""
    probe = (
        'import importlib.metadata as m\n'
        'for d in m.distributions():\n'
        '    print(d.metadata["Name"])'
    )
    command = [python, '-E', '-s', '-c', probe]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    return {canonical(name) for name in found.stdout.split()}


def site_packages(home: Path) -> Path:
    return next(home.glob('lib/python3.*/site-packages'))


def add_path_of(lower: Path, upper: Path) -> None:
    """Let one environment see the packages of another below its own."""
    (site_packages(upper) / 'otf_core_environment.pth').write_text(f'{site_packages(lower)}\n')


def drop_foreign_includes(prefix: Path) -> None:
    """Drop include folders of the machine that made the wheels: CMake stops where one is missing.

    Done in the files, not by CMAKE_PROJECT_INCLUDE, so that a plain `colcon build` works as well.
    """
    pattern = re.compile(r'(INTERFACE_INCLUDE_DIRECTORIES ")([^"]*)(")')

    def existing(match: re.Match[str]) -> str:
        kept = [
            entry
            for entry in match[2].split(';')
            if not entry.startswith('/') or Path(entry).is_dir()
        ]
        return match[1] + ';'.join(kept) + match[3]

    for path in prefix.glob('share/*/cmake/export_*__rosidl_generator_pyExport.cmake'):
        text = path.read_text()
        changed = pattern.sub(existing, text)
        if changed != text:
            path.unlink()  # not in place: pip may have linked it from its cache
            path.write_text(changed)


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


def write_setup_files(prefix: Path) -> None:
    """Write local_setup.* and setup.* for sh, bash, zsh: in the prefix, and for users in .venv."""
    folders = sorted(site_packages(prefix).glob('ros_*.libs'))
    libraries = ':'.join(map(str, [prefix / 'lib', *folders]))
    text = SETUP.format(
        prefix=shlex.quote(str(prefix)),
        libraries=shlex.quote(libraries),
    )
    (prefix / 'local_setup.sh').write_text(text)
    call = f'. {shlex.quote(str(prefix / "local_setup.sh"))}\n'
    for shell in ('bash', 'zsh'):
        (prefix / f'local_setup.{shell}').write_text(call)
    for folder in (prefix, VENV):
        for shell in ('sh', 'bash', 'zsh'):
            (folder / f'setup.{shell}').write_text(call)


def sourced(script: Path, env: Mapping[str, str]) -> dict[str, str]:
    """The variables after a POSIX shell has read the script."""
    command = ['/bin/sh', '-c', '. "$0" >&2 && exec env -0', str(script)]
    found = subprocess.run(command, env=env, cwd=ROOT, stdout=subprocess.PIPE, check=False)
    if found.returncode:
        raise SetupError(f'{script} could not be sourced')
    pairs = (pair.partition('=') for pair in os.fsdecode(found.stdout).split('\0') if pair)
    return {name: value for name, _, value in pairs}


def underlay_environment(underlay: Underlay | None) -> dict[str, str]:
    """Variables to build with."""
    if underlay is None:
        return sourced(VENV / 'setup.sh', clean(os.environ))
    path = os.pathsep.join([str(VENV / 'bin'), os.environ.get('PATH', '')])
    return {**os.environ, 'PATH': path}


def workspace_environment(underlay: Underlay | None) -> dict[str, str]:
    """Variables to run with."""
    return sourced(BUILD_ROOT / 'install/setup.sh', underlay_environment(underlay))
