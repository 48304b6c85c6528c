# SPDX-License-Identifier: Apache-2.0
"""Checks of an installation: Python, packages, disk, locale, clock, ROS. Needs no numpy."""

from __future__ import annotations

import locale
import os
import re
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from otf_core.files.message_text import shortened
from otf_core.version import __version__

OK = 'ok'
WARNING = 'warning'
ERROR = 'error'


@dataclass(frozen=True)
class State:
    """One part of an installation.

    Attributes
    ----------
    part : str
        One word.
    severity : str
        ``OK``; ``WARNING``: some things will not work; ``ERROR``: nothing will.
    what : str
        What was found.
    do : str
        What to do; empty where all is well.
    """

    part: str
    severity: str
    what: str
    do: str = ''


LOWEST_PYTHON, HIGHEST_PYTHON = (3, 10), (3, 13)


def check_python() -> Iterator[State]:
    """Check the version of Python and the width of its addresses."""
    here, lowest, highest = (
        '.'.join(map(str, numbers))
        for numbers in (sys.version_info[:3], LOWEST_PYTHON, HIGHEST_PYTHON)
    )
    version = f'Python {here}, {sys.executable}'
    if sys.version_info[:2] < LOWEST_PYTHON:
        yield State('python', ERROR, version, f'use Python {lowest} or later')
    elif struct.calcsize('P') < 8:
        yield State('python', ERROR, f'{version}, 32 bit', 'use a 64 bit Python')
    elif sys.version_info[:2] > HIGHEST_PYTHON:
        yield State(
            'python', WARNING, version,
            f'tested up to Python {highest}; use that if something fails',
        )  # fmt: skip
    else:
        yield State('python', OK, version)


OLDEST_VERSIONS = {
    'numpy': '1.26',
    'scipy': '1.11',
    'PyYAML': '6.0',
    'mcap': '1.1.1',
    'zstandard': '0.18',
    'lz4': '4.3',
    'rosbags': '0.11',
    'threadpoolctl': '3.1',
}
"""Distributions and their oldest versions, as in setup.cfg."""
COMPILED = ('numpy', 'scipy.linalg', 'scipy.sparse', 'zstandard', 'yaml')
"""Modules whose binary parts may not fit this interpreter, or each other."""


def _version_numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r'\d+', text)[:3])


def check_packages() -> Iterator[State]:
    """Check that every package is there and new enough, and that compiled ones load."""
    versions, missing, old = [f'otf_core {__version__}'], [], []
    for name, least in OLDEST_VERSIONS.items():
        try:
            have = version(name)
        except PackageNotFoundError:
            missing.append(name)
            continue
        versions.append(f'{name} {have}')
        if _version_numbers(have) < _version_numbers(least):
            old.append(f'{name} {have} (needed {least})')
    install = "pip install 'otf_core', or ./otf VERB from a copy of the sources"
    if missing:
        yield State('packages', ERROR, f'missing: {", ".join(missing)}', install)
    if old:
        yield State('packages', WARNING, f'too old: {", ".join(old)}', 'pip install --upgrade')
    if not missing and not old:
        yield State('packages', OK, ', '.join(versions))
    broken = [] if missing else [text for name in COMPILED if (text := _load_failure(name))]
    if broken:
        yield State(
            'binaries', ERROR, '; '.join(broken),
            'use a separate environment (python -m venv), so that pip and apt do not mix',
        )  # fmt: skip


def _load_failure(module: str) -> str:
    """Why a module does not load; empty if it does."""
    try:
        import_module(module)
    except (ImportError, AttributeError, ValueError, OSError) as error:
        # ValueError and AttributeError: built for another numpy
        return f'{module}: {shortened(" ".join(str(error).split()), 200)}'
    return ''


DISK_WARNING, DISK_ERROR = 2e9, 1e8
"""Bytes: a day of bags; a single run with its results."""
MEMORY_WARNING = 2e9
"""Bytes; a diagnosis takes up to two thirds of it."""


