# SPDX-License-Identifier: Apache-2.0
"""A function by its name as a run of a fleet: arguments and result are JSON.

``python -m otf_core.fleet.call MODULE:FUNCTION OUT ARGUMENTS`` calls it with the object ARGUMENTS
and writes what it returns to ``OUT/result.json``. What it raises is its last words.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from otf_core.files.writing import ensure_folder, write_text
from otf_core.fleet.job import Job, hash_of
from otf_core.threads import one_thread

MODULE = 'otf_core.fleet.call'
RESULT = 'result.json'


def call_job(
    name: str,
    function: str,
    arguments: Mapping[str, Any],
    out: Path,
    *,
    depends: Sequence[str] = (),
    places: Sequence[str] = (),
) -> Job:
    """Make the job that calls a function.

    Parameters
    ----------
    name : str
    function : str
        'module:function'.
    arguments : mapping
        Plain data, by the names of the parameters.
    out : Path
        Folder for ``result.json``.
    depends : sequence of str
        Hashes of files that it reads.
    places : sequence of str
        Folders where its module is found, besides that of otf_core.
    """
    out = out.absolute()
    words = (MODULE, function, str(out), json.dumps(arguments))
    inputs = hash_of(function, dict(arguments), list(depends))
    return Job(name, words, str(out), RESULT, inputs, 0, places=tuple(places))


def call(words: Sequence[str]) -> None:
    """Call a function and write its result."""
    name, out, text = words
    module, _, function = name.partition(':')
    with one_thread():
        result = getattr(import_module(module), function)(**json.loads(text))
    write_text(ensure_folder(out) / RESULT, json.dumps(result) + '\n')


if __name__ == '__main__':
    call(sys.argv[1:])
