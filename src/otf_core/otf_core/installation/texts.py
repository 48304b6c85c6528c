# SPDX-License-Identifier: Apache-2.0
"""Locale and encodings, and variables that change what Python or otf does."""

from __future__ import annotations

import locale
import os
import sys
from collections.abc import Iterator

from otf_core.installation.state import OK, WARNING, State

CHANGING = {
    'PYTHONHOME': 'it points Python at another library; unset it',
    'PYTHONPATH': 'packages there hide those of this environment; unset it outside ROS',
    'PYTHONOPTIMIZE': 'checks of the program are left out; unset it',
}


def check() -> Iterator[State]:
    """Ask for UTF-8 and for variables that are seldom meant."""
    preferred = locale.getpreferredencoding(False)
    shown = getattr(sys.stdout, 'encoding', None) or 'none'
    found = f'files {preferred}, terminal {shown}'
    if 'utf' in preferred.lower() and 'utf' in shown.lower():
        yield State('locale', OK, found)
    else:
        yield State(
            'locale', WARNING, found,
            'set LANG=C.UTF-8, on Windows PYTHONUTF8=1: names with umlauts come out wrong else',
        )  # fmt: skip
    for name, do in CHANGING.items():
        if os.environ.get(name) and not _own(name):
            yield State('environment', WARNING, f'{name}={os.environ[name]}', do)
    epoch = os.environ.get('SOURCE_DATE_EPOCH', '')
    if epoch:
        do = 'unset it unless results have to repeat to the last byte'
        yield State('environment', WARNING, f'SOURCE_DATE_EPOCH={epoch}: all dates are this', do)


def _own(name: str) -> bool:
    """True for a path that ./otf sets itself, or that a sourced ROS does."""
    paths = os.environ[name].split(os.pathsep)
    return name == 'PYTHONPATH' and all(
        os.path.isdir(os.path.join(p, 'otf_core')) or 'ros' in p.lower() or 'install' in p
        for p in paths
    )