def check_disk_and_memory() -> Iterator[State]:
    """Check the room in this folder and in that of temporary files, and the memory."""
    for name, folder in (('here', Path.cwd()), ('temporary files', Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free
        space = f'{free / 1e9:.1f} GB free for {name} ({folder})'
        if not os.access(folder, os.W_OK):
            yield State('disk', WARNING, f'{folder} cannot be written', 'give --out elsewhere')
        elif free < DISK_WARNING:
            severity = ERROR if free < DISK_ERROR else WARNING
            yield State('disk', severity, space, 'make room, or set TMPDIR to another disk')
        else:
            yield State('disk', OK, space)
    size = _memory_size()
    if size is None:
        return
    space = f'{size / 1e9:.1f} GB, {os.cpu_count()} processors'
    few = 'close other programs; a diagnosis of long runs may need more'
    yield (
        State('memory', OK, space)
        if size >= MEMORY_WARNING
        else State('memory', WARNING, space, few)
    )


def _memory_size() -> float | None:
    """Bytes of this computer; None where the system does not say."""
    try:
        return float(os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES'))
    except (AttributeError, ValueError, OSError):
        return None


VARIABLES = {
    'PYTHONHOME': 'it points Python at another library; unset it',
    'PYTHONPATH': 'packages there hide those of this environment; unset it outside ROS',
    'PYTHONOPTIMIZE': 'checks of the program are disabled; unset it',
}


def check_locale_and_variables() -> Iterator[State]:
    """Check for UTF-8, and for variables that are rarely set on purpose."""
    preferred = locale.getpreferredencoding(False)
    shown = getattr(sys.stdout, 'encoding', None) or 'none'
    encodings = f'files {preferred}, terminal {shown}'
    if 'utf' in preferred.lower() and 'utf' in shown.lower():
        yield State('locale', OK, encodings)
    else:
        yield State(
            'locale', WARNING, encodings,
            'set LANG=C.UTF-8, on Windows PYTHONUTF8=1: otherwise names with umlauts are garbled',
        )  # fmt: skip
    for name, do in VARIABLES.items():
        if os.environ.get(name) and not _is_set_by_otf_or_ros(name):
            yield State('environment', WARNING, f'{name}={os.environ[name]}', do)
    epoch = os.environ.get('SOURCE_DATE_EPOCH', '')
    if epoch:
        do = 'unset it unless results must be identical to the last byte'
        yield State('environment', WARNING, f'SOURCE_DATE_EPOCH={epoch}: all dates are this', do)


def _is_set_by_otf_or_ros(name: str) -> bool:
    """True for a path that ./otf sets itself, or that a sourced ROS does."""
    paths = os.environ[name].split(os.pathsep)
    return name == 'PYTHONPATH' and all(
        os.path.isdir(os.path.join(p, 'otf_core')) or 'ros' in p.lower() or 'install' in p
        for p in paths
    )


EARLIEST_DATE = 1_767_225_600.0
"""s since 1970, 2026-01-01: no earlier than this program was written."""
LARGEST_LAG = 5.0
"""s; between this computer and the disk that it writes to."""


def check_clock() -> Iterator[State]:
    """Check that the clock can be right and is kept by NTP."""
    now = time.time()
    date = time.strftime('%Y-%m-%d %H:%M:%S UTC', time.gmtime(now))
    if now < EARLIEST_DATE:
        yield State('clock', WARNING, f'{date}: in the past', 'set the clock of this computer')
        return
    with tempfile.TemporaryFile() as file:
        late = os.fstat(file.fileno()).st_mtime - time.time()
    if abs(late) > LARGEST_LAG:
        yield State(
            'clock', WARNING, f'{date}, but the disk differs by {late:+.0f} s',
            'let both computers keep time by NTP',
        )  # fmt: skip
    synchronised = _synchronised()
    if synchronised is False:
        yield State(
            'clock', WARNING, f'{date}, not kept by NTP',
            'timedatectl set-ntp true; a clock adjusted during a recording corrupts bags '
            'stamped by this computer',
        )  # fmt: skip
    else:
        yield State('clock', OK, date + (', kept by NTP' if synchronised else ''))


def _synchronised() -> bool | None:
    """Whether the clock is kept; None where the system does not say."""
    program = shutil.which('timedatectl')
    if program is None:
        return None
    command = [program, 'show', '-p', 'NTPSynchronized', '--value']
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=2, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return {'yes': True, 'no': False}.get(answer.stdout.strip())


HIGHEST_DOMAIN = 232
"""Highest ROS_DOMAIN_ID: its ports end at 65535 (docs.ros.org, The ROS_DOMAIN_ID)."""
FIRST_PORT, PER_DOMAIN = 7400, 250
"""UDP ports of discovery (DDSI-RTPS 2.3, 9.6.1.1)."""
TOOLS = (('cc', 'gcc', 'clang'), ('c++', 'g++', 'clang++'), ('cmake',), ('make',))
"""Programs of which one each builds the messages."""
EMSCON = 700
"""TCP port of a tracker controller."""


def check_graph() -> Iterator[State]:
    """Check ROS, its domain, discovery and ports; offline verbs need none of them."""
    yield _ros()
    domain = os.environ.get('ROS_DOMAIN_ID', '') or '0'
    if not domain.isascii() or not domain.isdigit() or int(domain) > HIGHEST_DOMAIN:
        yield State(
            'domain', WARNING, f'ROS_DOMAIN_ID={domain}',
            f'set a number of 0 to 101 (at most {HIGHEST_DOMAIN}), the same on all computers',
        )  # fmt: skip
    else:
        yield _discovery(int(domain))
    for name in ('ROS_LOCALHOST_ONLY', 'ROS_AUTOMATIC_DISCOVERY_RANGE'):
        value = os.environ.get(name, '')
        if value and value.upper() not in ('0', 'SUBNET', 'SYSTEM_DEFAULT'):
            yield State(
                'discovery', WARNING, f'{name}={value}',
                'unset it if nodes run on several computers',
            )  # fmt: skip
    if (
        sys.platform == 'linux'
        and hasattr(os, 'geteuid')
        and os.geteuid()
        and not _may_use_low_ports()
    ):
        yield State(
            'ports', OK, f'TCP {EMSCON} requires root; use ./otf emulate-tracker --port 7000',
        )  # fmt: skip


def _ros() -> State:
    distribution = os.environ.get('ROS_DISTRO', '')
    if distribution and distribution != 'jazzy':
        return State(
            'ros', WARNING, f'ROS_DISTRO={distribution}',
            'the nodes require jazzy: open a new terminal, source /opt/ros/jazzy/setup.bash',
        )  # fmt: skip
    missing_tools = [names[0] for names in TOOLS if not any(map(shutil.which, names))]
    if find_spec('rclpy') is None and missing_tools:
        return State(
            'ros', WARNING, f'no rclpy here, and {", ".join(missing_tools)} to build with: '
            f'offline verbs only',
            'sudo apt install build-essential cmake, then ./otf demo sets ROS 2 Jazzy up',
        )  # fmt: skip
    if find_spec('rclpy') is None:
        return State(
            'ros', OK, 'no rclpy here: offline verbs only (./otf demo sets ROS 2 Jazzy up)'
        )
    middleware = os.environ.get('RMW_IMPLEMENTATION', '') or 'default'
    return State('ros', OK, f'rclpy found, middleware {middleware}')


def _discovery(domain: int) -> State:
    """Whether datagrams can be sent and received on the port of discovery."""
    port = FIRST_PORT + PER_DOMAIN * domain
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            own.bind(('', port))
    except OSError as error:
        return State(
            'domain', WARNING, f'{domain}: UDP port {port} cannot be opened ({error.strerror})',
            'choose another ROS_DOMAIN_ID, or open the port in the firewall',
        )  # fmt: skip
    return State('domain', OK, f'{domain}, UDP port {port}')


def _may_use_low_ports() -> bool:
    """True if this user may listen on the port of a tracker."""
    try:
        with open('/proc/sys/net/ipv4/ip_unprivileged_port_start', encoding='ascii') as file:
            return int(file.read()) <= EMSCON
    except (OSError, ValueError):
        return False


CHECKS: tuple[Callable[[], Iterator[State]], ...] = (
    check_python,
    check_packages,
    check_disk_and_memory,
    check_locale_and_variables,
    check_clock,
    check_graph,
)
"""In the order in which they are shown."""


def examine() -> list[State]:
    """Check this installation."""
    return [state for check in CHECKS for state in check()]
