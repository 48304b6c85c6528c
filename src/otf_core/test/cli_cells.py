# SPDX-License-Identifier: Apache-2.0
"""Commands of the tests: run in this process, their files and messages."""

import json
import re
import tempfile
from pathlib import Path

import numpy as np

from otf_core import cli


def words_of(*arguments):
    """Words of a command line; a mapping becomes the file of ``--config``."""
    words = []
    for argument in arguments:
        if isinstance(argument, dict):
            with tempfile.NamedTemporaryFile('w', suffix='.yaml', delete=False) as file:
                json.dump(argument, file)  # JSON is YAML
            words += ['--config', file.name]
        else:
            words.append(str(argument))
    return words


def run(*arguments):
    """Exit code of one command, in this process; see ``words_of``."""
    try:
        return cli.main(words_of(*arguments))
    except SystemExit as leaving:
        return leaving.code


def without_date(file):
    """Bytes of a result but for the moment of writing."""
    content = file.read_bytes()
    return re.sub(rb'"written": "[^"]*"|(?<=<td>written</td><td>)[^<]*', b'', content)


def read_csv(file):
    header, *rows = Path(file).read_text().splitlines()
    return header, np.array([[float(v) for v in row.split(',')] for row in rows])


def write_points(file, points):
    rows = [','.join(map(repr, row)) for row in np.asarray(points, float).tolist()]
    Path(file).write_text('\n'.join(['x,y,z', *rows]) + '\n')
    return file


def message(capsys):
    """The only line of a command that failed."""
    shown = capsys.readouterr()
    assert shown.out == ''
    assert shown.err.count('\n') == 1
    return shown.err.strip()
