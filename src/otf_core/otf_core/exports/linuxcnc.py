# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC: one compensation file per joint, and the piece of the INI file that names them.

Source: LinuxCNC 2.9, ``docs/src/config/ini-config.adoc`` (COMP_FILE, COMP_FILE_TYPE) and
``src/emc/usr_intf/usrmotintf.cc``: lines "nominal forward reverse" in machine units, strictly
ascending, at most 256, straight lines between them and constant outside; reading ends at the
first line that is not three numbers, so words stand below the numbers. Type 0: the columns are
actual positions in positive and in negative travel; the control adds nominal minus actual. The
unit of an angular joint is the degree.
"""

from __future__ import annotations

from pathlib import PurePath

import numpy as np

from otf_core.exports.format import LINE_WORDS, ExportedFiles, Format, Request
from otf_core.exports.terms import (
    axis_positions,
    control_unit,
    error_of_terms,
    half_reversal,
    line_terms,
    own_pairs,
    term_remarks,
)

MAX_LINES = 256
"""Lines that the control reads of a file."""
DECIMALS = 6


def _make(fmt: Format, request: Request) -> ExportedFiles:
    """Make the INI piece and a file per joint: X, Y, Z, then rotary axes in their order."""
    tables, stem = request.content.tables, PurePath(request.name).stem
    machine, pairs = tables.machine, own_pairs(tables.machine)
    remarks, positions = list(term_remarks(machine, pairs)), {}
    if endless := [a for a in machine.rotary_names if machine.axes[a].endless]:
        remarks.append(f'{", ".join(endless)}: within the turn of the table only')
    words = [f'# {line}' for line in (*request.header(fmt), *remarks)]
    for axis in machine.axis_names:
        positions[axis] = axis_positions(tables, axis, request.points)
        if (count := len(positions[axis])) > MAX_LINES:
            positions[axis] = axis_positions(tables, axis, MAX_LINES)
            remarks.append(
                f'{axis}: {MAX_LINES} lines, evenly spread, instead of {count}; the control '
                f'reads no more'
            )
        unit = control_unit(machine, axis)
        positions[axis] = (unit * positions[axis]).round(DECIMALS) / unit
    terms = line_terms(tables, pairs, positions, DECIMALS)
    ini = f'{stem}.ini'
    files, piece, reversals = {ini: b''}, list(words), []
    for joint, ((axis, _), term) in enumerate(terms.items()):
        name, unit = f'{stem}_{axis.lower()}.comp', control_unit(machine, axis)
        half = half_reversal(request.content, axis, term.position)
        size = f'{2e6 * half.mean() + 0.0:.2f}'
        reversals.append(f'{axis} {size} {"urad" if machine.axes[axis].rotary else "um"}')
        actual = term.position + term.value
        columns = unit * np.column_stack([term.position, actual + half, actual - half])
        rows = [' '.join(f'{v + 0.0:.{DECIMALS}f}' for v in r.round(DECIMALS)) for r in columns]
        files[name] = ('\n'.join([*rows, *words]) + '\n').encode()
        piece += [f'[JOINT_{joint}]', f'COMP_FILE = {name}', 'COMP_FILE_TYPE = 0']
    joints = ', '.join(f'JOINT_{k} is {axis}' for k, axis in enumerate(machine.axis_names))
    files[ini] = ('\n'.join(piece) + '\n').encode()
    return ExportedFiles(
        files,
        lambda q: error_of_terms(machine, terms, q),
        (
            'put the lines of the .ini file into the sections of that name in the INI file of '
            'the machine (a section that comes twice is read once); BACKLASH of a joint with '
            'COMP_FILE is ignored: columns 2 and 3 hold the reversal, on average '
            f'{", ".join(reversals)} (backlash at the target in the summary of the calibration)',
            f'{joints} as with coordinates={"".join(machine.axis_names)} and LINEAR_UNITS = mm: '
            f'where two joints drive one axis, as on a gantry, both take its file and the joints '
            f'after them have other numbers; an inch machine takes no mm',
            *remarks,
        ),
    )


FORMATS = (
    Format(
        'linuxcnc',
        _make,
        LINE_WORDS,
        'COMP_FILE_TYPE = 0: columns 2 and 3 are the actual positions in mm at the nominal '
        'position in column 1 (actual = nominal + error), for forward and backward travel',
        'straightness, rotations and squareness (a file per joint corrects its own axis only)',
        takes_points=True,
    ),
)
