# SPDX-License-Identifier: Apache-2.0
"""Commands of the tests: run in this process, their files and messages."""

import re
from pathlib import Path

import numpy as np

from otf_core import cli


def run(*arguments):
    """Exit code of one command, in this process."""
    try:
        return cli.main([str(a) for a in arguments])
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
