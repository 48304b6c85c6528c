# SPDX-License-Identifier: Apache-2.0
"""The command line as a user has it: a process of its own, words, exit code, files."""

import fcntl
import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
COMMAND = [sys.executable, '-m', 'otf_core.cli']
"""What ``./otf`` and the installed ``otf`` start."""
DOCUMENTED = (0, 2, 3, 4, 5, 130)
PATIENCE = 400.0
"""s; far more than any command here takes on a busy computer."""


@dataclass(frozen=True)
class Done:
    """A command that has ended."""

    code: int
    out: str
    err: str

    @property
    def said(self):
        """All its words."""
        return self.out + self.err

    @property
    def document(self):
        """The JSON object of --json."""
        return json.loads(self.out)


def otf(*words, folder='.', **environment):
    """Run ``otf WORDS`` in a folder; whatever happens, it ends as documented."""
    done = subprocess.run(
        [*COMMAND, *map(str, words)],
        cwd=folder,
        env=with_variables(environment),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode in DOCUMENTED and 'Traceback' not in done.stderr, done.stderr
    return Done(done.returncode, done.stdout, done.stderr)


def with_variables(changes):
    """Variables of this process, with changes; the package is found from any folder."""
    places = filter(None, os.environ.get('PYTHONPATH', '').split(os.pathsep))
    path = os.pathsep.join(map(os.path.abspath, places))
    return {**os.environ, 'PYTHONPATH': path, 'OPENBLAS_NUM_THREADS': '1', **changes}


def refused(done, code, *parts, written=()):
    """The command ended with the code, its message has all parts, and nothing was written."""
    assert done.code == code, done.said
    for part in parts:
        assert re.search(part, done.said, re.IGNORECASE), (part, done.said)
    for path in written:
        assert not Path(path).exists(), f'{path} was left behind'


def read(path):
    """A JSON file."""
    return json.loads(Path(path).read_text(encoding='utf-8'))


def shared(factory):
    """The folder that all processes of this run of the tests share."""
    place = factory.getbasetemp()
    return place.parent if 'PYTEST_XDIST_WORKER' in os.environ else place


def made_once(place, make):
    """The folder that ``make(folder)`` fills: by whoever asks first, whoever else waits."""
    place.mkdir(parents=True, exist_ok=True)
    ready = place / '.ready'
    with open(place / '.lock', 'w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not ready.exists():
            make(place)
            ready.touch()
    return place
