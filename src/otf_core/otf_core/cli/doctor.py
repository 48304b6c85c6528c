# SPDX-License-Identifier: Apache-2.0
"""Verb doctor: versions of Python and packages, disk, ROS. Needs no numpy."""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from otf_core.cli.output import answer
from otf_core.errors import ConfigError
from otf_core.version import __version__

OK, WARNING, ERROR = 'ok', 'warning', 'error'
LOWEST_PYTHON = (3, 10)
OLDEST_VERSIONS = {
    'numpy': '1.26',
    'scipy': '1.11',
    'PyYAML': '6.0',
    'mcap': '1.5',
    'zstandard': '0.18',
    'lz4': '4.3',
    'rosbags': '0.11',
    'threadpoolctl': '3.1',
    'shtab': '1.5.5',
    'Jinja2': '3.1',
}
"""Distributions and their oldest versions, as in setup.cfg."""
COMPILED = ('numpy', 'scipy.linalg', 'zstandard', 'yaml')
"""Modules whose binary parts may not fit this interpreter, or each other."""
DISK_WARNING, DISK_ERROR = 2e9, 1e8
"""Bytes: a day of bags; a single run with its results."""


@dataclass(frozen=True)
class State:
    """One part of an installation: how it is, what was found, what to do where that is not ok."""

    part: str
    severity: str
    what: str
    do: str = ''


def check_versions() -> Iterator[State]:
    """Check that Python and every package are there, new enough, and load."""
    here = f'Python {sys.version.split()[0]}, {sys.executable}'
    fits = sys.version_info[:2] >= LOWEST_PYTHON
    yield State('python', OK if fits else ERROR, here, '' if fits else 'use Python 3.10 or later')
    versions, missing, old = [f'otf_core {__version__}'], [], []
    for name, least in OLDEST_VERSIONS.items():
        try:
            have = version(name)
        except PackageNotFoundError:
            missing.append(name)
            continue
        versions.append(f'{name} {have}')
        wanted, found = ([int(n) for n in re.findall(r'\d+', text)[:3]] for text in (least, have))
        if found < wanted:
            old.append(f'{name} {have} (needed {least})')
    if missing:
        yield State('packages', ERROR, f'missing: {", ".join(missing)}', 'pip install otf_core')
    if old:
        yield State('packages', WARNING, f'too old: {", ".join(old)}', 'pip install --upgrade')
    if not missing and not old:
        yield State('packages', OK, ', '.join(versions))
    for name in () if missing else COMPILED:
        try:
            import_module(name)
        except (ImportError, AttributeError, ValueError, OSError) as error:  # for another numpy
            what = f'{name}: {" ".join(str(error).split())[:200]}'
            do = 'use a separate environment (python -m venv), so that pip and apt do not mix'
            yield State('packages', ERROR, what, do)


def check_disk() -> Iterator[State]:
    """Check the room in this folder and in that of temporary files."""
    for folder in dict.fromkeys((os.getcwd(), tempfile.gettempdir())):
        free = shutil.disk_usage(folder).free
        severity = OK if free >= DISK_WARNING else ERROR if free < DISK_ERROR else WARNING
        do = '' if severity == OK else 'make room, or set TMPDIR to another disk'
        yield State('disk', severity, f'{free / 1e9:.1f} GB free in {folder}', do)


def check_ros() -> Iterator[State]:
    """Check which ROS this is; offline verbs need none."""
    distribution = os.environ.get('ROS_DISTRO', '')
    if distribution not in ('', 'jazzy'):
        do = 'the nodes require jazzy: open a new terminal, source /opt/ros/jazzy/setup.bash'
        yield State('ros', WARNING, f'ROS_DISTRO={distribution}', do)
    elif find_spec('rclpy') is None:
        yield State('ros', OK, 'no rclpy here: offline verbs only (./otf demo sets ROS 2 up)')
    else:
        yield State('ros', OK, f'rclpy found, {os.environ.get("RMW_IMPLEMENTATION") or "default"}')


def run_doctor(arguments: argparse.Namespace) -> int:
    """State what is wrong with an installation, and what to do."""
    states = [*check_versions(), *check_disk(), *check_ros()]
    lines = [f'{s.severity:<9}{s.part:<10}{s.what}{f": {s.do}" if s.do else ""}' for s in states]
    healthy = all(s.severity != ERROR for s in states)
    parts = [asdict(s) for s in states]
    answer(arguments, '\n'.join(lines), {'healthy': healthy, 'parts': parts})
    return 0 if healthy else ConfigError.exit_code
