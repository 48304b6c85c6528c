# SPDX-License-Identifier: Apache-2.0
"""An NC program as a path: the corner points of its moves, whatever the control."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from otf_core.arrays import Array
from otf_core.files.writing import unreadable
from otf_core.inputs.nc_gcode import GCode, without_comments
from otf_core.inputs.nc_klartext import Klartext
from otf_core.inputs.nc_path import CHORD, MACHINE, DrivenPath

LOOKED_AT = 65536
"""Bytes by which a file is known to be a program."""
KLARTEXT = re.compile(r'^\s*\d*\s*(BEGIN PGM\b|L\s+I?[XYZ][-+]?\d)', re.MULTILINE | re.IGNORECASE)
BLOCK = re.compile(
    r'^\s*/?\s*(?:[N:]\s*\d+\s*)?(?:SUPA\s+)?(?:[GM]\s*\d+(\.\d+)?\s*)+(?=[A-Z;(*%]|$)'
)
MOTION = re.compile(r'(?<![A-Z])G\s*0*[0123](?![\d.])')
TABLE = re.compile(r'^\s*[-+.\d"]')


@dataclass(frozen=True)
class Program:
    """What a program drives.

    Attributes
    ----------
    points : ndarray, shape (n, 3), m
        Corner points in driving order; arcs as chords.
    form : str
        'G-code' or 'Klartext'.
    lines, arcs : int
        Moves of each kind.
    frames : tuple of str
        What positions refer to.
    said : str
        What it was read as.
    """

    points: Array
    form: str
    lines: int
    arcs: int
    frames: tuple[str, ...]
    said: str


def _text(name: str | Path, size: int = -1) -> str:
    try:
        with open(name, 'rb') as file:
            return file.read(size).decode('utf-8-sig', 'replace')
    except OSError as error:
        raise unreadable(name, error) from None


def is_klartext(text: str) -> bool:
    """Tell whether a text is HEIDENHAIN Klartext."""
    return bool(KLARTEXT.search(text))


def is_program(name: str | Path) -> bool:
    """Tell whether a file is an NC program, by its beginning; False if it cannot be read."""
    if not Path(name).is_file():
        return False
    text = _text(name, LOOKED_AT)
    if '\0' in text:
        return False
    if is_klartext(text):
        return True
    blocks = 0
    for line in text.upper().splitlines():
        bare = (without_comments(line) or '').strip()
        blocks += bool(BLOCK.match(bare) and not TABLE.match(bare))
        if blocks and MOTION.search(bare):
            return True
    return False


def read_program(name: str | Path) -> Program:
    """Read the path that an NC program drives.

    Read are straight lines (G0, G1, L) and arcs (G2, G3, CC with C, CR) of X, Y and Z, absolute or
    in increments, in mm or inch. What else may move an axis is refused.

    Raises
    ------
    ConfigError
        If the file cannot be read; or names line and word that cannot be a path.
    """
    text = _text(name)
    path = DrivenPath(str(name))
    form = 'Klartext' if is_klartext(text) else 'G-code'
    reader = Klartext(path) if form == 'Klartext' else GCode(path)
    reader.read(text.splitlines())
    points = path.finish()
    return Program(
        points, form, path.lines, path.arcs, tuple(sorted(path.frames)), _words(form, path)
    )


def _words(form: str, path: DrivenPath) -> str:
    """Say what a program was read as."""
    arcs = f' and {path.arcs} arcs, as chords of at most {1e3 * CHORD:g} mm' if path.arcs else ''
    said = [f'NC program ({form}): {path.lines} straight moves{arcs}']
    offsets = [name for name in path.frames if name != MACHINE]
    if offsets:
        said.append(
            f'positions in {offsets[0]} are taken for {MACHINE}: that offset has to be zero'
        )
    if path.slanted_rapids:
        said.append(f'{path.slanted_rapids} rapid moves of several axes are taken as straight')
    return '; '.join([*said, *path.remarks])
