# SPDX-License-Identifier: Apache-2.0
"""The packages that the core computes with: there, new enough, made for each other."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

from otf_core.installation.state import ERROR, OK, WARNING, State
from otf_core.version import __version__

NEEDED = {
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


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r'\d+', text)[:3])


def check() -> Iterator[State]:
    """Ask every package for its version, and load the compiled ones."""
    found, missing, old = [f'otf_core {__version__}'], [], []
    for name, least in NEEDED.items():
        try:
            have = version(name)
        except PackageNotFoundError:
            missing.append(name)
            continue
        found.append(f'{name} {have}')
        if _numbers(have) < _numbers(least):
            old.append(f'{name} {have} (needed {least})')
    install = "pip install 'otf_core', or ./otf VERB from a copy of the sources"
    if missing:
        yield State('packages', ERROR, f'missing: {", ".join(missing)}', install)
    if old:
        yield State('packages', WARNING, f'too old: {", ".join(old)}', 'pip install --upgrade')
    if not missing and not old:
        yield State('packages', OK, ', '.join(found))
    broken = [] if missing else [text for name in COMPILED if (text := _trouble(name))]
    if broken:
        yield State(
            'binaries', ERROR, '; '.join(broken),
            'use an environment of its own (python -m venv), so that pip and apt do not mix',
        )  # fmt: skip


def _trouble(module: str) -> str:
    """Why a module does not load; empty if it does."""
    try:
        import_module(module)
    except (ImportError, AttributeError, ValueError, OSError) as error:
        # ValueError and AttributeError: built for another numpy
        return f'{module}: {" ".join(str(error).split())[:200]}'
    return ''
