# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC: one compensation file per joint, and the piece of the INI file that names them.

Source: LinuxCNC 2.9, ``docs/src/config/ini-config.adoc`` (COMP_FILE, COMP_FILE_TYPE) and
``src/emc/usr_intf/usrmotintf.cc``: lines "nominal forward reverse" in machine units, strictly
ascending, at most 256, straight lines between them and constant outside; reading ends at the
first line that is not three numbers, so words stand below the numbers. Type 0: the columns are
actual positions in positive and in negative travel; the control adds nominal minus actual.
"""

from __future__ import annotations

from pathlib import PurePath

import numpy as np

from otf_core.arrays import Array
from otf_core.exports.format import LINE_WORDS, ExportedFiles, Format, Request
from otf_core.exports.lattice import (
    OWN_PAIRS,
    LineTerm,
    axis_positions,
    error_of_terms,
    half_reversal,
    line_terms,
)
from otf_core.model.tables import ErrorTables

MAX_LINES = 256
"""Lines that the control reads of a file."""
DECIMALS = 6


class LinuxCnc(Format):
    """LinuxCNC 2.8 and later, trivial kinematics: joints 0, 1, 2 are X, Y, Z."""

    name = 'linuxcnc'
    value_words = LINE_WORDS
    lacks = 'straightness, rotations and squareness (a file per joint corrects its own axis only)'
    takes_points = True

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return (
            'COMP_FILE_TYPE = 0: columns 2 and 3 are the actual positions in mm at the nominal '
            'position in column 1 (actual = nominal + error), for forward and backward travel'
        )

    def export(self, request: Request) -> ExportedFiles:
        """Make the INI piece and a file per joint."""
        self.check(request)
        tables, stem = request.content.tables, PurePath(request.name).stem
        positions, remarks = _positions(tables, request.points)
        terms = {}
        for pair, term in line_terms(tables, OWN_PAIRS, positions).items():
            nominal = term.position.round(DECIMALS + 3)
            terms[pair] = LineTerm(nominal, (nominal + term.value).round(DECIMALS + 3) - nominal)
        words = [f'# {line}' for line in request.header(self)]
        ini = f'{stem}.ini'
        files, piece, reversals = {ini: b''}, list(words), []
        for k, axis in enumerate(tables.machine.axis_names):
            name = f'{stem}_{axis.lower()}.comp'
            half = half_reversal(request.content, k, terms[k, k].position)
            files[name] = _joint_file(terms[k, k], half, words)
            reversals.append(f'{axis} {2e6 * half.mean() + 0.0:.2f} um')
            piece += [f'[JOINT_{k}]', f'COMP_FILE = {name}', 'COMP_FILE_TYPE = 0']
        files[ini] = ('\n'.join(piece) + '\n').encode()
        return ExportedFiles(
            files,
            lambda q: error_of_terms(terms, q),
            (
                'put the lines of the .ini file into the sections of that name in the INI file of '
                'the machine (a section that comes twice is read once); BACKLASH of a joint with '
                'COMP_FILE is ignored: columns 2 and 3 hold the reversal, on average '
                f'{", ".join(reversals)} (backlash at the target in the summary of the '
                f'calibration)',
                *remarks,
            ),
        )


def _positions(tables: ErrorTables, points: int | None) -> tuple[dict[int, Array], list[str]]:
    """Positions of the lines by joint, m, and remarks where there are fewer than wanted."""
    positions, remarks = {}, []
    for k, axis in enumerate(tables.machine.axis_names):
        positions[k] = axis_positions(tables, k, points)
        count = len(positions[k])
        if count > MAX_LINES:
            positions[k] = axis_positions(tables, k, MAX_LINES)
            remarks.append(
                f'{axis}: {MAX_LINES} lines, evenly spread, instead of {count}; the control '
                f'reads no more'
            )
    return positions, remarks


def _joint_file(term: LineTerm, half: Array, words: list[str]) -> bytes:
    actual = term.position + term.value
    columns = 1e3 * np.column_stack([term.position, actual + half, actual - half])
    rows = [' '.join(f'{v + 0.0:.{DECIMALS}f}' for v in row.round(DECIMALS)) for row in columns]
    return ('\n'.join([*rows, *words]) + '\n').encode()


FORMAT = LinuxCnc()
